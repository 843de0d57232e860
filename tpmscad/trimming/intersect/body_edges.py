"""Parameters of points along the body's edges: lines, circles, ellipses and B-splines.

The points in which the body's edges meet the lattice: a vertex each, on the edge and on the tracks of both its faces.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.brep.boundary_representation import Brep
from tpmscad.brep.carriers import Circle, EdgeCurve, Ellipse
from tpmscad.brep.conics import TWO_PI
from tpmscad.errors import TrimmingError
from tpmscad.splines.bspline import BSplineCurve, BSplineSurface
from tpmscad.trimming.intersect.curve_surface import CurveSegments, CurveSurfaceIntersections, evaluate_segments
from tpmscad.trimming.intersect.patch_surface import IntersectionCurves, PatchArcs
from tpmscad.trimming.operands.implicit_surfaces import ImplicitSurfaces
from tpmscad.trimming.operands.trimming_body import TrimmingBody

SAMPLES_PER_CURVE = 129
"""Samples along a curve without a closed form, between which the nearest point is found by Newton's method."""


def project_to_curve(curve: EdgeCurve, span: Array, points: Array) -> tuple[Array, Array]:
    """Parameters (n,) of the curve's points next to points (n, 3), and how far apart they are.

    Angles are given as near as possible to the middle of the span.
    """
    if isinstance(curve, BSplineCurve) and curve.degree == 1 and len(curve.poles) == 2:
        low, high = curve.domain
        way = curve.poles[1] - curve.poles[0]
        t = low + (high - low) * ((points - curve.poles[0]) @ way) / float(way @ way)
    elif isinstance(curve, Circle | Ellipse):
        arm = points - curve.origin
        x, y = arm @ curve.x_axis, arm @ curve.y_axis
        if isinstance(curve, Circle):
            t = np.arctan2(y, x)
        else:
            t = _minimise_distance(curve, np.arctan2(y / curve.minor, x / curve.major), points)
        middle = 0.5 * (span[0] + span[1])
        t = middle + (t - middle + TWO_PI / 2) % TWO_PI - TWO_PI / 2
    else:
        at = np.linspace(span[0], span[1], SAMPLES_PER_CURVE)
        apart = np.linalg.norm(points[:, None] - curve(at), axis=2)
        t = np.clip(_minimise_distance(curve, at[apart.argmin(axis=1)], points), span[0], span[1])
    return t, np.linalg.norm(curve(t) - points, axis=1)


def _minimise_distance(curve: EdgeCurve, t: Array, points: Array) -> Array:
    for _ in range(8):
        gap, first, second = curve(t) - points, curve(t, 1), curve(t, 2)
        slope = (gap * first).sum(axis=1)
        bend = (first * first).sum(axis=1) + (gap * second).sum(axis=1)
        t = t - slope / np.where(bend > 0, bend, (first * first).sum(axis=1))
        if isinstance(curve, BSplineCurve):
            t = np.clip(t, *curve.domain)
    return t


MAX_MISMATCH_TOLS = 100.0
"""The same point found along two tracks differs by their deviations over the sine of their angle: up to this many tolerances."""

ON_EDGE_SNAPS = 4.0
"""A vertex on both of an edge's levels that is nearer to the edge than this many snaps lies on it."""

NEWTON_STEPS = 4
"""Newton steps to a hit, from a point that is off by a few tolerances."""


@dataclass(frozen=True, slots=True, eq=False)
class BodyEdgeIntersections:
    """Where body edges meet the lattice.

    `edge`, `t`, `vertex` (H,): a vertex inside an edge, at the edge's parameter. `corner`: by vertices of the body, the vertex
    that is one. `track`, `root`, `root_vertex` (R,): the parameters at which tracks pass hits. `points`: the new vertices.
    """

    edge: IntArray
    t: Array
    vertex: IntArray
    corner: dict[int, int]
    curve_index: IntArray
    root: Array
    root_vertex: IntArray
    points: Array


def intersect_body_edges(
    lattice: Brep,
    body: TrimmingBody,
    cuts: PatchArcs,
    tracks: IntersectionCurves,
    curves: Sequence[BSplineCurve],
    roots: CurveSurfaceIntersections,
    crossings: CurveSurfaceIntersections,
    vertex_of_root: IntArray,
    vertices: Array,
    on: BoolArray,
    tol: float,
    snap: float,
) -> BodyEdgeIntersections:
    """All hits. `roots`: of tracks on companions; `crossings`, `vertex_of_root`: of lattice edges; `on` (V, levels).

    TrimmingError where the tracks of an edge's two faces do not agree on the points that they share.
    """
    places = evaluate_segments(curves, tracks.curve_segments, roots.root_segment, roots.root)
    rows: list[tuple[int, float, int]] = []
    passed: list[tuple[int, float, int]] = []
    points: list[Array] = []
    pairs = [_pair_roots(body, tracks, roots, places, e, tol, snap) for e in range(len(body.curves))]
    edge = np.concatenate([np.zeros(0, np.int64), *(np.full(len(p), e) for e, p in enumerate(pairs))])
    pair = np.concatenate([np.zeros((0, 2), np.int64), *pairs])
    if len(pair):
        own, other = body.levels.of(tracks.surface[roots.root_segment[pair[:, 0]]]), roots.root_surface[pair[:, 0]]
        start = _evaluate_patch_parameters(cuts, tracks, roots, pair[:, 0])
        moved = tracks.face[roots.root_segment[pair[:, 0]]] >= 0
        found = places[pair[:, 0]].copy()
        face = tracks.face[roots.root_segment[pair[moved, 0]]]
        found[moved] = _project_to_two_surfaces(
            lattice, face, start[moved], own.of(np.flatnonzero(moved)), body.levels.of(other[moved])
        )
        root = _project_to_arcs(curves, tracks, roots, pair, found)
        for i, (e, p, x) in enumerate(zip(edge.tolist(), pair, root, strict=True)):
            vertex = len(vertices) + i
            rows.append((e, 0.0, vertex))
            points.append(found[i])
            passed += [(int(roots.root_segment[r]), float(t), vertex) for r, t in zip(p, x, strict=True) if r >= 0]
    ends, corner = _match_existing_vertices(body, tracks, crossings, vertex_of_root, vertices, on, snap)
    rows += ends
    known = {v for _, _, v in ends} | set(corner.values())
    flat_of = {(int(e), i) for i, e in enumerate(tracks.edge) if e >= 0}
    if known and flat_of:
        passed += _match_coincident_edges(tracks, crossings, vertex_of_root, known)
    everything = np.vstack([vertices, np.array(points).reshape(-1, 3)])
    table = np.array([(e, v) for e, _, v in rows], np.int64).reshape(-1, 2)
    t = np.zeros(len(table))
    for e in np.unique(table[:, 0]):
        at = np.flatnonzero(table[:, 0] == e)
        t[at] = project_to_curve(body.curves[e], body.brep.edges.span[e], everything[table[at, 1]])[0]
    split = np.array([(a, v) for a, _, v in passed], np.int64).reshape(-1, 2)
    return BodyEdgeIntersections(
        edge=table[:, 0],
        t=t,
        vertex=table[:, 1],
        corner=corner,
        curve_index=split[:, 0],
        root=np.array([x for _, x, _ in passed], float),
        root_vertex=split[:, 1],
        points=np.array(points).reshape(-1, 3),
    )


def _pair_roots(
    body: TrimmingBody,
    tracks: IntersectionCurves,
    roots: CurveSurfaceIntersections,
    places: Array,
    edge: int,
    tol: float,
    snap: float,
) -> IntArray:
    """Roots that are one point of a body edge, on a track of either face; the second is -1 where there is but one track."""
    edges = body.brep.edges
    surface = body.surface[body.face_of_use[body.uses[edge]]]
    sides = []
    for s in (0, 1):
        c = body.separating_surface[edge, s]
        rows = np.flatnonzero((roots.root_surface == c) & (tracks.surface[roots.root_segment] == surface[s]))
        if len(rows):
            span = edges.span[edge]
            t, apart = project_to_curve(body.curves[edge], span, places[rows])
            rows = rows[(apart < MAX_MISMATCH_TOLS * tol + 2 * edges.deviation[edge]) & (t >= span[0]) & (t <= span[1])]
        sides.append(rows)
    ends = body.brep.vertices[[edges.start[edge], edges.end[edge]]]
    for row in np.concatenate(sides):
        if np.linalg.norm(places[row] - ends, axis=1).min() < 2 * snap:
            raise TrimmingError(f"a patch passes a vertex of the body at {places[row].round(6)}, or nearly")
    if surface[0] == surface[1]:
        return np.column_stack([sides[0], np.full(len(sides[0]), -1)])
    alone = [
        row for side in sides for row in side[tracks.face[roots.root_segment[side]] < 0]
    ]  # lattice edges: no partner
    result = [(int(row), -1) for row in alone]
    first, second = (side[tracks.face[roots.root_segment[side]] >= 0] for side in sides)
    for face in np.unique(tracks.face[roots.root_segment[np.concatenate([first, second])]]):
        a, b = (side[tracks.face[roots.root_segment[side]] == face] for side in (first, second))
        if len(a) != len(b):
            raise TrimmingError(
                f"the faces of a body's edge see it met {len(a)} and {len(b)} times on one patch, "
                f"near {places[np.concatenate([a, b])[0]].round(6)}"
            )
        left = set(b.tolist())
        for i in a.tolist():
            j = min(left, key=lambda j: float(np.linalg.norm(places[i] - places[j])))
            if np.linalg.norm(places[i] - places[j]) > MAX_MISMATCH_TOLS * tol:
                raise TrimmingError(f"two cuts on one patch do not meet in one point near {places[i].round(6)}")
            left.remove(j)
            result.append((i, j))
    return np.array(result, np.int64).reshape(-1, 2)


def _evaluate_patch_parameters(
    cuts: PatchArcs, tracks: IntersectionCurves, roots: CurveSurfaceIntersections, rows: IntArray
) -> Array:
    """(u, v) of roots on arcs; zeros on lattice edges: (n, 2)."""
    result = np.zeros((len(rows), 2))
    for i, row in enumerate(rows.tolist()):
        track = roots.root_segment[row]
        if tracks.face[track] >= 0:
            result[i] = cuts.fitted_arcs[cuts.cut[track]].pcurve(roots.root[row])
    return result


def _project_to_two_surfaces(
    lattice: Brep, face: IntArray, uv: Array, own: ImplicitSurfaces, other: ImplicitSurfaces
) -> Array:
    """Points on patches and on two levels each, by Newton's method from (u, v) (m, 2): (m, 3)."""
    motion = lattice.faces.motion[face]
    first, second = own.in_frames(motion), other.in_frames(motion)
    local = np.empty((len(face), 3))
    for carrier in np.unique(lattice.faces.carrier[face]):
        at = np.flatnonzero(lattice.faces.carrier[face] == carrier)
        patch = lattice.carriers[carrier]
        assert isinstance(patch, BSplineSurface)
        a, b = first.of(at), second.of(at)
        p = uv[at]
        for _ in range(NEWTON_STEPS):
            point = patch(p[:, 0], p[:, 1])
            jets = [level.jet(point[:, None], 1) for level in (a, b)]
            g = np.stack([j[0][:, 0] for j in jets], axis=1)
            gradient = np.stack([j[1][:, 0] for j in jets], axis=1)
            slope = np.stack([patch(p[:, 0], p[:, 1], *d) for d in ((1, 0), (0, 1))], axis=2)
            p = p - np.linalg.solve(gradient @ slope, g[..., None])[..., 0]
        local[at] = patch(p[:, 0], p[:, 1])
    return motion.apply(local)


def _project_to_arcs(
    curves: Sequence[BSplineCurve],
    tracks: IntersectionCurves,
    roots: CurveSurfaceIntersections,
    pair: IntArray,
    points: Array,
) -> Array:
    """The parameters (m, 2) of the tracks' points next to the hits: along a track the companion's root is off by more."""
    result = np.zeros(pair.shape)
    for side in (0, 1):
        there = np.flatnonzero(pair[:, side] >= 0)
        strand, t = roots.root_segment[pair[there, side]], roots.root[pair[there, side]]
        for _ in range(2):
            along = _evaluate_tangents(curves, tracks.curve_segments, strand, t)
            gap = points[there] - evaluate_segments(curves, tracks.curve_segments, strand, t)
            t = t + np.einsum("ni,ni->n", gap, along) / np.einsum("ni,ni->n", along, along)
        result[there, side] = t
    return result


def _evaluate_tangents(curves: Sequence[BSplineCurve], strands: CurveSegments, index: IntArray, t: Array) -> Array:
    local = np.array([curves[strands.curve[i]](x, 1) for i, x in zip(index, t, strict=True)]).reshape(-1, 3)
    return strands.motion[index].apply_to_vectors(local)


def _match_existing_vertices(
    body: TrimmingBody,
    tracks: IntersectionCurves,
    crossings: CurveSurfaceIntersections,
    vertex_of_root: IntArray,
    vertices: Array,
    on: BoolArray,
    snap: float,
) -> tuple[list[tuple[int, float, int]], dict[int, int]]:
    """Vertices that tracks have anyhow and that lie on body edges: (edge, 0, vertex), and those at the body's vertices."""
    flat = np.unique(tracks.edge[tracks.edge >= 0])
    at_flats = vertex_of_root[np.isin(crossings.root_segment, flat)]
    candidates = np.unique(np.concatenate([tracks.curve_segments.start, tracks.curve_segments.end, at_flats]))
    edges = body.brep.edges
    rows: set[tuple[int, float, int]] = set()
    corner: dict[int, int] = {}
    for e in range(len(body.curves)):
        surface = body.surface[body.face_of_use[body.uses[e]]]
        on_both = np.zeros(len(candidates), bool)
        for s in (0, 1):
            on_both |= on[candidates, surface[s]] & on[candidates, body.separating_surface[e, s]]
        v = candidates[on_both]
        if len(v) == 0:
            continue
        span = edges.span[e]
        t, apart = project_to_curve(body.curves[e], span, vertices[v])
        ends = (int(edges.start[e]), int(edges.end[e]))
        to_end = np.stack([np.linalg.norm(vertices[v] - body.brep.vertices[w], axis=1) for w in ends])
        for i in np.flatnonzero((to_end < ON_EDGE_SNAPS * snap).any(axis=0)):
            w = ends[int(to_end[:, i].argmin())]
            if corner.setdefault(w, int(v[i])) != v[i]:
                raise TrimmingError(f"several vertices lie at the body's vertex {body.brep.vertices[w]}")
        near = (apart < ON_EDGE_SNAPS * snap + 2 * edges.deviation[e]) & (t > span[0]) & (t < span[1])
        near &= (to_end >= ON_EDGE_SNAPS * snap).all(axis=0)
        rows |= {(e, 0.0, int(x)) for x in v[near]}
    return sorted(rows), corner


def _match_coincident_edges(
    tracks: IntersectionCurves, crossings: CurveSurfaceIntersections, vertex_of_root: IntArray, hits: set[int]
) -> list[tuple[int, float, int]]:
    """Where lattice edges that lie in a surface pass hits at their own roots."""
    result = []
    rows: dict[int, list[int]] = {}
    for r in np.flatnonzero(np.isin(vertex_of_root, list(hits))).tolist():
        rows.setdefault(int(crossings.root_segment[r]), []).append(r)
    for i in np.flatnonzero(tracks.edge >= 0).tolist():
        seen = set()
        for r in rows.get(int(tracks.edge[i]), []):
            if int(vertex_of_root[r]) not in seen:
                seen.add(int(vertex_of_root[r]))
                result.append((i, float(crossings.root[r]), int(vertex_of_root[r])))
    return result
