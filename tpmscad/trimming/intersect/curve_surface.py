"""Where placed curves cross the planes of a tool, found once for each class of curves that see a plane from the same place.

A strand is an edge's piece of a curve: a side of a patch, or the curve cut on one by a plane. A vertex nearer than `snap` to a
plane counts as *on* it. Symbolically such a vertex is outside; strands that end there have no root within a few `snap` of it,
so that no edge is shorter than that. A strand that lies in a plane altogether has no sign there at all.

Strands split at vertices along them, and the vertices for roots.

Sides of patches that a face of the body touches, without crossing them there.

The topology is as if they kept apart. But the cut beside the side comes within the kernel's tolerance of it, and kernels take
that for a loop that crosses itself: the walls of holes that touch mirror planes of the lattice do it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.brep.carriers import EdgeCurve
from tpmscad.errors import TrimmingError
from tpmscad.rigid_motion import Motion
from tpmscad.splines.basis import design_matrix
from tpmscad.splines.bspline import BSplineCurve
from tpmscad.trimming.operands.face_regions import FaceRegion
from tpmscad.trimming.operands.implicit_surfaces import ImplicitSurfaces
from tpmscad.trimming.operands.trimming_body import TrimmingBody

SAMPLES_PER_SEGMENT = 34
"""Samples along a strand: between them the distance from a plane is taken to have at most one extremum."""

MIN_EDGE_SNAPS = 3.0
"""Roots nearer than this many `snap` to a vertex on the plane are that vertex."""

ZERO_FRACTION_OF_TOL = 0.05
"""Saddles, and strands that leave a vertex on the plane tangentially, lie in the plane within this part of the tolerance."""

TOUCH_FRACTION_OF_SIZE = 1e-13
"""An extremum nearer to a plane than this part of the strand's size touches it: round-off is a hundred times smaller."""


@dataclass(frozen=True, slots=True, eq=False)
class CurveSegments:
    """n curve pieces: curve index, motion, parameter span (n, 2), start and end vertex."""

    curve: IntArray
    motion: Motion
    span: Array
    start: IntArray
    end: IntArray

    def __len__(self) -> int:
        return len(self.curve)


@dataclass(frozen=True, slots=True, eq=False)
class CurveSurfaceIntersections:
    """What n strands and K planes have in common.

    `sign` (n, K): -1 or +1 at the strand's beginning, 0 where the strand lies in the plane. `pair` (n, K): -1 without roots,
    else p with the parameters root[root_start[p]:root_start[p + 1]], rising. `root_strand`, `root_surface`: of each root.
    `off`: how far strands in a plane are from it at most, (n,). `touch`, `touch_strand`, `touch_surface`: where strands come
    within `snap` of a surface and turn back.
    """

    sign: IntArray
    row_of_pair: IntArray
    root_start: IntArray
    root: Array
    root_segment: IntArray
    root_surface: IntArray
    off: Array
    touch: Array
    touch_segment: IntArray
    touch_surface: IntArray
    n_classes: int

    def of(self, strand: int, plane: int) -> Array:
        """The roots of one strand on one plane, rising."""
        p = self.row_of_pair[strand, plane]
        return self.root[self.root_start[p] : self.root_start[p + 1]] if p >= 0 else np.zeros(0)


def evaluate_segments(curves: Sequence[EdgeCurve], strands: CurveSegments, index: IntArray, t: Array) -> Array:
    """Points at parameters t (m,) of the strands `index` (m,): (m, 3)."""
    local = np.empty((len(t), 3))
    owner = strands.curve[index]
    order = np.argsort(owner, kind="stable")
    cuts = np.flatnonzero(np.diff(owner[order])) + 1
    for at in np.split(order, cuts):
        if len(at):
            local[at] = curves[owner[at[0]]](t[at])
    return strands.motion[index].apply(local)


def intersect_segments(
    curves: Sequence[BSplineCurve],
    strands: CurveSegments,
    levels: ImplicitSurfaces,
    on: BoolArray,
    wanted: BoolArray,
    snap: float,
    flat: float,
) -> CurveSurfaceIntersections:
    """All roots of strands on surfaces. `on` (V, K): vertices on surfaces; `wanted` (n, K): the pairs to look at.

    Nearer than `snap` a vertex is on a surface; the strand is taken to stay there as long as it is nearer than `flat`.
    """
    n, k = len(strands), len(levels)
    poles = {int(c): curves[c].poles for c in np.unique(strands.curve)}
    low = np.zeros((len(curves), 3))
    high = np.zeros((len(curves), 3))
    for c, p in poles.items():
        low[c], high[c] = p.min(axis=0), p.max(axis=0)
    middle, radius = (low + high) / 2, np.linalg.norm(high - low, axis=1) / 2
    centre = strands.motion.apply(middle[strands.curve])
    distance = levels.distances(centre)
    sign = np.where(distance < 0, -1, 1)
    near = wanted & (np.abs(distance) <= radius[strands.curve][:, None] + snap)
    s, surface = np.nonzero(near)

    seen = levels.of(surface).in_frames(strands.motion[s])
    ends_on = np.column_stack([on[strands.start[s], surface], on[strands.end[s], surface]])
    size = max(float(radius.max(initial=0.0)), snap)
    key = np.column_stack([strands.curve[s], strands.span[s], seen.key(size), ends_on])
    _, first, label = np.unique(key, axis=0, return_index=True, return_inverse=True)
    label = label.ravel()

    class_sign, class_off, roots, touches = _intersect_classes(
        curves, strands, s[first], seen.of(first), ends_on[first], snap, flat
    )

    sign[s, surface] = class_sign[label]
    off = np.zeros(n)
    np.maximum.at(off, s, class_off[label])
    count, touched = (np.array([len(r) for r in found], np.int64)[label] for found in (roots, touches))
    rooted = np.flatnonzero(count)
    pair = np.full((n, k), -1)
    pair[s[rooted], surface[rooted]] = np.arange(len(rooted))
    return CurveSurfaceIntersections(
        sign=sign,
        row_of_pair=pair,
        root_start=np.concatenate([[0], np.cumsum(count[rooted])]),
        root=np.concatenate([np.zeros(0), *(roots[label[p]] for p in rooted)]),
        root_segment=np.repeat(s[rooted], count[rooted]),
        root_surface=np.repeat(surface[rooted], count[rooted]),
        off=off,
        touch=np.concatenate([np.zeros(0), *(touches[label[p]] for p in np.flatnonzero(touched))]),
        touch_segment=np.repeat(s, touched),
        touch_surface=np.repeat(surface, touched),
        n_classes=len(first),
    )


def _intersect_classes(
    curves: Sequence[BSplineCurve],
    strands: CurveSegments,
    strand: IntArray,
    levels: ImplicitSurfaces,
    ends_on: BoolArray,
    snap: float,
    flat: float,
) -> tuple[IntArray, Array, list[Array], list[Array]]:
    """First sign, distance where it lies in the surface, roots and touches of n classes, by one of each; batched by spline
    space."""
    n = len(strand)
    sign, off, roots, touches = np.zeros(n, np.int64), np.zeros(n), [np.zeros(0)] * n, [np.zeros(0)] * n
    spaces: dict[tuple[int, bytes, bool], list[int]] = {}
    for i, (c, is_plane) in enumerate(zip(strands.curve[strand].tolist(), levels.flat.tolist(), strict=True)):
        spaces.setdefault((curves[c].degree, curves[c].knots.tobytes(), is_plane), []).append(i)
    for members in spaces.values():
        at = np.array(members)
        curve = curves[strands.curve[strand[at[0]]]]
        poles = np.stack([curves[c].poles for c in strands.curve[strand[at]]])
        along = _DistanceAlongCurves(curve.knots, curve.degree, poles, levels.of(at))
        found = _analyse_distances(along, strands.span[strand[at]], ends_on[at], snap, flat)
        sign[at], off[at] = found[:2]
        for i, r, t in zip(members, *found[2:], strict=True):
            roots[i], touches[i] = r, t
    return sign, off, roots, touches


class _DistanceAlongCurves:
    """The distances from m surfaces along m curves (m, N, 3) of one spline space: all planes, or none of them."""

    def __init__(self, knots: Array, degree: int, poles: Array, levels: ImplicitSurfaces) -> None:
        self.knots, self.degree, self.poles, self.levels = knots, degree, poles, levels
        self.coefficients = None
        if levels.flat.all():
            self.coefficients = np.einsum("mnk,mk->mn", poles, levels.axis) + levels.a[:, None]

    def __call__(self, row: IntArray, t: Array, order: int = 0) -> Array:
        """Values or derivatives on curve row[i] at t[i]: (r,)."""
        basis = [design_matrix(self.knots, self.degree, t, k) for k in range(order + 1)]
        if self.coefficients is not None:
            return np.einsum("rn,rn->r", basis[order], self.coefficients[row])
        points = [np.einsum("rn,rnk->rk", b, self.poles[row]) for b in basis]
        jet = [j[:, 0] for j in self.levels.of(row).jet(points[0][:, None], order)]
        if order == 0:
            return jet[0]
        value = np.einsum("rk,rk->r", jet[1], points[order])
        return value if order == 1 else value + np.einsum("ri,rij,rj->r", points[1], jet[2], points[1])


def _analyse_distances(
    along: _DistanceAlongCurves, span: Array, ends_on: BoolArray, snap: float, flat: float
) -> tuple[IntArray, Array, list[Array], list[Array]]:
    """First sign, distance where it lies in the surface, roots and touches of m surfaces, each on its own curve."""
    f, poles = along, along.poles
    m = len(poles)
    size = np.linalg.norm(np.ptp(poles, axis=1), axis=1)
    ends = np.einsum("men,mnk->mek", design_matrix(f.knots, f.degree, span.ravel(), 1).reshape(m, 2, -1), poles)
    speed = np.maximum(np.linalg.norm(ends, axis=2), 1e-3 * (size / (span[:, 1] - span[:, 0]))[:, None])
    step = MIN_EDGE_SNAPS * snap / speed * ends_on  # no root is looked for there: no edge comes out shorter
    low, high = span[:, 0] + step[:, 0], span[:, 1] - step[:, 1]
    t = low[:, None] + (high - low)[:, None] * np.linspace(0.0, 1.0, SAMPLES_PER_SEGMENT)
    row = np.repeat(np.arange(m), SAMPLES_PER_SEGMENT)
    value, slope = (f(row, t.ravel(), order).reshape(m, SAMPLES_PER_SEGMENT) for order in (0, 1))
    reach = np.abs(value).max(axis=1)
    within = (reach < snap) & ends_on.all(axis=1)

    owner, root, touching, touch = _find_roots(f, t, value, slope, TOUCH_FRACTION_OF_SIZE * size, snap)
    keep = ~within[owner]
    for i in np.flatnonzero(ends_on[owner].any(axis=1) & keep):
        for end, stop in ((0, low[owner[i]]), (1, high[owner[i]])):
            if ends_on[owner[i], end]:
                between = np.linspace(root[i], stop, 9)[1:-1]
                keep[i] &= bool((np.abs(f(np.full(7, owner[i]), between)) > flat).any())
    owner, root = owner[keep], root[keep]
    roots = np.split(root, np.searchsorted(owner, np.arange(1, m)))
    first = high.copy()  # the sign before the first root is the sign half way to it
    first[owner[::-1]] = root[::-1]
    sign = np.sign(f(np.arange(m), 0.5 * (low + first)))
    rootless = np.array([len(r) == 0 for r in roots])
    strongest = value[np.arange(m), np.abs(value).argmax(axis=1)]
    sign = np.where(np.where(rootless, strongest, sign) > 0, 1, -1)
    sign[within] = 0
    away = ~within[touching]
    touches = np.split(touch[away], np.searchsorted(touching[away], np.arange(1, m)))
    return sign, np.where(within, reach, 0.0), roots, touches


def _find_roots(
    f: Callable[..., Array], t: Array, value: Array, slope: Array, noise: Array, snap: float
) -> tuple[IntArray, Array, IntArray, Array]:
    """Simple roots of n functions sampled at t (n, SAMPLES), as (row, parameter) in order, pairs between samples included; and
    the extrema between samples that are nearer to zero than `snap`, alike."""
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
    touches = np.abs(at_top) < snap
    return owner[order], root[order], row[touches], top[touches]


def bracketed_newton(
    f: Callable[[Array], Array], slope: Callable[[Array], Array], low: Array, high: Array, iterations: int = 100
) -> Array:
    """The roots of f in n brackets with a change of sign each, by Newton steps that fall back on bisection."""
    if len(low) == 0:
        return np.zeros(0)
    rising = f(low) < 0
    t = 0.5 * (low + high)
    for _ in range(iterations):
        g, d = f(t), slope(t)
        below = (g < 0) == rising
        low, high = np.where(below, t, low), np.where(below, high, t)
        with np.errstate(divide="ignore", invalid="ignore"):
            step = t - g / d
        good = (step > low) & (step < high)
        new = np.where(good, step, 0.5 * (low + high))
        new = np.where(g == 0, t, new)
        if (np.abs(new - t) <= 4e-16 * np.maximum(1.0, np.abs(t))).all():
            return new
        t = new
    raise TrimmingError(f"a root between {low[0]} and {high[0]} did not converge in {iterations} steps")


@dataclass(frozen=True, slots=True, eq=False)
class SubSegments:
    """M pieces in the order of strands and parameters: those of strand i are first[i] .. first[i + 1] - 1."""

    segment: IntArray
    span: Array
    start: IntArray
    end: IntArray
    first: IntArray


def assign_root_vertices(
    curves: Sequence[BSplineCurve],
    strands: CurveSegments,
    crossings: CurveSurfaceIntersections,
    first_vertex: int,
    snap: float,
) -> tuple[IntArray, Array]:
    """A vertex for every root (R,), and the new vertices' points: roots of one strand within `snap` are one vertex."""
    order = np.lexsort((crossings.root, crossings.root_segment))
    points = evaluate_segments(curves, strands, crossings.root_segment, crossings.root)[order]
    strand = crossings.root_segment[order]
    fresh = np.ones(len(order), bool)
    fresh[1:] = (strand[1:] != strand[:-1]) | (np.linalg.norm(np.diff(points, axis=0), axis=1) > snap)
    vertex = np.empty(len(order), np.int64)
    vertex[order] = first_vertex + np.cumsum(fresh) - 1
    return vertex, points[fresh]


def split_segments(strands: CurveSegments, strand: IntArray, t: Array, vertex: IntArray) -> SubSegments:
    """The pieces of every strand between the vertices (R,) at parameters t of the strands named; one may be named twice."""
    n = len(strands)
    order = np.lexsort((t, strand))
    strand, t, v = strand[order], t[order], vertex[order]
    fresh = np.ones(len(order), bool)
    fresh[1:] = (strand[1:] != strand[:-1]) | (v[1:] != v[:-1])
    strand, t, v = strand[fresh], t[fresh], v[fresh]
    cuts = np.bincount(strand, minlength=n)
    first = np.concatenate([[0], np.cumsum(cuts + 1)])
    owner = np.repeat(np.arange(n), cuts + 1)
    m = len(owner)

    # Cut c of all is followed by piece c + 1 + (number of strands before its own).
    after = np.arange(len(strand)) + 1 + strand
    span = np.empty((m, 2))
    start, end = np.empty(m, np.int64), np.empty(m, np.int64)
    span[first[:-1], 0], span[first[1:] - 1, 1] = strands.span.T
    start[first[:-1]], end[first[1:] - 1] = strands.start, strands.end
    span[after, 0], span[after - 1, 1] = t, t
    start[after], end[after - 1] = v, v
    return SubSegments(owner, span, start, end, first)


def check_tangencies(
    curves: Sequence[BSplineCurve],
    strands: CurveSegments,
    crossings: CurveSurfaceIntersections,
    body: TrimmingBody,
    faces: Sequence[FaceRegion],
) -> None:
    """TrimmingError where an edge of the lattice touches a face of the body."""
    points = evaluate_segments(curves, strands, crossings.touch_segment, crossings.touch)
    for f, region in enumerate(faces):
        at = points[crossings.touch_surface == body.surface[f]]
        at = at[region.contains(at)] if len(at) else at
        if len(at):
            raise TrimmingError(f"a face of the body touches a patch's side at {at[0].round(6)}")
