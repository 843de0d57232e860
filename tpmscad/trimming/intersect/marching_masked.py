"""Marching the zero set of the distance from a free-form surface, which jumps where two feet are equally near.

It differs from `marching` in what a jump asks for.

- A grid edge changes sign only if |d1| + |d2| is at most a little more than its length, since a distance is Lipschitz. A cell
  with another change of sign, or with a foot forced to the border of the surface at a corner, is *masked*: no branch passes it.
- A branch may end at a masked cell; its end is an inner point.
- The signs on the patch's border are those of the distance, for parity says nothing after a jump.
- What lies away from the faces on the surface is left out before anything is fitted.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.brep.free_form_surface import FreeFormSurface
from tpmscad.brep.orthogonal_projection import project_to_patch
from tpmscad.errors import TrimmingError
from tpmscad.rigid_motion import Motion
from tpmscad.splines.bspline import BSplineSurface
from tpmscad.trimming.intersect.critical_points import (
    PatchCriticalPoint,
    collect_critical_points,
    place_newton_starts,
    refine_grid_lines,
)
from tpmscad.trimming.intersect.marching import (
    EMPTY_TRACE,
    MAX_REFINEMENTS,
    Arc,
    ArcEnd,
    Trace,
    interpolate_crossings,
    link_crossings,
    locate_border_end,
    project_to_zero,
)
from tpmscad.trimming.intersect.patch_borders import BorderSide, place_grid_lines, side_fractions, view_side_nodes
from tpmscad.trimming.operands.edge_normals import EdgeNormals
from tpmscad.trimming.operands.quadric_table import ComposedDistance, QuadricTable

LIPSCHITZ_FACTOR = 1.2
"""Largest ratio of |d1| + |d2| to the length of a grid edge at whose ends a distance has two signs: 1, and some for chords."""

BLOCK_NODES = 6
"""Nodes along u and v of a block that is tested as a whole."""

FAR_RADII = 2.0
"""Distance of a block's middle, in radii of the block, beyond which no zero is within several steps of its nodes."""

BorderDistance = Callable[[Array], Array]
"""Distances (n,) of points (n, 3) in the patch's frame from the nearest border of a face on the surface, negative in a face."""

MAX_KINK_CONTINUITY = 2
"""Continuity of a surface across a knot line up to which intersection curves are divided there."""

KINK_CLEARANCE_STEPS = 0.2
"""Grid steps from the border of a face within which they are not: an edge of the body is there, and short edges would result."""

KINK_STEPS = 12
"""Most steps of false position to such a line."""

KINK_RTOL = 1e-11
"""Distance from the line, in steps of the path, at which the iteration ends."""

MARGIN_STEPS = 3.0
"""Grid steps beyond the border of a face to which a branch is followed, so that it crosses the edge for certain."""


@dataclass(frozen=True, slots=True, eq=False)
class _Samples:
    """The distance on grid lines us and vs: values (nu, nv), points and gradients in space (nu, nv, 3), masked cells.

    `is_far` (nu, nv): nodes without a zero in several steps about them, where the values are those of nodes nearby.
    """

    us: Array
    vs: Array
    values: Array
    points: Array
    gradients: Array
    masked: BoolArray
    is_far: BoolArray


def march_masked_patch(
    surface: BSplineSurface,
    implicit: QuadricTable,
    borders: tuple[BorderSide, ...],
    on_corner: BoolArray,
    zero_tol: float,
    border_distance: BorderDistance,
) -> Trace:
    """The arcs of one free-form surface (a table of one row) on a patch, as by `march_patch`, next to the surface's faces.

    TrimmingError if a corner or a side of the patch lies in the surface.
    """
    if on_corner.any() or any(border.sign == 0 for border in borders):
        raise TrimmingError("a corner of a patch lies in a free-form face of the body")
    distance = ComposedDistance(surface, implicit)
    samples = _sample(distance, *place_grid_lines(surface, borders, on_corner))
    critical = _find_critical_points(distance, samples)
    us, vs, saddles = refine_grid_lines(samples.us, samples.vs, critical, on_corner, zero_tol)
    if len(us) > len(samples.us) or len(vs) > len(samples.vs) or len(saddles):
        samples = _sample(distance, us, vs)
    for _ in range(MAX_REFINEMENTS):
        negative = samples.values < 0
        masked = _mask_borders(samples, negative, borders)
        follow, ambiguous = link_crossings(negative, samples.us, samples.vs, saddles, masked)
        if len(ambiguous) == 0:
            break
        us, vs = samples.us, samples.vs
        i, j = ambiguous.T
        samples = _sample(
            distance,
            np.union1d(us, 0.5 * (us[i] + us[i + 1])),
            np.union1d(vs, 0.5 * (vs[j] + vs[j + 1])),
        )
    else:
        raise TrimmingError(
            f"branches of an intersection curve stay unresolved near (u, v) = ({us[i[0]]:.6f}, {vs[j[0]]:.6f})"
        )
    arcs, points = _chain_near_arcs(distance, follow, samples, borders, saddles, border_distance)
    if not arcs:
        return replace(EMPTY_TRACE, sign=1)  # the sign is asked for next to coincident sides only, which are refused
    foci = np.array([[*c.parameters, c.radius] for c in critical if abs(c.value) > zero_tol]).reshape(-1, 3)
    return Trace(arcs, 0, points, np.zeros(4, np.int64), np.vstack([foci, _find_pole_foci(distance, samples)]))


def _sample(distance: ComposedDistance, us: Array, vs: Array) -> _Samples:
    """The distance on a grid, with the cells that no branch passes; most nodes far from the surface are not evaluated."""
    points = distance.surface.grid(us, vs)
    d, gradients, forced, is_far = _evaluate_near_nodes(distance.implicit, points)
    jumps = []
    for axis in (0, 1):
        a, b = (d[:-1], d[1:]) if axis == 0 else (d[:, :-1], d[:, 1:])
        length = np.linalg.norm(np.diff(points, axis=axis), axis=2)
        jumps.append(((a < 0) != (b < 0)) & (np.abs(a) + np.abs(b) > LIPSCHITZ_FACTOR * length))
    masked = forced[:-1, :-1] | forced[1:, :-1] | forced[:-1, 1:] | forced[1:, 1:]
    masked |= jumps[0][:, :-1] | jumps[0][:, 1:] | jumps[1][:-1] | jumps[1][1:]
    return _Samples(us, vs, d, points, gradients, masked, is_far)


def _evaluate_near_nodes(implicit: QuadricTable, points: Array) -> tuple[Array, Array, BoolArray, BoolArray]:
    """Values, gradients, marks of forced feet, and marks of nodes that are far away, on a grid of points (nu, nv, 3).

    A distance is Lipschitz: there is no zero in a block of nodes whose middle is farther away than they are from the middle.
    """
    shape = points.shape[:2]
    rows, columns = (np.arange(n) // BLOCK_NODES for n in shape)
    block = rows[:, None] * (columns[-1] + 1) + columns
    middle = [
        np.minimum(np.arange(own[-1] + 1) * BLOCK_NODES + BLOCK_NODES // 2, len(own) - 1) for own in (rows, columns)
    ]
    middles = points[np.ix_(*middle)].reshape(-1, 3)
    radius = np.zeros(len(middles))
    np.maximum.at(radius, block.ravel(), np.linalg.norm(points - middles[block], axis=2).ravel())
    at_middle, slope = (j[0] for j in implicit.jet(middles[None], 1))
    is_far = (np.abs(at_middle) > FAR_RADII * radius)[block]
    values = at_middle[block]
    gradients, forced = slope[block], np.zeros(shape, bool)
    near = ~is_far
    if near.any():
        (d, g), marks = implicit.marked_jet(points[near][None], 1)
        values[near], gradients[near], forced[near] = d[0], g[0], marks[0]
    return values, gradients, forced, is_far


def _find_critical_points(distance: ComposedDistance, samples: _Samples) -> list[PatchCriticalPoint]:
    """The critical points in cells without a mask at which the grid may miss a branch, as by `find_critical_points`."""
    us, vs = samples.us, samples.vs
    bad = samples.is_far.copy()
    for i, j in ((0, 0), (1, 0), (0, 1), (1, 1)):
        bad[i : i + len(us) - 1, j : j + len(vs) - 1] |= samples.masked
    reach = float(np.linalg.norm(np.diff(samples.points, axis=0), axis=2).max())
    bad |= np.abs(samples.values) > MARGIN_STEPS * reach  # a jump of the value there is none of the sign
    slopes = []
    for order in ((1, 0), (0, 1)):
        slope = np.einsum("uvk,uvk->uv", samples.gradients, distance.surface.grid(us, vs, *order))
        slopes.append(np.where(bad, np.inf, slope)[None])  # the flattest node is sought among the others
    small, _, starts = place_newton_starts(samples.values[None], slopes[0], slopes[1], us, vs, bad[None])
    h = np.array([np.diff(us).max(), np.diff(vs).max()])
    return collect_critical_points(distance, starts, h, float(small[0]))


def _find_pole_foci(distance: ComposedDistance, samples: _Samples) -> Array:
    """Where the patch comes near poles of the surface: (u, v) and the distance in (u, v), (k, 3). Arcs turn sharply there."""
    form, place = _single_form(distance)
    poles = form.poles_across_v() if isinstance(form, FreeFormSurface) else ()
    if not poles:
        return np.zeros((0, 3))
    points = place.apply_inverse(np.array([pole for _, pole in poles]))
    apart = np.linalg.norm(samples.points[:, :, None] - points, axis=3).reshape(-1, len(points))
    i, j = np.unravel_index(apart.argmin(axis=0), samples.points.shape[:2])
    radius, u, v = project_to_patch(distance.surface, points, samples.us[i], samples.vs[j])
    return np.column_stack([u, v, radius / np.sqrt(np.linalg.norm(distance.surface.normal(u, v), axis=1))])


def _single_form(distance: ComposedDistance) -> tuple[FreeFormSurface | EdgeNormals, Motion]:
    """The surface of a table of one row, and its place in the frame of the patch."""
    placed = distance.implicit.placed
    assert placed is not None
    return placed.forms[int(placed.number[0])], placed.place[0]


def _mask_borders(samples: _Samples, negative: BoolArray, borders: tuple[BorderSide, ...]) -> BoolArray:
    """The masked cells, with those whose border edge changes sign without an odd number of roots, or the other way round.

    This is so next to a jump, where the edge's own samples lie on its other side.
    """
    masked = samples.masked.copy()
    cells = masked[:, 0], masked[-1], masked[::-1, -1], masked[0, ::-1]
    for side, border in enumerate(borders):
        signs = view_side_nodes(negative, side)
        inside = np.diff(np.searchsorted(border.roots, side_fractions(samples.us, samples.vs, side)))
        cells[side][(signs[1:] != signs[:-1]) != (inside % 2 == 1)] = True
    return masked


def _chain_near_arcs(
    distance: ComposedDistance,
    follow: dict[int, int],
    samples: _Samples,
    borders: tuple[BorderSide, ...],
    saddles: Array,
    border_distance: BorderDistance,
) -> tuple[tuple[Arc, ...], Array]:
    """The parts of the branches that are near faces, and the inner points (n, 2) at which they end."""
    us, vs = samples.us, samples.vs
    steps = [np.linalg.norm(np.diff(samples.points, axis=axis), axis=2).max() for axis in (0, 1)]
    step = float(max(steps))
    margin = MARGIN_STEPS * step
    points = list(saddles)
    arcs: list[Arc] = []
    for chain, is_closed in _collect_chains(follow):
        inner = np.array([c for c in chain if c >= 0], np.int64)
        path = interpolate_crossings(inner, samples.values[None], us, vs)
        ends: list[ArcEnd | None] = [None, None]
        for k, at in ((0, 0), (1, -1)):
            crossing = chain[at]
            if crossing < 0:
                saddle = (-crossing - 1) // 4
                ends[k] = ("point", saddle, 0)
                path = np.insert(path, 0 if k == 0 else len(path), saddles[saddle], axis=0)
            elif not is_closed and _is_on_border(crossing, len(us), len(vs)):
                ends[k], path[at] = locate_border_end(crossing, us, vs, borders)
        depth = border_distance(distance.surface(*path.T))
        near = depth <= margin
        if is_closed:
            path, near, depth = path[:-1], near[:-1], depth[:-1]
            if near.all():
                half = len(path) // 2
                path, near, depth = (
                    np.vstack([path, path[:1]]),
                    np.ones(len(path) + 1, bool),
                    np.append(depth, depth[0]),
                )
                pieces = [(0, half), (half, len(path) - 1)]
            else:
                turn = int(np.argmin(near))
                path, near, depth = np.roll(path, -turn, axis=0), np.roll(near, -turn), np.roll(depth, -turn)
                pieces = _runs(near)
        else:
            pieces = _runs(near)
        made: dict[int, ArcEnd] = {}
        clear = np.abs(depth) > KINK_CLEARANCE_STEPS * step
        path, kinks = _insert_kinks(distance, path, clear, KINK_CLEARANCE_STEPS * step)
        shifts = np.searchsorted(kinks - np.arange(len(kinks)), np.arange(len(path)), side="right")
        ranges = [(int(i + shifts[i]), int(j + shifts[j])) for i, j in pieces]
        if not (is_closed and near.all()):
            reach = np.array([np.diff(us).max(), np.diff(vs).max()])
            is_end = (ends[0] is not None, ends[1] is not None)
            ranges = [r for r in (_shorten_range(distance, path, *r, is_end, reach) for r in ranges) if r[0] < r[1]]
        for first, last in [part for piece in ranges for part in _split_range(*piece, kinks.tolist())]:
            own: list[ArcEnd] = []
            tips = path[[first, last]]
            for k, at in ((0, first), (1, last)):
                known = ends[k] if not is_closed and at == (0, len(path) - 1)[k] else None
                key = at % (len(path) - 1) if is_closed and near.all() else at
                if known is None and key not in made:
                    made[key] = ("point", len(points), 0)
                    points.append(project_to_zero(distance, path[at]))
                end = known or made[key]
                if end[0] == "point":
                    tips[k] = points[end[1]]
                own.append(end)
            arcs.append(Arc(np.vstack([tips[:1], path[first + 1 : last], tips[1:]]), own[0], own[1]))
    return tuple(arcs), np.array(points).reshape(-1, 2)


def _insert_kinks(
    distance: ComposedDistance, path: Array, clear: BoolArray, clearance: float
) -> tuple[Array, IntArray]:
    """The path (n, 2) with points inserted where it crosses lines of the surface at which curves bend, and their numbers (k,).

    Across a knot line or a seam at which the surface is no smoother than C2, the third derivative of an intersection curve jumps,
    or the second. The curve is divided there, since no fit across comes near the tolerance. A seam is an edge of the body, so
    that the point lies on it to round-off; other lines are skipped where points are not `clear` (n,) of the borders of faces, and
    within `clearance` of the ends of the path, lest short edges result.
    """
    form, place = _single_form(distance)
    none = path, np.zeros(0, np.int64)
    if not isinstance(form, FreeFormSurface):
        return none
    lines = [
        (axis, x, False) for axis, values in enumerate(form.knot_lines(MAX_KINK_CONTINUITY)) for x in values.tolist()
    ]
    lines += [
        (axis, form.domain[axis][0], True) for axis in (0, 1) if form.bends_at_seam(axis, MAX_KINK_CONTINUITY + 1)
    ]
    if not lines:
        return none

    def offsets(at: Array, axis: int, line: float) -> Array:
        """Parameter of the feet less that of the line, to within half a period."""
        off = form.parameters(place.apply(distance.surface(*at.T)))[:, axis] - line
        period = form.period[axis]
        return np.asarray(off - period * np.round(off / period) if period else off)

    feet = form.parameters(place.apply(distance.surface(*path.T)))
    ends = distance.surface(*path[[0, -1]].T)
    found: list[tuple[int, Array]] = []
    for axis, line, is_seam in lines:
        period = form.period[axis]
        off = feet[:, axis] - line
        off = off - period * np.round(off / period) if period else off
        near = np.abs(off) < 0.25 * period if period else np.ones(len(off), bool)
        crossed = ((off[1:] < 0) != (off[:-1] < 0)) & near[1:] & near[:-1]
        for i in np.flatnonzero(crossed).tolist():
            if not (is_seam or (clear[i] and clear[i + 1])):
                continue
            a, b, f, g = path[i], path[i + 1], float(off[i]), float(off[i + 1])
            scale = abs(f - g)
            for _ in range(KINK_STEPS):
                middle = project_to_zero(distance, a + (b - a) * f / (f - g))
                h = float(offsets(middle[None], axis, line)[0])
                if abs(h) <= KINK_RTOL * scale:
                    break
                a, b, f, g = (middle, b, h, g) if (h < 0) == (f < 0) else (a, middle, f, h)
            apart = np.linalg.norm(ends - distance.surface(*middle), axis=1).min()
            if apart > (0.0 if is_seam else clearance):
                found.append((i + 1, middle))
    found.sort(key=lambda item: item[0])
    at = np.array([i for i, _ in found], np.int64)
    if not len(at):
        return none
    return np.insert(path, at, np.array([p for _, p in found]), axis=0), at + np.arange(len(at))


def _shorten_range(
    distance: ComposedDistance, path: Array, first: int, last: int, is_end: tuple[bool, bool], reach: Array
) -> tuple[int, int]:
    """The range of a path (n, 2), shorter where its inner ends are no points near zeros: next to a jump they may be none.

    `is_end`: whether the ends of the whole path are known. A projection moves by at most `reach` (2,).
    """

    def is_near_zero(i: int) -> bool:
        try:
            moved = np.abs(project_to_zero(distance, path[i]) - path[i])
        except TrimmingError:
            return False
        return bool((moved <= reach).all())

    while first < last and not (first == 0 and is_end[0]) and not is_near_zero(first):
        first += 1
    while first < last and not (last == len(path) - 1 and is_end[1]) and not is_near_zero(last):
        last -= 1
    return first, last


def _split_range(first: int, last: int, at: list[int]) -> list[tuple[int, int]]:
    """The range from `first` to `last`, split at the numbers inside it."""
    return list(pairwise([first, *(k for k in at if first < k < last), last]))


def _collect_chains(follow: dict[int, int]) -> list[tuple[list[int], bool]]:
    """Crossings in order along every branch, and whether it is closed: the first is repeated at the end then."""
    left, chains = dict(follow), []
    for head in [*sorted(follow.keys() - set(follow.values())), None]:
        while left if head is None else head in left:
            chain = [next(iter(left)) if head is None else head]
            while chain[-1] in left:
                chain.append(left.pop(chain[-1]))
            chains.append((chain, head is None))
    return chains


def _is_on_border(crossing: int, nu: int, nv: int) -> bool:
    """Whether a crossed grid edge lies on the border of the grid."""
    i, j = divmod(crossing % (nu * nv), nv)
    return j in (0, nv - 1) if crossing < nu * nv else i in (0, nu - 1)


def _runs(near: BoolArray) -> list[tuple[int, int]]:
    """First and last index of each run of at least two near points, one more on both sides included."""
    wide = near.copy()
    wide[1:] |= near[:-1]
    wide[:-1] |= near[1:]
    change = np.flatnonzero(np.diff(np.concatenate([[False], wide, [False]]).astype(np.int64)))
    return [(int(a), int(b) - 1) for a, b in change.reshape(-1, 2) if b - a > 1]
