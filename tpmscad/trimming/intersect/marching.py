"""Marching the zero set of the distance from one surface on one patch, on a grid that resolves every branch.

The grid lines are placed about the critical points, so that no branch lies within one cell. A saddle in the surface becomes the
common end of four arms. The signs on the patch's border are not read from the patch: they follow from the roots of the shared
edges, so that adjacent patches agree.

`march_patch` is the reference. `marching_batched` does the same for many patches at once and leaves it the special cases.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.errors import TrimmingError
from tpmscad.splines.bspline import BSplineSurface
from tpmscad.trimming.intersect.critical_points import find_critical_points, refine_grid_lines
from tpmscad.trimming.intersect.patch_borders import (
    BorderSide,
    grid_corners,
    impose_border_signs,
    place_grid_lines,
    side_fractions,
)
from tpmscad.trimming.operands.quadric_table import (
    ComposedDistance,
    QuadricTable,
    compose_with_patch,
    evaluate_second_jet,
)

MAX_REFINEMENTS = 8
"""Largest number of times that the lines through ambiguous cells are halved."""

NEWTON_STEPS = 20
"""Largest number of Newton steps from a closed branch's point to the zero set."""

STEP_TOL = 1e-15
"""Newton step in (u, v) at which such a point has converged."""

END_FRACTION = 1e-3
"""Fraction of a grid edge at its ends that a linearly interpolated crossing keeps clear of."""

ArcEnd = tuple[str, int, int]
"""The end of an arc: ("root", side, number along the side), ("corner", corner, 0) or ("point", index, 0)."""


@dataclass(frozen=True, slots=True, eq=False)
class Arc:
    """A branch of the zero set, with negative values on its left: a coarse path (m, 2) in (u, v) with exact ends."""

    path: Array
    start: ArcEnd
    end: ArcEnd


@dataclass(frozen=True, slots=True, eq=False)
class Trace:
    """The arcs of one surface on one patch; without arcs, `sign` is the sign of the distance on the patch.

    `points` (n, 2): inner points at which arcs end. `sign_beside_side` (4,): the sign next to sides that lie in the surface,
    else 0. `foci` (n, 3): (u, v) and radius in (u, v) of points about which arcs turn sharply.
    """

    arcs: tuple[Arc, ...]
    sign: int
    points: Array
    sign_beside_side: IntArray
    foci: Array


EMPTY_TRACE = Trace((), 0, np.zeros((0, 2)), np.zeros(4, np.int64), np.zeros((0, 3)))


def march_patch(
    surface: BSplineSurface,
    implicit: QuadricTable,
    borders: tuple[BorderSide, ...],
    on_corner: BoolArray,
    zero_tol: float,
) -> Trace:
    """The arcs of one implicit surface (a table of one row) on a patch.

    A saddle whose distance is below `zero_tol` lies in the surface; an extremum below it is ignored.
    """
    distance = compose_with_patch(surface, implicit)
    us, vs = place_grid_lines(surface, borders, on_corner)
    critical = find_critical_points(distance, us, vs)
    us, vs, saddles = refine_grid_lines(us, vs, critical, on_corner, zero_tol)
    for _ in range(MAX_REFINEMENTS):
        values = distance.grid(us, vs)[..., 0]
        negative = values < 0
        on_side = impose_border_signs(distance, us, vs, borders, on_corner, negative)
        follow, ambiguous = link_crossings(negative, us, vs, saddles)
        if len(ambiguous) == 0:
            break
        i, j = ambiguous.T
        us = np.union1d(us, 0.5 * (us[i] + us[i + 1]))
        vs = np.union1d(vs, 0.5 * (vs[j] + vs[j + 1]))
    else:
        raise TrimmingError(
            f"branches of an intersection curve stay unresolved near (u, v) = ({us[i[0]]:.6f}, {vs[j[0]]:.6f})"
        )
    if not follow:
        return replace(EMPTY_TRACE, sign=-1 if negative.flat[negative.size // 2] else 1, sign_beside_side=on_side)
    arcs, points = _chain_arcs(distance, follow, values, us, vs, borders, saddles)
    foci = np.array([[*c.parameters, c.radius] for c in critical if abs(c.value) > zero_tol]).reshape(-1, 3)
    return Trace(arcs, 0, points, on_side, foci)


def link_cells(negative: BoolArray, skipped: BoolArray | None = None) -> tuple[IntArray, IntArray, IntArray]:
    """Directed links between crossed grid edges, with the negative side on the left, through the cells of m grids.

    negative: (m, nu, nv). skipped (m, nu - 1, nv - 1): cells to leave out. Returns the first and the second crossed edge of each
    link, and the ambiguous cells (n, 3), which have more than one. In grid p the edge (i, j)-(i + 1, j) has the number
    2 nu nv p + i nv + j, and the edge (i, j)-(i, j + 1) the number 2 nu nv p + nu nv + i nv + j.
    """
    _, nu, nv = negative.shape
    corner = np.stack([negative[:, :-1, :-1], negative[:, 1:, :-1], negative[:, 1:, 1:], negative[:, :-1, 1:]])
    ahead = np.roll(corner, -1, axis=0)
    leaves, enters = corner & ~ahead, ~corner & ahead  # counter-clockwise from - to +: the curve starts there
    count = leaves.sum(axis=0)
    if skipped is not None:
        count[skipped] = 0
    p, i, j = np.nonzero(count)
    base = 2 * nu * nv * p + i * nv + j
    number = np.stack([base, nu * nv + base + nv, base + 1, nu * nv + base])
    column = np.arange(len(p))
    start = number[leaves[:, p, i, j].argmax(axis=0), column]
    end = number[enters[:, p, i, j].argmax(axis=0), column]
    simple = count[p, i, j] == 1
    return start[simple], end[simple], np.column_stack([p, i, j])[~simple]


def interpolate_crossings(crossings: IntArray, values: Array, us: Array, vs: Array) -> Array:
    """Points (n, 2) on crossed edges of m grids, by linear interpolation of values (m, nu, nv)."""
    _, nu, nv = values.shape
    patch, crossings = np.divmod(crossings, 2 * nu * nv)
    i, j = np.divmod(crossings % (nu * nv), nv)
    along_u = crossings < nu * nv
    a, b = values[patch, i, j], values[patch, i + along_u, j + ~along_u]
    with np.errstate(divide="ignore", invalid="ignore"):
        f = np.clip(np.nan_to_num(a / (a - b), nan=0.5), END_FRACTION, 1 - END_FRACTION)
    u = us[i] + np.where(along_u, f, 0.0) * (us[i + along_u] - us[i])
    v = vs[j] + np.where(along_u, 0.0, f) * (vs[j + ~along_u] - vs[j])
    return np.column_stack([u, v])


def link_crossings(
    negative: BoolArray, us: Array, vs: Array, saddles: Array, masked: BoolArray | None = None
) -> tuple[dict[int, int], IntArray]:
    """The crossed edge or arm that follows each one, and the ambiguous cells (n, 2); no branch passes `masked` cells.

    The arms of saddle s have the numbers -1 - 4 s - k: k = 0, 1 for those that end there, k = 2, 3 for those that start there.
    """
    skipped = np.zeros((1, len(us) - 1, len(vs) - 1), bool) if masked is None else masked[None].copy()
    follow: dict[int, int] = {}
    for s, at in enumerate(saddles):
        i, j = np.searchsorted(us, at[0]) - 2, np.searchsorted(vs, at[1]) - 2
        skipped[0, i : i + 3, j : j + 3] = True
        out, into = _collect_block_rim(negative, i, j)
        if len(out) != 2 or len(into) != 2:
            raise TrimmingError(f"a saddle in a surface of the body does not have four arms, at (u, v) = {at}")
        for k in (0, 1):
            follow[out[k]] = -1 - 4 * s - k
            follow[-3 - 4 * s - k] = into[k]
    start, end, ambiguous = link_cells(negative[None], skipped)
    follow |= dict(zip(start.tolist(), end.tolist(), strict=True))
    return follow, ambiguous[:, 1:]


def _collect_block_rim(negative: BoolArray, i: int, j: int) -> tuple[list[int], list[int]]:
    """Crossed edges round the block of 3 x 3 cells from node (i, j): those where curves enter it, and where they leave it."""
    nu, nv = negative.shape
    steps = [(1, 0)] * 3 + [(0, 1)] * 3 + [(-1, 0)] * 3 + [(0, -1)] * 3
    out: list[int] = []
    into: list[int] = []
    a = (i, j)
    for di, dj in steps:
        b = (a[0] + di, a[1] + dj)
        low = min(a, b)
        if negative[a] != negative[b]:
            (out if negative[a] else into).append(low[0] * nv + low[1] + (nu * nv if dj else 0))
        a = b
    return out, into


def _chain_arcs(
    distance: BSplineSurface | ComposedDistance,
    follow: dict[int, int],
    values: Array,
    us: Array,
    vs: Array,
    borders: tuple[BorderSide, ...],
    saddles: Array,
) -> tuple[tuple[Arc, ...], Array]:
    """The arcs along the links, and the inner points (n, 2) at which they end: open branches first, then loops in two halves."""
    heads = sorted(follow.keys() - set(follow.values()))
    left = dict(follow)
    points = list(saddles)
    arcs = []
    for head in heads:
        chain = [head]
        while chain[-1] in left:
            chain.append(left.pop(chain[-1]))
        arcs.append(_build_arc(chain, values, us, vs, borders, saddles))
    while left:
        chain = [next(iter(left))]
        while chain[-1] in left:
            chain.append(left.pop(chain[-1]))
        path = interpolate_crossings(np.array(chain), values[None], us, vs)
        half = len(path) // 2
        path[0] = path[-1] = project_to_zero(distance, path[0])
        path[half] = project_to_zero(distance, path[half])
        ends: list[ArcEnd] = [("point", len(points), 0), ("point", len(points) + 1, 0)]
        points += [path[0], path[half]]
        arcs += [Arc(path[: half + 1], ends[0], ends[1]), Arc(path[half:], ends[1], ends[0])]
    return tuple(arcs), np.array(points).reshape(-1, 2)


def project_to_zero(distance: BSplineSurface | ComposedDistance, p: Array) -> Array:
    """The zero of `distance` that Newton steps along the gradient find from p."""
    for _ in range(NEWTON_STEPS):
        value, gradient, _ = evaluate_second_jet(distance, p)
        step = value / (gradient @ gradient) * gradient
        p = p - step
        if np.abs(step).max() < STEP_TOL:
            break
    return p


def _build_arc(
    chain: list[int], values: Array, us: Array, vs: Array, borders: tuple[BorderSide, ...], saddles: Array
) -> Arc:
    """The arc along a chain of crossings whose ends are on the border or at saddles."""
    ends, exact = [], []
    for crossing in (chain[0], chain[-1]):
        if crossing < 0:
            saddle = (-crossing - 1) // 4
            ends.append(("point", saddle, 0))
            exact.append(saddles[saddle])
        else:
            end, at = locate_border_end(crossing, us, vs, borders)
            ends.append(end)
            exact.append(at)
    inner = interpolate_crossings(np.array(chain[1:-1], np.int64), values[None], us, vs)
    return Arc(np.vstack([exact[0], inner, exact[1]]), ends[0], ends[1])


def locate_border_end(crossing: int, us: Array, vs: Array, borders: tuple[BorderSide, ...]) -> tuple[ArcEnd, Array]:
    """The root or corner that a crossed border edge of the grid stands for, and its exact (u, v)."""
    nu, nv = len(us), len(vs)
    i, j = divmod(crossing % (nu * nv), nv)
    if crossing < nu * nv:
        side, number = (0, i) if j == 0 else (2, nu - 2 - i)
    else:
        side, number = (3, nv - 2 - j) if i == 0 else (1, j)
    fractions = side_fractions(us, vs, side)
    roots = borders[side].roots
    inside = np.searchsorted(roots, fractions[number : number + 2])
    corners = grid_corners(us, vs)
    if inside[1] - inside[0] == 1:
        a, b = corners[side], corners[(side + 1) % 4]
        return ("root", side, int(inside[0])), a + roots[inside[0]] * (b - a)
    corner = side if number == 0 else (side + 1) % 4
    if inside[0] != inside[1] or number not in (0, len(fractions) - 2):
        raise TrimmingError("an intersection curve leaves a patch where its edge has no intersection")
    return ("corner", corner, 0), corners[corner]
