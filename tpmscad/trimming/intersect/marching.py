"""The zero set of one surface's distance on one patch: marched on a grid whose lines are set so that no branch hides in a cell.

A saddle in the plane becomes the common end of four arms. On the border nothing is decided here: signs there follow from the
roots of the shared edges, so that neighbours agree.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.errors import TrimmingError
from tpmscad.splines.bspline import BSplineSurface
from tpmscad.trimming.intersect.critical_points import find_critical_points, refine_grid_lines
from tpmscad.trimming.intersect.patch_borders import BorderSide, impose_border_signs, place_grid_lines, side_fractions
from tpmscad.trimming.operands.implicit_surfaces import (
    ComposedDistance,
    ImplicitSurfaces,
    compose_with_patch,
    evaluate_second_jet,
)

ArcEnd = tuple[str, int, int]
"""Where an arc ends: ("root", side, number along the side), ("corner", corner, 0) or ("point", index, 0)."""


@dataclass(frozen=True, slots=True, eq=False)
class Arc:
    """A branch of the zero set, negative values on its left: a coarse path (m, 2) in (u, v) with exact ends."""

    path: Array
    start: ArcEnd
    end: ArcEnd


@dataclass(frozen=True, slots=True, eq=False)
class Trace:
    """The arcs of one plane on one patch; without any, `sign` tells on which side the patch lies.

    `points` (n, 2): inner points in which arcs end. `on_side` (4,): the sign next to sides that lie in the plane, else 0.
    `foci` (n, 3): (u, v) and radius there of points about which arcs turn sharply.
    """

    arcs: tuple[Arc, ...]
    sign: int
    points: Array
    sign_beside_side: IntArray
    foci: Array


EMPTY_TRACE = Trace((), 0, np.zeros((0, 2)), np.zeros(4, np.int64), np.zeros((0, 3)))


def march_patch(
    surface: BSplineSurface, row: ImplicitSurfaces, borders: tuple[BorderSide, ...], on_corner: BoolArray, flat: float
) -> Trace:
    """Trace the zeros of one surface's distance (the one row) on a patch.

    A saddle nearer to zero than `flat` counts as zero, a smaller hill as none.
    """
    level = compose_with_patch(surface, row)
    us, vs = place_grid_lines(surface, borders, on_corner)
    critical = find_critical_points(level, us, vs)
    us, vs, saddles = refine_grid_lines(us, vs, critical, on_corner, flat)
    for _ in range(8):
        values = level.grid(us, vs)[..., 0]
        negative = values < 0
        on_side = impose_border_signs(level, us, vs, borders, on_corner, negative)
        follow, ambiguous = _link_crossings(negative, us, vs, saddles)
        if len(ambiguous) == 0:
            break
        i, j = ambiguous.T
        us = np.union1d(us, 0.5 * (us[i] + us[i + 1]))
        vs = np.union1d(vs, 0.5 * (vs[j] + vs[j + 1]))
    else:
        raise TrimmingError(f"branches of a cut stay unresolved near (u, v) = ({us[i[0]]:.6f}, {vs[j[0]]:.6f})")
    if not follow:
        return replace(EMPTY_TRACE, sign=-1 if negative.flat[negative.size // 2] else 1, sign_beside_side=on_side)
    arcs, points = _chain_arcs(level, follow, values, us, vs, borders, saddles)
    foci = np.array([[*c.at, c.scale] for c in critical if abs(c.value) > flat]).reshape(-1, 3)
    return Trace(arcs, 0, points, on_side, foci)


def _link_crossings(negative: BoolArray, us: Array, vs: Array, saddles: Array) -> tuple[dict[int, int], IntArray]:
    """Directed links between crossed grid edges, negative on the left, through every cell; and the ambiguous cells (n, 2).

    Edge (i, j)-(i + 1, j) has the number i nv + j, edge (i, j)-(i, j + 1) the number nu nv + i nv + j. The arms of saddle s
    are -1 - 4 s - k: those that end there k = 0, 1, those that start there k = 2, 3.
    """
    nu, nv = negative.shape
    corner = np.stack([negative[:-1, :-1], negative[1:, :-1], negative[1:, 1:], negative[:-1, 1:]])
    leaves = corner & ~np.roll(corner, -1, axis=0)  # counter-clockwise from - to +: the curve starts here
    enters = ~corner & np.roll(corner, -1, axis=0)
    count = leaves.sum(axis=0)
    follow: dict[int, int] = {}
    for s, at in enumerate(saddles):
        i, j = np.searchsorted(us, at[0]) - 2, np.searchsorted(vs, at[1]) - 2
        count[i : i + 3, j : j + 3] = 0
        out, into = _collect_block_rim(negative, i, j)
        if len(out) != 2 or len(into) != 2:
            raise TrimmingError(f"a saddle in the plane does not have four arms on the grid, at (u, v) = {at}")
        for k in (0, 1):
            follow[out[k]] = -1 - 4 * s - k
            follow[-3 - 4 * s - k] = into[k]
    i, j = np.nonzero(count)
    base = i * nv + j
    number = np.stack([base, nu * nv + base + nv, base + 1, nu * nv + base])
    simple = count[i, j] == 1
    column = np.arange(len(i))
    start = number[leaves[:, i, j].argmax(axis=0), column]
    end = number[enters[:, i, j].argmax(axis=0), column]
    follow |= dict(zip(start[simple].tolist(), end[simple].tolist(), strict=True))
    return follow, np.column_stack([i, j])[~simple]


def _collect_block_rim(negative: BoolArray, i: int, j: int) -> tuple[list[int], list[int]]:
    """Crossed edges round the block of 3 x 3 cells from node (i, j): those where curves run into it, and out of it."""
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
    level: BSplineSurface | ComposedDistance,
    follow: dict[int, int],
    values: Array,
    us: Array,
    vs: Array,
    borders: tuple[BorderSide, ...],
    saddles: Array,
) -> tuple[tuple[Arc, ...], Array]:
    """Arcs along the links: open ones first, then loops, each cut in two; and the inner points they end in (n, 2)."""
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
        path = _interpolate_crossings(np.array(chain), values, us, vs)
        half = len(path) // 2
        path[0] = path[-1] = _project_to_zero(level, path[0])
        path[half] = _project_to_zero(level, path[half])
        ends: list[ArcEnd] = [("point", len(points), 0), ("point", len(points) + 1, 0)]
        points += [path[0], path[half]]
        arcs += [Arc(path[: half + 1], ends[0], ends[1]), Arc(path[half:], ends[1], ends[0])]
    return tuple(arcs), np.array(points).reshape(-1, 2)


def _project_to_zero(level: BSplineSurface | ComposedDistance, p: Array) -> Array:
    """The zero of `level` that Newton steps along the gradient find from p."""
    for _ in range(20):
        value, gradient, _ = evaluate_second_jet(level, p)
        step = value / (gradient @ gradient) * gradient
        p = p - step
        if np.abs(step).max() < 1e-15:
            break
    return p


def _build_arc(
    chain: list[int], values: Array, us: Array, vs: Array, borders: tuple[BorderSide, ...], saddles: Array
) -> Arc:
    ends, exact = [], []
    for crossing in (chain[0], chain[-1]):
        if crossing < 0:
            saddle = (-crossing - 1) // 4
            ends.append(("point", saddle, 0))
            exact.append(saddles[saddle])
        else:
            end, at = _locate_border_end(crossing, us, vs, borders)
            ends.append(end)
            exact.append(at)
    inner = np.array([c for c in chain[1:-1]], np.int64)
    path = np.vstack([exact[0], _interpolate_crossings(inner, values, us, vs), exact[1]])
    return Arc(path, ends[0], ends[1])


def _locate_border_end(crossing: int, us: Array, vs: Array, borders: tuple[BorderSide, ...]) -> tuple[ArcEnd, Array]:
    """What a crossed border edge of the grid stands for, and its exact place."""
    nu, nv = len(us), len(vs)
    i, j = divmod(crossing % (nu * nv), nv)
    if crossing < nu * nv:
        side, number = (0, i) if j == 0 else (2, nu - 2 - i)
    else:
        side, number = (3, nv - 2 - j) if i == 0 else (1, j)
    x = side_fractions(us, vs, side)[number : number + 2]
    roots = borders[side].roots
    inside = np.searchsorted(roots, x)
    corners = np.array([[us[0], vs[0]], [us[-1], vs[0]], [us[-1], vs[-1]], [us[0], vs[-1]]])
    if inside[1] - inside[0] == 1:
        a, b = corners[side], corners[(side + 1) % 4]
        return ("root", side, int(inside[0])), a + roots[inside[0]] * (b - a)
    corner = side if number == 0 else (side + 1) % 4
    if inside[0] != inside[1] or (number != 0 and number != len(side_fractions(us, vs, side)) - 2):
        raise TrimmingError("a cut leaves a patch where its edge has no root")
    return ("corner", corner, 0), corners[corner]


def _interpolate_crossings(crossings: IntArray, values: Array, us: Array, vs: Array) -> Array:
    """Places of crossed grid edges by linear interpolation: (n, 2)."""
    nu, nv = values.shape
    i, j = np.divmod(crossings % (nu * nv), nv)
    along_u = crossings < nu * nv
    a, b = values[i, j], values[i + along_u, j + ~along_u]
    with np.errstate(divide="ignore", invalid="ignore"):
        f = np.clip(np.nan_to_num(a / (a - b), nan=0.5), 1e-3, 1 - 1e-3)
    u = us[i] + np.where(along_u, f, 0.0) * (us[i + along_u] - us[i])
    v = vs[j] + np.where(along_u, 0.0, f) * (vs[j + ~along_u] - vs[j])
    return np.column_stack([u, v])
