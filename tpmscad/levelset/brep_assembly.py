"""Assembly of fitted level sets and the caps of their box into one boundary representation.

Each level set is bounded by the void on its outer side (a sheet has two of them); the faces of the box close what they leave
open. The tables of edges, faces and edge uses are made for each level set at once, then extended by the edges of the box in the
solid and by the planar caps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.array_table import ArrayTable
from tpmscad.brep.boundary_representation import Brep, Edges, EdgeUses, Faces
from tpmscad.brep.carriers import Plane
from tpmscad.index_ranges import repeat_rows
from tpmscad.levelset.caps import (
    LOOP_PARAMETERS,
    BoxEdgeSegments,
    CapEdges,
    chain_cap_loops,
    find_solid_box_edges,
    make_box_plane,
)
from tpmscad.levelset.fit.network_fit import NetworkFit
from tpmscad.levelset.quadmesh.patch_network import FIRST_HALF, SECOND_HALF, WHOLE, PatchNetwork
from tpmscad.rigid_motion import Motion
from tpmscad.splines.basis import bernstein_basis
from tpmscad.splines.bspline import BSplineCurve, BSplineSurface, line_segment
from tpmscad.splines.knots import bezier_curve, bezier_surface

TAGS = ("surface", "cap")

CURVE_SPANS = np.array([(0.0, 1.0), (0.0, 0.5), (0.5, 1.0)])
"""Parameter span of a curve that each of its pieces, WHOLE, FIRST_HALF or SECOND_HALF, covers."""

_SIDE_KINDS = (((0.0, 1.0), (0.0, 1.0)), ((0.0, 0.5), (0.0, 1.0)), ((0.5, 1.0), (0.0, 1.0)),
          ((0.0, 0.5), (0.0, 0.5)), ((0.5, 1.0), (0.5, 1.0)))  # fmt: skip
"""Span of the edge's curve, and part of the patch side that lies on it, for each kind of edge use: the whole side on the whole
curve, the whole side on either half of a curve, and either half of a side on its half of the curve."""

_HALF_SIDE_KIND = 2
"""Kind of the use by half a side, less the piece of the curve."""

_CORNERS = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])


@dataclass(frozen=True, slots=True, eq=False)
class _EdgeTable(ArrayTable):
    """Edges (n,): curve, first and last vertex, translation (n, 3) and span (n, 2) of the curve."""

    curve: IntArray
    start: IntArray
    end: IntArray
    shift: Array
    span: Array


@dataclass(frozen=True, slots=True, eq=False)
class _LevelSetTables:
    """What one level set contributes, with the numbers that it has in the whole Brep.

    `vertices` and which of their coordinates lie `on_box` (V, 3); `curves` and `carriers` of originals; `edges`; `carrier` (Q,)
    and `shift` (Q, 3) of faces; `uses` (n, 3): edge, sense and parameter curve; `n_uses` (Q,) of each face; `open_edges` in faces
    of the box.
    """

    vertices: Array
    on_box: BoolArray
    curves: list[BSplineCurve]
    carriers: list[BSplineSurface]
    edges: _EdgeTable
    carrier: IntArray
    shift: Array
    uses: IntArray
    n_uses: IntArray
    open_edges: CapEdges


@dataclass(frozen=True, slots=True, eq=False)
class _Caps:
    """Planar caps (f,): plane and number of loops of each; edge and sense (n, 2) of uses, and their number in each loop."""

    planes: list[Plane]
    plane: list[int]
    n_loops: list[int]
    uses: IntArray
    n_uses: list[int]


def assemble_field_brep(
    level_sets: Sequence[tuple[PatchNetwork, NetworkFit]],
    fixed: Sequence[BoolArray],
    lo: Array,
    hi: Array,
    corner_solid: BoolArray,
) -> Brep:
    """The Brep bounded by the level sets and the faces of the box [lo, hi].

    `fixed`: coordinates (V, 3) of each network's vertices that lie on the box. `corner_solid` (2, 2, 2): corners of the box in
    the solid. Translated copies share the carriers and curves of their originals.
    """
    tables: list[_LevelSetTables] = []
    for (network, fit), on_box in zip(level_sets, fixed, strict=True):
        tables.append(_tabulate_level_set(network, fit, on_box, tables))
    curves = [curve for t in tables for curve in t.curves]
    carriers = [carrier for t in tables for carrier in t.carriers]

    vertices, on_box = np.vstack([t.vertices for t in tables]), np.vstack([t.on_box for t in tables])
    box_edges, corners = find_solid_box_edges(vertices, on_box, corner_solid, lo, hi)
    vertices = np.vstack([vertices, corners])
    n_edges = sum(len(t.edges.curve) for t in tables)
    edges_of_box, lines = _tabulate_box_edges(box_edges, vertices, len(curves))
    edges, curves = _EdgeTable.concatenate([*(t.edges for t in tables), edges_of_box]), curves + lines
    numbers = np.repeat(n_edges + np.arange(len(lines)), 2)
    open_box_edges = _orient_open_edges(box_edges.plane.ravel(), numbers, box_edges.sense.ravel(), edges)
    open_edges = CapEdges.concatenate([*(t.open_edges for t in tables), open_box_edges])
    caps = _make_caps(open_edges, _sample_edges(open_edges, edges, curves), lo, hi)

    n_patches, n_caps = sum(len(t.carrier) for t in tables), len(caps.plane)
    uses = np.concatenate([*(t.uses for t in tables), np.column_stack([caps.uses, np.full(len(caps.uses), -1)])])
    n_uses = np.concatenate([*(t.n_uses for t in tables), np.array(caps.n_uses, np.int64)])
    n_loops = np.concatenate([np.ones(n_patches, np.int64), np.array(caps.n_loops, np.int64)])
    return Brep(
        carriers=(*carriers, *caps.planes),
        curves=tuple(curves),
        pcurves=tuple(_side_pcurve(s, w, span, part) for s in range(4) for w in (1, -1) for span, part in _SIDE_KINDS),
        vertices=vertices,
        edges=Edges(
            curve=edges.curve,
            motion=Motion.translations(edges.shift),
            span=edges.span,
            start=edges.start,
            end=edges.end,
            deviation=np.zeros(len(edges.curve)),
        ),
        uses=EdgeUses(uses[:, 0], uses[:, 1], uses[:, 2]),
        faces=Faces(
            carrier=np.concatenate([*(t.carrier for t in tables), len(carriers) + np.array(caps.plane, np.int64)]),
            motion=Motion.translations(np.concatenate([*(t.shift for t in tables), np.zeros((n_caps, 3))])),
            sense=np.ones(n_patches + n_caps, np.int64),
            tag=np.repeat([0, 1], [n_patches, n_caps]),
            loop_start=_starts(n_loops),
            use_start=_starts(n_uses),
        ),
        tags=TAGS,
    )


def _tabulate_level_set(
    network: PatchNetwork, fit: NetworkFit, fixed: BoolArray, previous: Sequence[_LevelSetTables]
) -> _LevelSetTables:
    """The tables of one level set, numbered after those of the previous ones."""
    first_vertex = sum(len(t.vertices) for t in previous)
    n_curves, n_vertices = len(network.ends), len(network.vertices)
    split = np.zeros(n_curves, bool)
    split[network.curve[network.piece != WHOLE]] = True
    midpoints = [_basis_at_middle(len(fit.curves[c]) - 1) @ fit.curves[c] for c in np.flatnonzero(split)]
    middle = np.full(n_curves, -1)
    middle[split] = first_vertex + n_vertices + np.arange(len(midpoints))

    edges, first_edge = _tabulate_edges(network, fit, split, middle, first_vertex, previous)
    original = fit.copies.original_patches
    carrier = np.full(len(network.curve), -1)
    carrier[original] = sum(len(t.carriers) for t in previous) + np.arange(np.count_nonzero(original))
    uses, n_uses = _tabulate_uses(network, split, first_edge)
    return _LevelSetTables(
        vertices=np.vstack([network.vertices, *midpoints]),
        on_box=np.vstack([fixed, np.zeros((len(midpoints), 3), bool)]),
        curves=[bezier_curve(fit.curves[c]) for c in np.flatnonzero(fit.copies.original_curves)],
        carriers=[bezier_surface(fit.patches[q]) for q in np.flatnonzero(original)],
        edges=edges,
        carrier=carrier[fit.copies.patch],
        shift=fit.copies.patch_shift,
        uses=uses,
        n_uses=n_uses,
        open_edges=_find_open_edges(network, split, first_edge, edges),
    )


def _tabulate_edges(
    network: PatchNetwork,
    fit: NetworkFit,
    split: BoolArray,
    middle: IntArray,
    first_vertex: int,
    previous: Sequence[_LevelSetTables],
) -> tuple[_EdgeTable, IntArray]:
    """The edges of the curves, two of each curve that is split in the middle, and each curve's first edge (C,)."""
    start, end = first_vertex + network.ends[:, 0], first_vertex + network.ends[:, 1]
    start[network.n_sides :] = middle[network.split_curve]
    original = fit.copies.original_curves
    number = np.full(len(split), -1)
    number[original] = sum(len(t.curves) for t in previous) + np.arange(np.count_nonzero(original))
    n_edges = 1 + split
    first = np.cumsum(n_edges) - n_edges
    curve = np.repeat(np.arange(len(split)), n_edges)
    piece = np.where(split[curve], FIRST_HALF + np.arange(len(curve)) - first[curve], WHOLE)
    edges = _EdgeTable(
        curve=number[fit.copies.curve[curve]],
        start=np.where(piece == SECOND_HALF, middle[curve], start[curve]),
        end=np.where(piece == FIRST_HALF, middle[curve], end[curve]),
        shift=fit.copies.curve_shift[curve],
        span=CURVE_SPANS[piece],
    )
    return edges, sum(len(t.edges.curve) for t in previous) + first


def _tabulate_uses(network: PatchNetwork, split: BoolArray, first_edge: IntArray) -> tuple[IntArray, IntArray]:
    """Edge uses (n, 3) of all patches, side by side counter-clockwise, and their number (Q,) in each patch.

    A side on the whole of a split curve uses both of its edges.
    """
    curve, sense, piece = network.curve.ravel(), network.sense.ravel(), network.piece.ravel()
    both = (piece == WHOLE) & split[curve]
    count = 1 + both
    row, step = repeat_rows(count)
    half = np.where(sense[row] > 0, FIRST_HALF + step, SECOND_HALF - step)
    used_piece = np.where(both[row], half, piece[row])
    edge = first_edge[curve[row]] + (used_piece == SECOND_HALF)
    kind = np.where(both[row], _HALF_SIDE_KIND + half, piece[row])
    pcurve = (2 * (row % 4) + (sense[row] < 0)) * len(_SIDE_KINDS) + kind
    return np.column_stack([edge, sense[row], pcurve]), count.reshape(-1, 4).sum(axis=1)


def _find_open_edges(network: PatchNetwork, split: BoolArray, first_edge: IntArray, edges: _EdgeTable) -> CapEdges:
    """The edges in faces of the box, oriented against their patches."""
    sense_of_patch = np.zeros(len(split), np.int64)
    sense_of_patch[network.curve.ravel()] = network.sense.ravel()
    curve = np.repeat(np.arange(len(split)), 1 + split)
    rows = np.flatnonzero(network.plane[curve] >= 0)
    curve, offset = curve[rows], int(first_edge[0]) if len(first_edge) else 0
    opened = _orient_open_edges(network.plane[curve], rows, -sense_of_patch[curve], edges)
    return replace(opened, edge=offset + rows)


def _tabulate_box_edges(
    segments: BoxEdgeSegments, vertices: Array, first_curve: int
) -> tuple[_EdgeTable, list[BSplineCurve]]:
    """The edges of the segments of the box's edges in the solid, and their lines, parametrised by length."""
    start, end = segments.ends.T
    length = np.array([float(np.linalg.norm(vertices[b] - vertices[a])) for a, b in segments.ends])
    lines = [line_segment(vertices[a], vertices[b], (0.0, s)) for a, b, s in zip(start, end, length, strict=True)]
    span = np.column_stack([np.zeros(len(length)), length])
    return _EdgeTable(first_curve + np.arange(len(lines)), start, end, np.zeros((len(lines), 3)), span), lines


def _orient_open_edges(plane: IntArray, edge: IntArray, sense: IntArray, edges: _EdgeTable) -> CapEdges:
    """Open edges (n,) with their first and last vertex in the direction of the sense."""
    a, b = edges.start[edge], edges.end[edge]
    return CapEdges(plane, edge, sense, np.where(sense > 0, a, b), np.where(sense > 0, b, a))


def _sample_edges(open_edges: CapEdges, edges: _EdgeTable, curves: Sequence[BSplineCurve]) -> Array:
    """Points (n, m, 3) along the open edges, in the direction of their sense."""
    polylines = []
    for e, sense in zip(open_edges.edge, open_edges.sense, strict=True):
        start, end = edges.span[e]
        points = curves[edges.curve[e]](start + (end - start) * LOOP_PARAMETERS)
        polylines.append(edges.shift[e] + (points if sense > 0 else points[::-1]))
    return np.array(polylines)


def _make_caps(open_edges: CapEdges, polylines: Array, lo: Array, hi: Array) -> _Caps:
    """The planar faces that the open edges bound in the six faces of the box."""
    planes: list[Plane] = []
    plane_of_cap, n_loops, n_uses = [], [], []
    uses: list[tuple[int, int]] = []
    for index in range(6):
        rows = np.flatnonzero(open_edges.plane == index)
        if not len(rows):
            continue
        plane = make_box_plane(index, lo, hi)
        for face in chain_cap_loops(plane, open_edges, rows, polylines[rows]):
            plane_of_cap.append(len(planes))
            n_loops.append(len(face))
            for loop in face:
                uses += loop
                n_uses.append(len(loop))
        planes.append(plane)
    return _Caps(planes, plane_of_cap, n_loops, np.array(uses, np.int64).reshape(-1, 2), n_uses)


def _starts(counts: IntArray) -> IntArray:
    """First entries (n + 1,) of groups with these numbers of entries (n,)."""
    return np.concatenate([[0], np.cumsum(counts)])


@cache
def _basis_at_middle(degree: int) -> Array:
    """The Bernstein polynomials (1, degree + 1) at the middle of a curve."""
    return bernstein_basis(degree, np.array([0.5]))


def _side_pcurve(side: int, sense: int, span: tuple[float, float], part: tuple[float, float]) -> BSplineCurve:
    """The parameter curve of a part of a patch side, over the span of the edge's curve and in its direction."""
    a, b = _CORNERS[side], _CORNERS[(side + 1) % 4]
    if sense < 0:
        a, b = b, a
    return line_segment(a + part[0] * (b - a), a + part[1] * (b - a), span)
