"""Marching the zero set of the distance from a free-form surface, which jumps where two feet are equally near.

It differs from `marching` in what a jump asks for.

- A grid edge changes sign only if |d1| + |d2| is at most a little more than its length, since a distance is Lipschitz. A cell
  with another change of sign, or with a foot forced to the border of the surface at a corner, is *masked*: no branch passes it.
- A branch may end at a masked cell; its end is an inner point.
- The signs on the patch's border are those of the distance, for parity says nothing after a jump.
- What lies away from the faces on the surface is left out before anything is fitted.

Branches are found pair by pair; the points at which they are divided and end are found for all pairs at once.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.brep.free_form_surface import FreeFormSurface
from tpmscad.brep.orthogonal_projection import project_to_patch
from tpmscad.errors import TrimmingError
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
)
from tpmscad.trimming.intersect.patch_borders import BorderSide, place_grid_lines, side_fractions, view_side_nodes
from tpmscad.trimming.intersect.patch_distances import PatchDistances
from tpmscad.trimming.intersect.surface_kinks import CoarseBranch, insert_kinks
from tpmscad.trimming.operands.quadric_table import ComposedDistance, QuadricTable

LIPSCHITZ_FACTOR = 1.2
"""Largest ratio of |d1| + |d2| to the length of a grid edge at whose ends a distance has two signs: 1, and some for chords."""

BLOCK_NODES = 6
"""Nodes along u and v of a block that is tested as a whole."""

FAR_RADII = 2.0
"""Distance of a block's middle, in radii of the block, beyond which no zero is within several steps of its nodes."""

BorderDistance = Callable[[Array], Array]
"""Distances (n,) of points (n, 3) in the patch's frame from the nearest border of a face on the surface, negative in a face."""

KINK_CLEARANCE_STEPS = 0.2
"""Grid steps from the border of a face within which they are not: an edge of the body is there, and short edges would result."""

MASK_REFINEMENTS = 4
"""Largest number of times that lines through masked cells next to a face are halved: a face of a sixteenth of a cell is found."""

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


@dataclass(slots=True, eq=False)
class _Branch:
    """A branch of a zero set: its path (n, 2), the ends known before it is divided, and what of it is near faces.

    `pair`: number of the pair that it belongs to. `is_closed`: it was closed; `is_loop`: near faces all along as well, with its
    first point repeated at its end. `pieces`: first and last index of each part near faces. `clear` (n,) and `clearance`: see
    `insert_kinks`. `reach` (2,): steps of the grid, by which a projection may move. `kinks` (k,): where it is to be divided.
    `zeros`: the zeros found from points of the path, by their numbers; NaN where there is none.
    """

    pair: int
    path: Array
    ends: tuple[ArcEnd | None, ArcEnd | None]
    is_closed: bool
    is_loop: bool
    pieces: list[tuple[int, int]]
    clear: BoolArray
    clearance: float
    reach: Array
    kinks: IntArray = field(default_factory=lambda: np.zeros(0, np.int64))
    zeros: dict[int, Array] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class _TracedPair:
    """The branches of a pair, the inner points (n, 2) at which branches end, and the foci as of `Trace`."""

    branches: list[_Branch]
    saddles: Array
    foci: Array


def march_masked_patches(
    patches: Sequence[BSplineSurface],
    implicit: QuadricTable,
    borders: Sequence[tuple[BorderSide, ...]],
    on_corner: BoolArray,
    zero_tol: float,
    border_distances: Sequence[BorderDistance],
) -> list[Trace]:
    """The traces of n pairs of a patch and a free-form surface, as by `march_patch`, next to the surface's faces.

    on_corner: (n, 4). TrimmingError if a corner or a side of the patch lies in the surface.
    """
    if not patches:
        return []
    traced = [
        _trace_branches(i, ComposedDistance(patch, implicit.row(i)), borders[i], on_corner[i], zero_tol, measure)
        for i, (patch, measure) in enumerate(zip(patches, border_distances, strict=True))
    ]
    distances = PatchDistances(patches, implicit)
    branches = [branch for one in traced for branch in one.branches]
    divided = insert_kinks(distances, [CoarseBranch(b.pair, b.path, b.clear, b.clearance) for b in branches])
    for branch, (path, kinks) in zip(branches, divided, strict=True):
        shifts = np.searchsorted(kinks - np.arange(len(kinks)), np.arange(len(branch.path)), side="right")
        branch.pieces = [(int(i + shifts[i]), int(j + shifts[j])) for i, j in branch.pieces]
        branch.path, branch.kinks = path, kinks
    _find_zeros(distances, branches)
    return [_build_trace(distances, one) for one in traced]


def _trace_branches(
    pair: int,
    distance: ComposedDistance,
    borders: tuple[BorderSide, ...],
    on_corner: BoolArray,
    zero_tol: float,
    border_distance: BorderDistance,
) -> _TracedPair:
    """The branches of one pair on a grid that resolves them."""
    if on_corner.any() or any(border.sign == 0 for border in borders):
        raise TrimmingError("a corner of a patch lies in a free-form face of the body")
    samples = _sample(distance, *place_grid_lines(distance.surface, borders, on_corner))
    critical = _find_critical_points(distance, samples)
    us, vs, saddles = refine_grid_lines(samples.us, samples.vs, critical, on_corner, zero_tol)
    if len(us) > len(samples.us) or len(vs) > len(samples.vs) or len(saddles):
        samples = _sample(distance, us, vs)
    for attempt in range(MAX_REFINEMENTS):
        negative = samples.values < 0
        masked = _mask_borders(samples, negative, borders)
        follow, ambiguous = link_crossings(negative, samples.us, samples.vs, saddles, masked)
        if len(ambiguous) == 0 and attempt < MASK_REFINEMENTS:
            ambiguous = _find_masked_crossings(distance, samples, masked, border_distance)
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
    branches = _collect_branches(pair, distance, follow, samples, borders, saddles, border_distance)
    foci = np.zeros((0, 3))
    if branches:
        foci = np.array([[*c.parameters, c.radius] for c in critical if abs(c.value) > zero_tol]).reshape(-1, 3)
        foci = np.vstack([foci, _find_pole_foci(distance, samples)])
    return _TracedPair(branches, saddles, foci)


def _sample(distance: ComposedDistance, us: Array, vs: Array) -> _Samples:
    """The distance on a grid, with the cells that no branch passes; most nodes far from the surface are not evaluated."""
    points = distance.patch_grid(us, vs)
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
        slope = np.einsum("uvk,uvk->uv", samples.gradients, distance.patch_grid(us, vs, *order))
        slopes.append(np.where(bad, np.inf, slope)[None])  # the flattest node is sought among the others
    small, _, starts = place_newton_starts(samples.values[None], slopes[0], slopes[1], us, vs, bad[None])
    h = np.array([np.diff(us).max(), np.diff(vs).max()])
    return collect_critical_points(distance, starts, h, float(small[0]))


def _find_pole_foci(distance: ComposedDistance, samples: _Samples) -> Array:
    """Where the patch comes near poles of the surface: (u, v) and the distance in (u, v), (k, 3). Arcs turn sharply there."""
    placed = distance.implicit.placed
    assert placed is not None
    form, place = placed.forms[int(placed.number[0])], placed.place[0]
    poles = form.poles_across_v() if isinstance(form, FreeFormSurface) else ()
    if not poles:
        return np.zeros((0, 3))
    points = place.apply_inverse(np.array([pole for _, pole in poles]))
    apart = np.linalg.norm(samples.points[:, :, None] - points, axis=3).reshape(-1, len(points))
    i, j = np.unravel_index(apart.argmin(axis=0), samples.points.shape[:2])
    radius, u, v = project_to_patch(distance.surface, points, samples.us[i], samples.vs[j])
    return np.column_stack([u, v, radius / np.sqrt(np.linalg.norm(distance.surface.normal(u, v), axis=1))])


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


def _find_masked_crossings(
    distance: ComposedDistance, samples: _Samples, masked: BoolArray, border_distance: BorderDistance
) -> IntArray:
    """Masked cells (n, 2) with a change of sign next to a face: a branch may cross the face's edge in them.

    The surface of a face that is narrower than a cell ends within one, too, on both sides of the face.
    """
    corners = np.stack([samples.values[i : i - 1 or None, j : j - 1 or None] for i in (0, 1) for j in (0, 1)])
    points = samples.points
    radius = 0.5 * np.linalg.norm(points[1:, 1:] - points[:-1, :-1], axis=2)
    changes = (corners.min(axis=0) < 0) & (corners.max(axis=0) >= 0) & (np.abs(corners).min(axis=0) <= 2.0 * radius)
    i, j = np.nonzero(masked & changes)
    if len(i) == 0:
        return np.zeros((0, 2), np.int64)
    us, vs = samples.us, samples.vs
    middle = distance.surface(0.5 * (us[i] + us[i + 1]), 0.5 * (vs[j] + vs[j + 1]))
    return np.column_stack([i, j])[border_distance(middle) <= radius[i, j]]


def _collect_branches(
    pair: int,
    distance: ComposedDistance,
    follow: dict[int, int],
    samples: _Samples,
    borders: tuple[BorderSide, ...],
    saddles: Array,
    border_distance: BorderDistance,
) -> list[_Branch]:
    """The branches that are near faces, with the parts that are."""
    us, vs = samples.us, samples.vs
    step = float(max(np.linalg.norm(np.diff(samples.points, axis=axis), axis=2).max() for axis in (0, 1)))
    clearance = KINK_CLEARANCE_STEPS * step
    reach = np.array([np.diff(us).max(), np.diff(vs).max()])
    branches = []
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
        near = depth <= MARGIN_STEPS * step
        is_loop = is_closed and bool(near[:-1].all())
        if is_loop:
            path, depth = np.vstack([path[:-1], path[:1]]), np.append(depth[:-1], depth[0])
            half, last = (len(path) - 1) // 2, len(path) - 1
            pieces = [(0, half), (half, last)]
        elif is_closed:
            turn = int(np.argmin(near[:-1]))
            path, depth = np.roll(path[:-1], -turn, axis=0), np.roll(depth[:-1], -turn)
            pieces = _runs(np.roll(near[:-1], -turn))
        else:
            pieces = _runs(near)
        if pieces:
            clear = np.abs(depth) > clearance
            branches.append(
                _Branch(pair, path, (ends[0], ends[1]), is_closed, is_loop, pieces, clear, clearance, reach)
            )
    return branches


def _find_zeros(distances: PatchDistances, branches: list[_Branch]) -> None:
    """Enter the zeros next to all points at which the branches may end or be divided."""
    wanted = [sorted({i for piece in b.pieces for i in piece} | set(b.kinks.tolist())) for b in branches]
    if not branches:
        return
    pair = np.repeat([b.pair for b in branches], [len(w) for w in wanted])
    zeros = distances.project_to_zero(pair, np.vstack([b.path[w] for b, w in zip(branches, wanted, strict=True)]))
    ends = np.cumsum([len(w) for w in wanted])[:-1]
    for branch, own, found in zip(branches, wanted, np.split(zeros, ends), strict=True):
        branch.zeros = dict(zip(own, found, strict=True))


def _zero_near(distances: PatchDistances, branch: _Branch, i: int) -> Array:
    """The zero (2,) found from a point of a branch, NaN if there is none."""
    if i not in branch.zeros:
        branch.zeros[i] = distances.project_to_zero(np.array([branch.pair]), branch.path[i : i + 1])[0]
    return branch.zeros[i]


def _build_trace(distances: PatchDistances, traced: _TracedPair) -> Trace:
    """The arcs of the branches near faces, divided at kinks."""
    points = list(traced.saddles)
    arcs: list[Arc] = []
    for branch in traced.branches:
        path, ranges = branch.path, branch.pieces
        if not branch.is_loop:
            ranges = [r for r in (_shorten_range(distances, branch, *r) for r in ranges) if r[0] < r[1]]
        made: dict[int, ArcEnd] = {}
        for first, last in [part for piece in ranges for part in _split_range(*piece, branch.kinks.tolist())]:
            own: list[ArcEnd] = []
            tips = path[[first, last]]
            for k, at in ((0, first), (1, last)):
                known = branch.ends[k] if not branch.is_closed and at == (0, len(path) - 1)[k] else None
                key = at % (len(path) - 1) if branch.is_loop else at
                if known is None and key not in made:
                    made[key] = ("point", len(points), 0)
                    points.append(_zero_near(distances, branch, at))
                    if not np.isfinite(points[-1]).all():
                        raise TrimmingError("an intersection with a free-form face of the body does not converge")
                end = known or made[key]
                if end[0] == "point":
                    tips[k] = points[end[1]]
                own.append(end)
            arcs.append(Arc(np.vstack([tips[:1], path[first + 1 : last], tips[1:]]), own[0], own[1]))
    if not arcs:
        return replace(EMPTY_TRACE, sign=1)  # the sign is asked for next to coincident sides only, which are refused
    return Trace(tuple(arcs), 0, np.array(points).reshape(-1, 2), np.zeros(4, np.int64), traced.foci)


def _shorten_range(distances: PatchDistances, branch: _Branch, first: int, last: int) -> tuple[int, int]:
    """The range of a branch, shorter where its inner ends are no points near zeros: next to a jump they may be none."""

    def is_near_zero(i: int) -> bool:
        moved = np.abs(_zero_near(distances, branch, i) - branch.path[i])
        return bool((moved <= branch.reach).all())

    is_end = [end is not None for end in branch.ends]
    while first < last and not (first == 0 and is_end[0]) and not is_near_zero(first):
        first += 1
    while first < last and not (last == len(branch.path) - 1 and is_end[1]) and not is_near_zero(last):
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
