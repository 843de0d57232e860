"""Fitted layouts and the caps of their box as one patch complex.

Each layout is a level set of its own with the void on its outside (a sheet has two); the box's faces close what they leave open.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tpmscad._typing import Array, BoolArray
from tpmscad.brep.boundary_representation import Brep, Edges, EdgeUses, Faces
from tpmscad.levelset.caps import LOOP_PARAMETERS, CapEdges, chain_cap_loops, find_solid_box_edges, make_box_plane
from tpmscad.levelset.fit.network_fit import NetworkFit
from tpmscad.levelset.quadmesh.patch_network import PatchNetwork
from tpmscad.rigid_motion import Motion
from tpmscad.splines.basis import bernstein_basis
from tpmscad.splines.bspline import BSplineCurve, BSplineSurface, line_segment

TAGS = ("surface", "cap")
CURVE_SPANS = ((0.0, 1.0), (0.0, 0.5), (0.5, 1.0))


def assemble_field_brep(
    layers: Sequence[tuple[PatchNetwork, NetworkFit]],
    fixed: Sequence[BoolArray],
    lo: Array,
    hi: Array,
    corner_solid: BoolArray,
) -> Brep:
    """The complex that the layers and the box's faces bound. fixed: which coordinates of each net's vertices lie on the box.

    Curves and patches that are copies in a layer's fit are in the complex once, and placed.
    """
    carriers: list[BSplineSurface] = []
    curves: list[BSplineCurve] = []
    edge_rows: list[tuple[int, int, int]] = []
    vertices, spans = [], []
    face_carrier: list[int] = []
    edge_shift, face_shift = [], []
    use_rows: list[tuple[int, int, int]] = []
    use_start = [0]
    open_rows: list[tuple[int, int, int, int, int]] = []
    on_box = []
    pcurves = [_side_pcurve(s, w, span, part) for s in range(4) for w in (1, -1) for span, part in _SIDE_KINDS]
    n_vertices = 0
    for (net, fit), fix in zip(layers, fixed, strict=True):
        split = np.zeros(len(net.ends), bool)
        split[net.curve[net.piece > 0]] = True
        middle = np.full(len(net.ends), -1)
        middle[split] = n_vertices + len(net.vertices) + np.arange(np.count_nonzero(split))
        vertices += [net.vertices] + [
            bernstein_basis(len(fit.curves[c]) - 1, np.array([0.5])) @ fit.curves[c] for c in np.flatnonzero(split)
        ]
        on_box += [fix, np.zeros((np.count_nonzero(split), 3), bool)]
        start = n_vertices + net.ends[:, 0]
        start[net.n_sides :] = middle[net.middle_of]
        end = n_vertices + net.ends[:, 1]
        first_edge = np.full((len(net.ends), 3), -1)
        number_of = np.full(len(net.ends), -1)
        own = fit.copies.original_curves
        number_of[own] = len(curves) + np.arange(np.count_nonzero(own))
        for poles in (fit.curves[c] for c in np.flatnonzero(own)):
            curves.append(BSplineCurve(poles, np.repeat([0.0, 1.0], len(poles)), len(poles) - 1))
        for c in range(len(net.ends)):
            number = number_of[fit.copies.curve[c]]
            for piece in (1, 2) if split[c] else (0,):
                first_edge[c, piece] = len(edge_rows)
                begin = middle[c] if piece == 2 else start[c]
                stop = middle[c] if piece == 1 else end[c]
                edge_rows.append((number, begin, stop))
                edge_shift.append(fit.copies.curve_shift[c])
                spans.append(CURVE_SPANS[piece])
        owner_sense = np.zeros(len(net.ends), np.int64)
        carrier_of = np.full(len(net.curve), -1)
        own = fit.copies.original_patches
        carrier_of[own] = len(carriers) + np.arange(np.count_nonzero(own))
        for poles in (fit.patches[q] for q in np.flatnonzero(own)):
            p, r = poles.shape[0] - 1, poles.shape[1] - 1
            carriers.append(BSplineSurface(poles, np.repeat([0.0, 1.0], p + 1), np.repeat([0.0, 1.0], r + 1), p, r))
        face_carrier += carrier_of[fit.copies.patch].tolist()
        face_shift.append(fit.copies.patch_shift)
        for q in range(len(net.curve)):
            for s in range(4):
                c, w, piece = int(net.curve[q, s]), int(net.sense[q, s]), int(net.piece[q, s])
                owner_sense[c] = w
                if piece or not split[c]:
                    use_rows.append((first_edge[c, piece], w, _pcurve_index(s, w, piece)))
                else:
                    for half in (1, 2) if w > 0 else (2, 1):
                        use_rows.append((first_edge[c, half], w, _pcurve_index(s, w, 2 + half)))
            use_start.append(len(use_rows))
        for c in np.flatnonzero(net.plane >= 0):
            w = -owner_sense[c]
            for number in first_edge[c][first_edge[c] >= 0]:
                _, a, b = edge_rows[number]
                open_rows.append((net.plane[c], number, w, *((a, b) if w > 0 else (b, a))))
        n_vertices += len(net.vertices) + int(np.count_nonzero(split))

    points = np.vstack(vertices)
    rim, corners = find_solid_box_edges(points, np.vstack(on_box), corner_solid, lo, hi)
    points = np.vstack([points, corners])
    for (a, b), planes, senses in zip(rim.ends, rim.plane, rim.sense, strict=True):
        number = len(edge_rows)
        length = float(np.linalg.norm(points[b] - points[a]))
        edge_rows.append((len(curves), a, b))
        edge_shift.append(np.zeros(3))
        spans.append((0.0, length))
        curves.append(line_segment(points[a], points[b], (0.0, length)))
        for plane, w in zip(planes, senses, strict=True):
            open_rows.append((plane, number, w, *((a, b) if w > 0 else (b, a))))

    n_patches, n_splines = len(face_carrier), len(carriers)
    table = np.array(open_rows, np.int64).reshape(-1, 5)
    open_edges = CapEdges(*table.T)
    polylines = np.array([edge_shift[e] + _polyline(curves[edge_rows[e][0]], spans[e], w) for e, w in table[:, 1:3]])
    loop_start = list(range(n_patches + 1))
    planes = []
    for index in range(6):
        at = np.flatnonzero(open_edges.plane == index)
        if not len(at):
            continue
        plane = make_box_plane(index, lo, hi)
        for face in chain_cap_loops(plane, open_edges, at, polylines[at]):
            face_carrier.append(n_splines + len(planes))
            face_shift.append(np.zeros((1, 3)))
            for loop in face:
                use_rows += [(e, w, -1) for e, w in loop]
                use_start.append(len(use_rows))
            loop_start.append(len(use_start) - 1)
        planes.append(plane)
    edge = np.array(edge_rows, np.int64).reshape(-1, 3)
    uses = np.array(use_rows, np.int64).reshape(-1, 3)
    n_faces, n_edges = len(face_carrier), len(edge)
    return Brep(
        carriers=(*carriers, *planes),
        curves=tuple(curves),
        pcurves=tuple(pcurves),
        vertices=points,
        edges=Edges(
            curve=edge[:, 0],
            motion=Motion.translations(np.array(edge_shift, float).reshape(-1, 3)),
            span=np.array(spans, float).reshape(-1, 2),
            start=edge[:, 1],
            end=edge[:, 2],
            deviation=np.zeros(n_edges),
        ),
        uses=EdgeUses(uses[:, 0], uses[:, 1], uses[:, 2]),
        faces=Faces(
            carrier=np.array(face_carrier, np.int64),
            motion=Motion.translations(np.concatenate(face_shift)),
            sense=np.ones(n_faces, np.int64),
            tag=(np.arange(n_faces) >= n_patches).astype(np.int64),
            loop_start=np.array(loop_start, np.int64),
            use_start=np.array(use_start, np.int64),
        ),
        tags=TAGS,
    )


_SIDE_KINDS = (((0.0, 1.0), (0.0, 1.0)), ((0.0, 0.5), (0.0, 1.0)), ((0.5, 1.0), (0.0, 1.0)),
          ((0.0, 0.5), (0.0, 0.5)), ((0.5, 1.0), (0.5, 1.0)))  # fmt: skip
"""A curve's span and the part of the patch's side (along the curve) that lies on it: whole on whole, whole side on either half of
a curve, either half of a side on its half."""

_CORNERS = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])


def _pcurve_index(side: int, sense: int, kind: int) -> int:
    return (2 * side + (sense < 0)) * len(_SIDE_KINDS) + kind


def _side_pcurve(side: int, sense: int, span: tuple[float, float], part: tuple[float, float]) -> BSplineCurve:
    """The parameter curve of a part of a side, on the span of the edge's curve and run along it."""
    a, b = _CORNERS[side], _CORNERS[(side + 1) % 4]
    if sense < 0:
        a, b = b, a
    return line_segment(a + part[0] * (b - a), a + part[1] * (b - a), span)


def _polyline(curve: BSplineCurve, span: tuple[float, float], sense: int) -> Array:
    points = curve(span[0] + (span[1] - span[0]) * LOOP_PARAMETERS)
    return points if sense > 0 else points[::-1]
