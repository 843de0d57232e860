"""Intersection of all patches with the body's surfaces: arcs, traced and fitted once for each congruence class of pairs.

Each surface is expressed in the local frame of the patch. Pairs with the same carrier and equal surfaces (to 1e-9 in direction
and 1e-10 of the patch in position) form a class, of which one representative is traced and fitted. Planes that differ in
orientation only belong to one class.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.errors import TrimmingError
from tpmscad.rigid_motion import Motion
from tpmscad.splines.bspline import BSplineSurface
from tpmscad.trimming.intersect.arc_fitting import CoarsePath, fit_arcs
from tpmscad.trimming.intersect.arrangement import (
    ZERO_FRACTION_OF_TOL,
    Arrangement,
    CurveSegments,
    FittedArc,
    IntersectionCurves,
    Operands,
    PatchArcs,
)
from tpmscad.trimming.intersect.marching import ArcEnd, Trace
from tpmscad.trimming.intersect.marching_batched import march_patches
from tpmscad.trimming.intersect.marching_masked import march_masked_patches
from tpmscad.trimming.intersect.patch_borders import BorderSide
from tpmscad.trimming.operands.quadric_table import QuadricTable, group_rows


@dataclass(frozen=True, slots=True, eq=False)
class _PairClasses:
    """Candidate pairs (P,) of face and surface in congruence classes (C).

    `flip` (P,): -1 if the plane's orientation is reversed. `first` (C,): a representative pair of each class. `label` (P,): the
    class of each pair. `carrier`, `surfaces`, `on_corner`, `borders` (C): of the representatives, in the patch's frame.
    """

    face: IntArray
    surface: IntArray
    flip: IntArray
    first: IntArray
    label: IntArray
    carrier: IntArray
    surfaces: QuadricTable
    on_corner: BoolArray
    borders: list[tuple[BorderSide, ...]]


def intersect_patches(a: Arrangement) -> Arrangement:
    """The arrangement with the arcs of all candidate pairs, their curves and the vertices inside patches."""
    o = a.operands
    pairs = _group_pairs(a)
    patches = [o.patches[c] for c in pairs.carrier.tolist()]
    traces = _march_classes(o, patches, pairs)
    fitted, first_fitted = _fit_all_arcs(a, traces, pairs)
    arcs, points = _scatter_arcs(a, traces, pairs, fitted, first_fitted)
    return replace(
        a,
        arcs=arcs,
        curves=(*o.curves, *(arc.curve for arc in fitted)),
        vertices=np.vstack([a.vertices, points]),
    ).snap_vertices()


def _march_classes(o: Operands, patches: list[BSplineSurface], pairs: _PairClasses) -> list[Trace]:
    """The traces of all classes."""
    zero_tol = ZERO_FRACTION_OF_TOL * o.fit_tol
    free_form = pairs.surfaces.is_free_form
    others = np.flatnonzero(~free_form)
    made = march_patches(
        [patches[i] for i in others.tolist()],
        pairs.surfaces.take(others),
        [pairs.borders[i] for i in others.tolist()],
        pairs.on_corner[others],
        zero_tol,
    )
    traces = dict(zip(others.tolist(), made, strict=True))
    at = np.flatnonzero(free_form)
    made = march_masked_patches(
        [patches[i] for i in at.tolist()],
        pairs.surfaces.take(at),
        [pairs.borders[i] for i in at.tolist()],
        pairs.on_corner[at],
        zero_tol,
        [
            partial(_measure_border_distances, o, int(pairs.face[pair]), int(pairs.surface[pair]))
            for pair in pairs.first[at]
        ],
    )
    traces |= zip(at.tolist(), made, strict=True)
    return [traces[i] for i in range(len(patches))]


def _measure_border_distances(o: Operands, face: int, surface: int, points: Array) -> Array:
    """Distances (n,) of points (n, 3) in the frame of a patch from the borders of the faces on a surface, negative in a face."""
    there = o.lattice.faces.motion[face].apply(points)
    inside, distance = np.zeros(len(points), bool), np.full(len(points), np.inf)
    for f in np.flatnonzero(o.body.surface_of_face == surface).tolist():
        inside |= o.regions[f].contains(there)
        distance = np.minimum(distance, o.regions[f].distance_to_border(there))
    return np.where(inside, -distance, distance)


def _group_pairs(a: Arrangement) -> _PairClasses:
    """The congruence classes of the candidate pairs."""
    o, faces = a.operands, a.operands.lattice.faces
    face, surface = np.nonzero(o.candidates)
    surfaces = o.body.surfaces.take(np.arange(o.body.n_surfaces))
    framed = surfaces.take(surface).in_frames(faces.motion[face])
    corner_on = a.on_surface[o.sides.corner[face], surface[:, None]]
    on_side = np.logical_or.reduceat(a.edge_roots.initial_sign[o.sides.edge] == 0, o.sides.first[:-1])
    side_coincident = on_side.reshape(len(faces), 4, -1)[face, :, surface]
    n_uses = np.diff(o.sides.first).reshape(-1, 4)[face]
    degenerate = corner_on.any(axis=1) | side_coincident.any(axis=1)
    flip = np.where((framed.leading_coordinate() < 0) & ~degenerate & framed.is_plane, -1, 1)
    framed = framed.flip_planes(flip)
    size = max((float(np.ptp(patch.poles)) for patch in o.patches.values()), default=1.0)
    key = np.column_stack([faces.carrier[face], framed.congruence_key(size), corner_on, side_coincident, n_uses])
    first, label = group_rows(key)
    return _PairClasses(
        face,
        surface,
        flip,
        first,
        label,
        faces.carrier[face[first]],
        framed.take(first),
        corner_on[first],
        [_collect_borders(a, int(face[p]), int(surface[p]), int(flip[p])) for p in first],
    )


def _collect_borders(a: Arrangement, face: int, surface: int, flip: int) -> tuple[BorderSide, ...]:
    """The four sides of a patch as its edges see the surface, whose orientation is multiplied by `flip`.

    TrimmingError if a T-vertex of a side lies in the surface, or if one of its edges lies in the surface and another does not.
    The sign of a free-form distance may jump along a side.
    """
    sides = a.operands.sides
    may_jump = bool(a.operands.body.surfaces.is_free_form[surface])
    result = []
    for side in range(4):
        uses = sides.uses_on(face, side)
        parts = [_read_border(a, u, surface, flip) for u in uses]
        if a.on_surface[sides.vertex[uses[1:]], surface].any() and any(part.sign for part in parts):
            at = a.vertices[sides.vertex[uses[1]]].round(6)
            raise TrimmingError(f"a surface of the body passes through a T-vertex of the lattice near {at}")
        signs = [(part.sign, part.sign * (-1) ** len(part.roots)) for part in parts]
        if not may_jump and any(before[1] != after[0] for before, after in pairwise(signs)):
            raise TrimmingError("two edges on the side of a patch disagree on the side of their common vertex")
        result.append(BorderSide(np.concatenate([part.roots for part in parts]), parts[0].sign))
    return tuple(result)


def _read_border(a: Arrangement, use: int, surface: int, flip: int) -> BorderSide:
    """What one edge use says about its part of a side."""
    sides, roots = a.operands.sides, a.edge_roots
    edge = int(sides.edge[use])
    low, high = a.edges.span[edge]
    x = (roots.roots_of(edge, surface) - low) / (high - low)
    sign = int(roots.initial_sign[edge, surface]) * flip
    if not sides.forward[use]:
        x, sign = 1.0 - x[::-1], sign * (-1) ** len(x)
    begin, end = sides.span[use]
    return BorderSide(begin + (end - begin) * x, sign)


def _fit_all_arcs(a: Arrangement, traces: list[Trace], pairs: _PairClasses) -> tuple[tuple[FittedArc, ...], IntArray]:
    """The fitted arcs of all classes, in order, and the first one of each class; batched by spline space."""
    owner = np.repeat(np.arange(len(traces)), [len(trace.arcs) for trace in traces])
    paths = [CoarsePath(arc.path, trace.foci) for trace in traces for arc in trace.arcs]
    patches = [a.operands.patches[c] for c in pairs.carrier[owner].tolist()]
    fitted: list[FittedArc | None] = [None] * len(paths)
    spaces: dict[tuple[int, int, bytes, bytes, bool], list[int]] = {}
    for i, s in enumerate(patches):
        is_plane = bool(pairs.surfaces.is_plane[owner[i]])
        key = (s.degree_u, s.degree_v, s.knots_u.tobytes(), s.knots_v.tobytes(), is_plane)
        spaces.setdefault(key, []).append(i)
    for members in spaces.values():
        made = fit_arcs(
            [patches[i] for i in members],
            pairs.surfaces.take(owner[np.array(members)]),
            [paths[i] for i in members],
            a.operands.fit_tol,
        )
        for i, arc in zip(members, made, strict=True):
            fitted[i] = arc
    return tuple(arc for arc in fitted if arc is not None), np.searchsorted(owner, np.arange(len(traces)))


def _scatter_arcs(
    a: Arrangement, traces: list[Trace], pairs: _PairClasses, fitted: tuple[FittedArc, ...], first_fitted: IntArray
) -> tuple[PatchArcs, Array]:
    """The arcs of every pair, from those of its class, and the points of new vertices inside patches (n, 3)."""
    faces, patches = a.operands.lattice.faces, a.operands.patches
    face, surface, flip, label = pairs.face, pairs.surface, pairs.flip, pairs.label
    beside = {
        (int(face[p]), int(surface[p])): flip[p] * traces[label[p]].sign_beside_side
        for p in np.flatnonzero(np.array([trace.sign_beside_side.any() for trace in traces], bool)[label])
    }
    rows: list[tuple[int, ...]] = []
    points: list[Array] = []
    for p in np.flatnonzero(np.array([len(trace.arcs) > 0 for trace in traces], bool)[label]):
        trace, f, k = traces[label[p]], int(face[p]), int(surface[p])
        first_point = len(a.vertices) + len(points)
        if len(trace.points):
            local = patches[int(faces.carrier[f])](trace.points[:, 0], trace.points[:, 1])
            points.extend(faces.motion[f].apply(local))
        for i, arc in enumerate(trace.arcs):
            ends = [_find_end_vertex(a, end, f, k, first_point) for end in (arc.start, arc.end)]
            rows.append((f, k, first_fitted[label[p]] + i, int(flip[p]), *ends))
    table = np.array(rows, np.int64).reshape(-1, 6).T
    arcs = PatchArcs(fitted, table[0], table[1], table[2], table[3], table[4], table[5], beside, len(pairs.first))
    return arcs, np.array(points).reshape(-1, 3)


def _find_end_vertex(a: Arrangement, end: ArcEnd, face: int, surface: int, first_point: int) -> int:
    """The vertex at the end of a class's arc on one of its patches."""
    kind, i, j = end
    sides, roots = a.operands.sides, a.edge_roots
    if kind == "point":
        return first_point + i
    if kind == "corner":
        return int(sides.vertex[sides.uses_on(face, i)[0]])
    for use in sides.uses_on(face, i):
        pair = roots.row_of_pair[sides.edge[use], surface]
        count = int(roots.root_start[pair + 1] - roots.root_start[pair]) if pair >= 0 else 0
        if j < count:
            return int(a.edge_root_vertex[roots.root_start[pair] + (j if sides.forward[use] else count - 1 - j)])
        j -= count
    raise TrimmingError(f"congruent patches have different intersections with surface {surface} on their borders")


def collect_imprints(a: Arrangement) -> Arrangement:
    """The arrangement with its imprints: the arcs, then every lattice edge that lies in exactly one surface."""
    o, arcs = a.operands, a.arcs
    e, faces = o.lattice.edges, o.lattice.faces
    coincident = a.edge_roots.initial_sign == 0
    edge, surface = np.nonzero(coincident & (coincident.sum(axis=1) == 1)[:, None])
    n_arcs, n_edges = len(arcs.face), len(edge)
    imprints = IntersectionCurves(
        curve_segments=CurveSegments(
            curve=np.concatenate([len(o.curves) + arcs.fitted_index, e.curve[edge]]),
            motion=Motion.concatenate([faces.motion[arcs.face], e.motion[edge]]),
            span=np.concatenate([np.tile([0.0, 1.0], (n_arcs, 1)), e.span[edge]]),
            start=np.concatenate([arcs.start, e.start[edge]]),
            end=np.concatenate([arcs.end, e.end[edge]]),
        ),
        surface=np.concatenate([arcs.surface, surface]),
        face=np.concatenate([arcs.face, np.full(n_edges, -1)]),
        edge=np.concatenate([np.full(n_arcs, -1), edge]),
        sense=np.concatenate([arcs.sense, np.zeros(n_edges, np.int64)]),
    )
    return replace(a, imprints=imprints)
