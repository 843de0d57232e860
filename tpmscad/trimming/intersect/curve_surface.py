"""Intersection of placed curve segments with implicit surfaces, computed once for each congruence class of pairs.

Along a segment, the distance from a surface is sampled together with its derivative. Every change of sign brackets a root; every
extremum between two samples is found by Newton's method, so that a pair of roots between samples is not missed. Congruent pairs
(the same curve and span, the same surface in the curve's local frame) share their roots.

Degenerate cases are decided symbolically. A vertex nearer to a surface than the vertex tolerance (`snap`) lies *on* it and counts
as positive; a segment that ends there has no root within a few `snap` of it, so that no edge is shorter than that. A segment all
of whose points are nearer than `snap` is coincident with the surface and has the sign 0.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.brep.carriers import EdgeCurve
from tpmscad.errors import TrimmingError
from tpmscad.splines.basis import design_matrix
from tpmscad.splines.bspline import BSplineCurve
from tpmscad.trimming.intersect.arrangement import (
    MARGIN_SNAPS,
    Arrangement,
    CurveSegments,
    CurveSurfaceIntersections,
    SubSegments,
)
from tpmscad.trimming.operands.quadric_table import QuadricTable, group_rows

SAMPLES_PER_SEGMENT = 34
"""Samples along a segment; between two samples the distance is assumed to have at most one extremum."""

MIN_EDGE_SNAPS = 3.0
"""Distance, in vertex tolerances, below which a root merges with a vertex on the surface."""

MIN_SPEED_FRACTION = 1e-3
"""Lower bound of a curve's speed at the ends of a segment, relative to its mean speed."""

TANGENCY_SAMPLES = 9
"""Samples from a root to a vertex on the surface, at which a segment must leave the surface for the root to count."""

TOUCH_FRACTION_OF_SIZE = 1e-13
"""Distance of an extremum, relative to the curve's size, up to which it touches the surface: round-off is 100 times smaller."""

ROOT_RTOL = 4e-16
"""Step of the bracketed Newton method, relative to the parameter or to 1, at which a root has converged."""

MAX_ROOT_STEPS = 100
"""Largest number of steps of the bracketed Newton method."""

MAX_NEWTON_STEPS = 40
"""Steps after which it only bisects: at a jump Newton's steps may stay within the bracket and never converge."""


def evaluate_segments(curves: Sequence[EdgeCurve], segments: CurveSegments, index: IntArray, t: Array) -> Array:
    """Points at parameters t (m,) of the segments `index` (m,): (m, 3)."""
    local = np.empty((len(t), 3))
    owner = segments.curve[index]
    order = np.argsort(owner, kind="stable")
    bounds = np.flatnonzero(np.diff(owner[order])) + 1
    for at in np.split(order, bounds):
        if len(at):
            local[at] = curves[owner[at[0]]](t[at])
    return segments.motion[index].apply(local)


def intersect_lattice_edges(a: Arrangement) -> Arrangement:
    """The arrangement with the intersections of the lattice's edges with the body's surfaces, and a vertex for each."""
    o = a.operands
    wanted = np.zeros((len(a.edges), len(o.body.surfaces)), bool)
    use, surface = np.nonzero(o.candidates[o.sides.face])
    wanted[o.sides.edge[use], surface] = True
    roots = intersect_segments(o.curves, a.edges, o.body.surfaces, a.on_surface, wanted, o.snap, o.zero_tol)
    vertex, points = _assign_root_vertices(o.curves, a.edges, roots, len(a.vertices), o.snap)
    return replace(a, edge_roots=roots, edge_root_vertex=vertex, vertices=np.vstack([a.vertices, points]))


def intersect_segments(
    curves: Sequence[BSplineCurve],
    segments: CurveSegments,
    surfaces: QuadricTable,
    on_surface: BoolArray,
    wanted: BoolArray,
    snap: float,
    zero_tol: float,
) -> CurveSurfaceIntersections:
    """The intersections of n segments with K surfaces.

    `on_surface` (V, K): vertices that lie on surfaces. `wanted` (n, K): the pairs to intersect. A segment that starts on a
    surface is taken to stay there as long as its distance is below `zero_tol`.
    """
    n, k = len(segments), len(surfaces)
    poles = {int(c): curves[c].poles for c in np.unique(segments.curve)}
    low = np.zeros((len(curves), 3))
    high = np.zeros((len(curves), 3))
    for c, p in poles.items():
        low[c], high[c] = p.min(axis=0), p.max(axis=0)
    middle, radius = (low + high) / 2, np.linalg.norm(high - low, axis=1) / 2
    centre = segments.motion.apply(middle[segments.curve])
    reach = radius[segments.curve]
    distance = surfaces.distances(centre, reach + MARGIN_SNAPS * snap, wanted)
    sign = np.where(distance < 0, -1, 1)
    near = wanted & (np.abs(distance) <= reach[:, None] + snap)
    s, surface = np.nonzero(near)

    framed = surfaces.take(surface).in_frames(segments.motion[s])
    ends_on = np.column_stack([on_surface[segments.start[s], surface], on_surface[segments.end[s], surface]])
    size = max(float(radius.max(initial=0.0)), snap)
    key = np.column_stack([segments.curve[s], segments.span[s], framed.congruence_key(size), ends_on])
    first, label = group_rows(key)

    class_sign, class_deviation, roots, signs = _intersect_classes(
        curves, segments, s[first], framed.take(first), ends_on[first], snap, zero_tol
    )

    sign[s, surface] = class_sign[label]
    deviation = np.zeros(n)
    np.maximum.at(deviation, s, class_deviation[label])
    count = np.array([len(r) for r in roots], np.int64)[label]
    rooted = np.flatnonzero(count)
    pair = np.full((n, k), -1)
    pair[s[rooted], surface[rooted]] = np.arange(len(rooted))
    return CurveSurfaceIntersections(
        initial_sign=sign,
        row_of_pair=pair,
        root_start=np.concatenate([[0], np.cumsum(count[rooted])]),
        root_parameter=np.concatenate([np.zeros(0), *(roots[label[p]] for p in rooted)]),
        root_segment=np.repeat(s[rooted], count[rooted]),
        root_surface=np.repeat(surface[rooted], count[rooted]),
        root_sign=np.concatenate([np.zeros(0, np.int64), *(signs[label[p]] for p in rooted)]),
        coincident_deviation=deviation,
    )


def _intersect_classes(
    curves: Sequence[BSplineCurve],
    segments: CurveSegments,
    segment: IntArray,
    surfaces: QuadricTable,
    ends_on: BoolArray,
    snap: float,
    zero_tol: float,
) -> tuple[IntArray, Array, list[Array], list[IntArray]]:
    """Initial sign, coincident deviation, roots and signs before them of n classes, in batches of one spline space each."""
    n = len(segment)
    sign, deviation, roots = np.zeros(n, np.int64), np.zeros(n), [np.zeros(0)] * n
    before = [np.zeros(0, np.int64)] * n
    spaces: dict[tuple[int, bytes, bool], list[int]] = {}
    for i, (c, is_plane) in enumerate(zip(segments.curve[segment].tolist(), surfaces.is_plane.tolist(), strict=True)):
        spaces.setdefault((curves[c].degree, curves[c].knots.tobytes(), is_plane), []).append(i)
    for members in spaces.values():
        at = np.array(members)
        curve = curves[segments.curve[segment[at[0]]]]
        poles = np.stack([curves[c].poles for c in segments.curve[segment[at]]])
        distance = _DistanceAlongCurves(curve.knots, curve.degree, poles, surfaces.take(at))
        sign[at], deviation[at], roots_of_members, signs_of_members = _analyse_distances(
            distance, segments.span[segment[at]], ends_on[at], snap, zero_tol
        )
        for i, r, signs in zip(members, roots_of_members, signs_of_members, strict=True):
            roots[i], before[i] = r, signs
    return sign, deviation, roots, before


class _DistanceAlongCurves:
    """The distances from m surfaces along m curves (m, N, 3) of one spline space; the surfaces are all planes, or none is."""

    def __init__(self, knots: Array, degree: int, poles: Array, surfaces: QuadricTable) -> None:
        self.knots, self.degree, self.poles, self.surfaces = knots, degree, poles, surfaces
        self.coefficients = None
        if surfaces.is_plane.all():
            self.coefficients = np.einsum("mnk,mk->mn", poles, surfaces.axis) + surfaces.parameter_a[:, None]

    def __call__(self, row: IntArray, t: Array, order: int = 0) -> Array:
        """Values or derivatives of the given order on curve row[i] at t[i]: (r,)."""
        basis = [design_matrix(self.knots, self.degree, t, k) for k in range(order + 1)]
        if self.coefficients is not None:
            return np.einsum("rn,rn->r", basis[order], self.coefficients[row])
        points = [np.einsum("rn,rnk->rk", b, self.poles[row]) for b in basis]
        jet = [j[:, 0] for j in self.surfaces.take(row).jet(points[0][:, None], order)]
        if order == 0:
            return jet[0]
        value = np.einsum("rk,rk->r", jet[1], points[order])
        return value if order == 1 else value + np.einsum("ri,rij,rj->r", points[1], jet[2], points[1])

    def jumps(self, row: IntArray, t: Array, zero_tol: float) -> BoolArray:
        """Changes of sign at which the distance on curve row[i] does not vanish at t[i], or vanishes at a forced foot: (r,)."""
        result = np.zeros(len(row), bool)
        at = np.flatnonzero(self.surfaces.placed_rows[row])
        if len(at):
            basis = design_matrix(self.knots, self.degree, t[at])
            points = np.einsum("rn,rnk->rk", basis, self.poles[row[at]])
            (value,), forced = self.surfaces.take(row[at]).marked_jet(points[:, None], 0)
            result[at] = (np.abs(value) > zero_tol)[:, 0] | forced[:, 0]
        return result


def _analyse_distances(
    f: _DistanceAlongCurves, span: Array, ends_on: BoolArray, snap: float, zero_tol: float
) -> tuple[IntArray, Array, list[Array], list[IntArray]]:
    """Initial sign, coincident deviation, roots and signs before them of m surfaces, each on its own curve."""
    poles = f.poles
    m = len(poles)
    size = np.linalg.norm(np.ptp(poles, axis=1), axis=1)
    ends = np.einsum("men,mnk->mek", design_matrix(f.knots, f.degree, span.ravel(), 1).reshape(m, 2, -1), poles)
    least = MIN_SPEED_FRACTION * (size / (span[:, 1] - span[:, 0]))[:, None]
    speed = np.maximum(np.linalg.norm(ends, axis=2), least)
    step = MIN_EDGE_SNAPS * snap / speed * ends_on  # the part of the span without roots, beside vertices on the surface
    low, high = span[:, 0] + step[:, 0], span[:, 1] - step[:, 1]
    t = low[:, None] + (high - low)[:, None] * np.linspace(0.0, 1.0, SAMPLES_PER_SEGMENT)
    row = np.repeat(np.arange(m), SAMPLES_PER_SEGMENT)
    value, slope = (f(row, t.ravel(), order).reshape(m, SAMPLES_PER_SEGMENT) for order in (0, 1))
    reach = np.abs(value).max(axis=1)
    coincident = (reach < snap) & ends_on.all(axis=1)

    owner, root = _find_roots(f, t, value, slope, TOUCH_FRACTION_OF_SIZE * size)
    keep = ~coincident[owner] & ~f.jumps(owner, root, zero_tol)
    for i in np.flatnonzero(ends_on[owner].any(axis=1) & keep):
        for end, stop in ((0, low[owner[i]]), (1, high[owner[i]])):
            if ends_on[owner[i], end]:
                between = np.linspace(root[i], stop, TANGENCY_SAMPLES)[1:-1]
                keep[i] &= bool((np.abs(f(np.full(len(between), owner[i]), between)) > zero_tol).any())
    owner, root = owner[keep], root[keep]
    roots = np.split(root, np.searchsorted(owner, np.arange(1, m)))
    first = high.copy()  # the initial sign is the sign half way to the first root
    first[owner[::-1]] = root[::-1]
    sign = np.sign(f(np.arange(m), 0.5 * (low + first)))
    rootless = np.array([len(r) == 0 for r in roots])
    strongest = value[np.arange(m), np.abs(value).argmax(axis=1)]
    sign = np.where(np.where(rootless, strongest, sign) > 0, 1, -1)
    sign[coincident] = 0
    return sign, np.where(coincident, reach, 0.0), roots, _signs_before_roots(f, sign, roots)


def _signs_before_roots(f: _DistanceAlongCurves, sign: IntArray, roots: list[Array]) -> list[IntArray]:
    """The signs before the roots of m distances: they alternate, but for a free-form surface the slope tells them."""
    result = [s * (1 - 2 * (np.arange(len(own)) % 2)) for s, own in zip(sign.tolist(), roots, strict=True)]
    for i in np.flatnonzero(f.surfaces.is_free_form).tolist():
        if len(roots[i]):
            result[i] = np.where(f(np.full(len(roots[i]), i), roots[i], 1) > 0, -1, 1)
    return result


def _find_roots(f: Callable[..., Array], t: Array, value: Array, slope: Array, noise: Array) -> tuple[IntArray, Array]:
    """Row and parameter of the simple roots, in order, of n functions sampled at t (n, SAMPLES_PER_SEGMENT)."""
    a, b = value[:, :-1], value[:, 1:]
    step = np.diff(t, axis=1)
    turning = (a * b > 0) & (a * slope[:, :-1] < 0) & (b * slope[:, 1:] > 0)
    turning &= np.minimum(np.abs(a), np.abs(b)) < np.abs(np.diff(slope, axis=1)) * step  # else too far to reach zero
    row, i = np.nonzero(turning)
    low, high = t[row, i], t[row, i + 1]
    top = bracketed_newton(lambda x: f(row, x, 1), lambda x: f(row, x, 2), low, high)
    at_top = f(row, top)
    crosses = (at_top * value[row, i] < 0) & (np.abs(at_top) > noise[row])
    change, j = np.nonzero((a < 0) != (b < 0))
    owner = np.concatenate([change, row[crosses], row[crosses]])
    low = np.concatenate([t[change, j], low[crosses], top[crosses]])
    high = np.concatenate([t[change, j + 1], top[crosses], high[crosses]])
    root = bracketed_newton(lambda x: f(owner, x), lambda x: f(owner, x, 1), low, high)
    order = np.lexsort((root, owner))
    return owner[order], root[order]


def bracketed_newton(f: Callable[[Array], Array], slope: Callable[[Array], Array], low: Array, high: Array) -> Array:
    """The roots of f in n brackets with one change of sign each, by Newton's method safeguarded by bisection."""
    if len(low) == 0:
        return np.zeros(0)
    rising = f(low) < 0
    t = 0.5 * (low + high)
    for count in range(MAX_ROOT_STEPS):
        g, d = f(t), slope(t)
        below = (g < 0) == rising
        low, high = np.where(below, t, low), np.where(below, high, t)
        with np.errstate(divide="ignore", invalid="ignore"):
            step = t - g / d
        good = (step > low) & (step < high) & (count < MAX_NEWTON_STEPS)
        new = np.where(good, step, 0.5 * (low + high))
        new = np.where(g == 0, t, new)
        if (np.abs(new - t) <= ROOT_RTOL * np.maximum(1.0, np.abs(t))).all():
            return new
        t = new
    raise TrimmingError(f"a root between {low[0]} and {high[0]} did not converge in {MAX_ROOT_STEPS} Newton steps")


def _assign_root_vertices(
    curves: Sequence[BSplineCurve],
    segments: CurveSegments,
    roots: CurveSurfaceIntersections,
    first_vertex: int,
    snap: float,
) -> tuple[IntArray, Array]:
    """A vertex for every root (R,), and the new vertices' points; roots of one segment within `snap` share a vertex."""
    order = np.lexsort((roots.root_parameter, roots.root_segment))
    points = evaluate_segments(curves, segments, roots.root_segment, roots.root_parameter)[order]
    segment = roots.root_segment[order]
    fresh = np.ones(len(order), bool)
    fresh[1:] = (segment[1:] != segment[:-1]) | (np.linalg.norm(np.diff(points, axis=0), axis=1) > snap)
    vertex = np.empty(len(order), np.int64)
    vertex[order] = first_vertex + np.cumsum(fresh) - 1
    return vertex, points[fresh]


def split_segments(segments: CurveSegments, segment: IntArray, t: Array, vertex: IntArray) -> SubSegments:
    """The sub-segments between the vertices (R,) at parameters t of the segments named; repeated vertices are merged."""
    n = len(segments)
    order = np.lexsort((t, segment))
    segment, t, v = segment[order], t[order], vertex[order]
    fresh = np.ones(len(order), bool)
    fresh[1:] = (segment[1:] != segment[:-1]) | (v[1:] != v[:-1])
    segment, t, v = segment[fresh], t[fresh], v[fresh]
    cuts = np.bincount(segment, minlength=n)
    first = np.concatenate([[0], np.cumsum(cuts + 1)])
    owner = np.repeat(np.arange(n), cuts + 1)
    m = len(owner)

    # Vertex c of all is followed by sub-segment c + 1 + (number of segments before its own).
    after = np.arange(len(segment)) + 1 + segment
    span = np.empty((m, 2))
    start, end = np.empty(m, np.int64), np.empty(m, np.int64)
    span[first[:-1], 0], span[first[1:] - 1, 1] = segments.span.T
    start[first[:-1]], end[first[1:] - 1] = segments.start, segments.end
    span[after, 0], span[after - 1, 1] = t, t
    start[after], end[after - 1] = v, v
    return SubSegments(owner, span, start, end, first)
