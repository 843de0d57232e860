"""Every patch against every surface that it may meet: classes, traced and fitted once, and the arcs they leave on each patch.

The surface is brought into the primitive's frame. Patches that see it from the same place (to 1e-9 in direction, 1e-10 of the
patch in distance) are a class; planes seen from either side are one class, turned round.

Tracks: the curves that lattice and body's surfaces have in common, arcs across patches and lattice edges in a surface.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.brep.boundary_representation import Brep
from tpmscad.errors import TrimmingError
from tpmscad.rigid_motion import Motion
from tpmscad.splines.bspline import BSplineSurface
from tpmscad.trimming.intersect import arc_fitting, marching
from tpmscad.trimming.intersect.curve_surface import ZERO_FRACTION_OF_TOL, CurveSegments, CurveSurfaceIntersections
from tpmscad.trimming.intersect.marching_batched import march_patches
from tpmscad.trimming.intersect.patch_borders import BorderSide
from tpmscad.trimming.operands.implicit_surfaces import ImplicitSurfaces
from tpmscad.trimming.operands.patch_sides import PatchSides


@dataclass(frozen=True, slots=True, eq=False)
class PatchArcs:
    """What the surfaces do to the patches.

    Arcs, in flat arrays: face, surface, which of `cuts`, +1 or -1 if the surface's negative side is on the left or right of its
    parameter, start and end vertex along the parameter. `points`: the vertices made here, in order. `side_sign`: by patch and
    surface the signs next to the patch's sides (4,), where one lies in the surface.
    """

    fitted_arcs: tuple[arc_fitting.FittedArc, ...]
    face: IntArray
    surface: IntArray
    cut: IntArray
    sense: IntArray
    start: IntArray
    end: IntArray
    points: Array
    sign_beside_sides: dict[tuple[int, int], IntArray]
    n_classes: int


def intersect_patches(
    brep: Brep,
    sides: PatchSides,
    levels: ImplicitSurfaces,
    near: BoolArray,
    on: BoolArray,
    crossings: CurveSurfaceIntersections,
    vertex_of_root: IntArray,
    first_vertex: int,
    tol: float,
) -> PatchArcs:
    """Trace surfaces on the patches `near` them (F, K). `on` (V, K), `crossings`: the lattice's vertices and edges on them."""
    faces = brep.faces
    face, surface = np.nonzero(near)
    seen = levels.of(surface).in_frames(faces.motion[face])
    corner_on = on[sides.corner[face], surface[:, None]]
    side_flat = crossings.sign[sides.edge[face], surface[:, None]] == 0
    special = corner_on.any(axis=1) | side_flat.any(axis=1)
    rounded = np.round(seen.axis, 9) + 0.0
    leading = rounded[np.arange(len(face)), (rounded != 0).argmax(axis=1)]
    turn = np.where((leading < 0) & ~special & seen.flat, -1, 1)
    seen = seen.flip_planes(turn)
    size = max((float(np.ptp(c.poles)) for c in brep.carriers if isinstance(c, BSplineSurface)), default=1.0)
    key = np.column_stack([faces.carrier[face], seen.key(size), corner_on, side_flat])
    _, first, label = np.unique(key, axis=0, return_index=True, return_inverse=True)
    label = label.ravel()

    carrier, seen = faces.carrier[face[first]], seen.of(first)
    borders = [_collect_borders(brep, sides, crossings, int(face[p]), int(surface[p]), int(turn[p])) for p in first]
    patches = [patch for patch in (brep.carriers[c] for c in carrier) if isinstance(patch, BSplineSurface)]
    traces = march_patches(patches, seen, borders, corner_on[first], ZERO_FRACTION_OF_TOL * tol)
    cuts, first_cut = _fit_all_arcs(brep, traces, carrier, seen, tol)

    side_sign = {
        (int(face[p]), int(surface[p])): turn[p] * traces[label[p]].sign_beside_side
        for p in np.flatnonzero(np.array([trace.sign_beside_side.any() for trace in traces], bool)[label])
    }
    rows: list[tuple[int, ...]] = []
    points: list[Array] = []
    for p in np.flatnonzero(np.array([len(trace.arcs) > 0 for trace in traces], bool)[label]):
        trace, f, k = traces[label[p]], int(face[p]), int(surface[p])
        own = first_vertex + len(points)
        patch = brep.carriers[faces.carrier[f]]
        assert isinstance(patch, BSplineSurface)
        if len(trace.points):
            local = patch(trace.points[:, 0], trace.points[:, 1])
            points.extend(faces.motion[f].apply(local))
        for a, arc in enumerate(trace.arcs):
            ends = [_find_end_vertex(end, sides, crossings, vertex_of_root, f, k, own) for end in (arc.start, arc.end)]
            rows.append((f, k, first_cut[label[p]] + a, int(turn[p]), *ends))
    face, surface, cut, sense, start, end = np.array(rows, np.int64).reshape(-1, 6).T
    return PatchArcs(
        cuts, face, surface, cut, sense, start, end, np.array(points).reshape(-1, 3), side_sign, len(first)
    )


def _collect_borders(
    brep: Brep, sides: PatchSides, crossings: CurveSurfaceIntersections, face: int, surface: int, turn: int
) -> tuple[BorderSide, ...]:
    """The four sides of a patch as its edges know them, for the surface turned by `turn`."""
    result = []
    for edge, forward in zip(sides.edge[face], sides.forward[face], strict=True):
        low, high = brep.edges.span[edge]
        x = (crossings.of(edge, surface) - low) / (high - low)
        sign = int(crossings.sign[edge, surface]) * turn
        result.append(BorderSide(x, sign) if forward else BorderSide(1.0 - x[::-1], sign * (-1) ** len(x)))
    return tuple(result)


def _fit_all_arcs(
    brep: Brep, traces: list[marching.Trace], carrier: IntArray, levels: ImplicitSurfaces, tol: float
) -> tuple[tuple[arc_fitting.FittedArc, ...], IntArray]:
    """Curves of all arcs of all classes, in order, and where each class's begin."""
    owner = np.repeat(np.arange(len(traces)), [len(trace.arcs) for trace in traces])
    paths = [arc.path for trace in traces for arc in trace.arcs]
    foci = [trace.foci for trace in traces for _ in trace.arcs]
    cuts: list[arc_fitting.FittedArc | None] = [None] * len(paths)
    spaces: dict[tuple[int, int, bytes, bytes, bool], list[int]] = {}
    patches = []
    for i, c in enumerate(carrier[owner]):
        s = brep.carriers[c]
        assert isinstance(s, BSplineSurface)
        patches.append(s)
        key = (s.degree_u, s.degree_v, s.knots_u.tobytes(), s.knots_v.tobytes(), bool(levels.flat[owner[i]]))
        spaces.setdefault(key, []).append(i)
    for members in spaces.values():
        at = np.array(members)
        fitted = arc_fitting.fit_arcs(
            [patches[i] for i in members],
            levels.of(owner[at]),
            [paths[i] for i in members],
            [foci[i] for i in members],
            tol,
        )
        for i, cut in zip(members, fitted, strict=True):
            cuts[i] = cut
    return tuple(c for c in cuts if c is not None), np.searchsorted(owner, np.arange(len(traces)))


def _find_end_vertex(
    end: marching.ArcEnd,
    sides: PatchSides,
    crossings: CurveSurfaceIntersections,
    vertex_of_root: IntArray,
    face: int,
    surface: int,
    first_point: int,
) -> int:
    """The vertex in which an arc of a class ends on one of its patches."""
    kind, i, j = end
    if kind == "point":
        return first_point + i
    if kind == "corner":
        return int(sides.corner[face, i])
    edge = sides.edge[face, i]
    pair = crossings.row_of_pair[edge, surface]
    count = crossings.root_start[pair + 1] - crossings.root_start[pair] if pair >= 0 else 0
    if j >= count:
        raise TrimmingError(f"patches that see surface {surface} from the same place differ on their borders")
    return int(vertex_of_root[crossings.root_start[pair] + (j if sides.forward[face, i] else count - 1 - j)])


@dataclass(frozen=True, slots=True, eq=False)
class IntersectionCurves:
    """T curve pieces, the A arcs first; `strands.curve` numbers the lattice's curves, then the cuts'.

    `surface` (T,): where it lies. `face` (T,): the patch of an arc, or -1. `edge` (T,): the lattice edge, or -1 for arcs.
    `sense` (T,): +1 where the surface's negative side of the patch is on the left of an arc's parameter, else -1; 0 for edges.
    """

    curve_segments: CurveSegments
    surface: IntArray
    face: IntArray
    edge: IntArray
    sense: IntArray

    def __len__(self) -> int:
        return len(self.surface)


def collect_intersection_curves(
    lattice: Brep, cuts: PatchArcs, crossings: CurveSurfaceIntersections
) -> IntersectionCurves:
    """The arcs, then every lattice edge that lies in one surface; an edge in two is left to its neighbours."""
    e, faces = lattice.edges, lattice.faces
    flat = crossings.sign == 0
    edge, surface = np.nonzero(flat & (flat.sum(axis=1) == 1)[:, None])
    arcs, flats = len(cuts.face), len(edge)
    return IntersectionCurves(
        curve_segments=CurveSegments(
            curve=np.concatenate([len(lattice.curves) + cuts.cut, e.curve[edge]]),
            motion=Motion.concatenate([faces.motion[cuts.face], e.motion[edge]]),
            span=np.concatenate([np.tile([0.0, 1.0], (arcs, 1)), e.span[edge]]),
            start=np.concatenate([cuts.start, e.start[edge]]),
            end=np.concatenate([cuts.end, e.end[edge]]),
        ),
        surface=np.concatenate([cuts.surface, surface]),
        face=np.concatenate([cuts.face, np.full(flats, -1)]),
        edge=np.concatenate([np.full(arcs, -1), edge]),
        sense=np.concatenate([cuts.sense, np.zeros(flats, np.int64)]),
    )
