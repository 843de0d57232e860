"""The zero set of one plane's distance on one patch: marched on a grid whose lines are set so that no branch hides in a cell.

A saddle in the plane becomes the common end of four arms. On the border nothing is decided here: signs there follow from the
roots of the shared edges, so that neighbours agree.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from tpmscad.splines.bspline import Surface
from tpmscad.trimming.critical import critical_points, refine
from tpmscad.trimming.tool import Array, Flags, Ints, TrimmingError

CELLS_U, CELLS_V = 33, 37
"""Cells of the grid. Odd and without a common factor, so that no line or diagonal of symmetry holds a grid point."""

Scalar = TypeVar("Scalar", np.bool_, np.float64)

End = tuple[str, int, int]
"""Where an arc ends: ("root", side, number along the side), ("corner", corner, 0) or ("point", index, 0)."""


@dataclass(frozen=True, slots=True, eq=False)
class Border:
    """What the shared edges say about one side: roots as fractions of the side, rising; the sign (-1, +1) before the first
    root, 0 for a side that lies in the plane."""

    roots: Array
    sign: int


@dataclass(frozen=True, slots=True, eq=False)
class Arc:
    """A branch of the zero set, negative values on its left: a coarse path (m, 2) in (u, v) with exact ends."""

    path: Array
    start: End
    end: End


@dataclass(frozen=True, slots=True, eq=False)
class Trace:
    """The arcs of one plane on one patch; without any, `sign` tells on which side the patch lies.

    `points` (n, 2): inner points in which arcs end. `on_side` (4,): the sign next to sides that lie in the plane, else 0.
    `foci` (n, 3): (u, v) and radius there of points about which arcs turn sharply.
    """

    arcs: tuple[Arc, ...]
    sign: int
    points: Array
    on_side: Ints
    foci: Array


NONE = Trace((), 0, np.zeros((0, 2)), np.zeros(4, np.int64), np.zeros((0, 3)))


def march(
    surface: Surface, normal: Array, constant: float, borders: tuple[Border, ...], on_corner: Flags, flat: float
) -> Trace:
    """Trace normal . S(u, v) + constant = 0. A saddle nearer to zero than `flat` counts as zero, a smaller hill as none."""
    level = Surface((surface.poles @ normal + constant)[..., None], *_spline_space(surface))
    us, vs = _grid_lines(surface, borders, on_corner)
    critical = critical_points(level, us, vs)
    us, vs, saddles = refine(us, vs, critical, on_corner, flat)
    for _ in range(8):
        values = level.grid(us, vs)[..., 0]
        negative = values < 0
        on_side = _border_signs(level, us, vs, borders, on_corner, negative)
        follow, ambiguous = _links(negative, us, vs, saddles)
        if len(ambiguous) == 0:
            break
        i, j = ambiguous.T
        us = np.union1d(us, 0.5 * (us[i] + us[i + 1]))
        vs = np.union1d(vs, 0.5 * (vs[j] + vs[j + 1]))
    else:
        raise TrimmingError(f"branches of a cut stay unresolved near (u, v) = ({us[i[0]]:.6f}, {vs[j[0]]:.6f})")
    if not follow:
        return replace(NONE, sign=-1 if negative.flat[negative.size // 2] else 1, on_side=on_side)
    arcs, points = _chained(level, follow, values, us, vs, borders, saddles)
    foci = np.array([[*c.at, c.scale] for c in critical if abs(c.value) > flat]).reshape(-1, 3)
    return Trace(arcs, 0, points, on_side, foci)


def _spline_space(surface: Surface) -> tuple[Array, Array, int, int]:
    return surface.knots_u, surface.knots_v, surface.degree_u, surface.degree_v


def _grid_lines(surface: Surface, borders: tuple[Border, ...], on_corner: Flags) -> tuple[Array, Array]:
    """Uniform lines, and one between any two roots of a side that would share an interval, or a root and a corner."""
    lines = [np.linspace(*surface.domain[0], CELLS_U + 1), np.linspace(*surface.domain[1], CELLS_V + 1)]
    for side, border in enumerate(borders):
        axis = side % 2
        low, high = surface.domain[axis]
        ends = [np.zeros(int(on_corner[side])), border.roots, np.ones(int(on_corner[(side + 1) % 4]))]
        stops = np.concatenate(ends)
        if len(stops) > 1 and len(border.roots):
            middle = 0.5 * (stops[1:] + stops[:-1])
            middle = 1.0 - middle if side >= 2 else middle
            lines[axis] = np.union1d(lines[axis], low + (high - low) * middle)
    return lines[0], lines[1]


def _side_nodes(array: NDArray[Scalar], side: int) -> NDArray[Scalar]:
    """The border nodes of a side in the side's direction, as a view."""
    return (array[:, 0], array[-1], array[::-1, -1], array[0, ::-1])[side]


def _fractions(us: Array, vs: Array, side: int) -> Array:
    lines = us if side % 2 == 0 else vs
    x = (lines - lines[0]) / (lines[-1] - lines[0])
    return x if side < 2 else 1.0 - x[::-1]


def _border_signs(
    level: Surface, us: Array, vs: Array, borders: tuple[Border, ...], on_corner: Flags, negative: Flags
) -> Ints:
    """Overwrite the border nodes of `negative` by what the shared edges say; returns the signs next to sides in the plane."""
    on_side = np.zeros(4, np.int64)
    first, last = np.zeros(4, np.int64), np.zeros(4, np.int64)
    if all(border.sign == 0 for border in borders):
        raise TrimmingError("all four sides of a patch lie in one plane")
    for side, border in enumerate(borders):
        if border.sign == 0:
            inwards = (0, 1) if side % 2 == 0 else (1, 0)
            slope = _side_nodes(level.grid(us, vs, *inwards)[..., 0], side)[1:-1] * (1 if side in (0, 3) else -1)
            if (slope > 0).any() and (slope < 0).any():
                raise TrimmingError("a patch's side lies in a plane that the patch touches or crosses there")
            on_side[side] = -1 if slope[len(slope) // 2] < 0 else 1
            _side_nodes(negative, side)[:] = on_side[side] < 0
            continue
        odd = np.searchsorted(border.roots, _fractions(us, vs, side)) % 2 == 1
        _side_nodes(negative, side)[1:-1] = (odd ^ (border.sign < 0))[1:-1]
        first[side] = border.sign
        last[side] = border.sign * (-1) ** len(border.roots)
    for corner in range(4):
        before, after = last[corner - 1], first[corner]
        if borders[corner - 1].sign == 0 and borders[corner].sign == 0:
            if on_side[corner - 1] != on_side[corner]:
                raise TrimmingError("two sides of a patch lie in a plane, on different sides of it")
            value = on_side[corner]
        elif 0 in (before, after):
            value = before or after
            if value != (on_side[corner] or on_side[corner - 1]):
                raise TrimmingError("a cut starts from the end of a patch's side that lies in its plane")
        else:
            value = before if before == after else 1
            if before != after and not on_corner[corner]:
                raise TrimmingError("two edges disagree on the side of their common vertex")
        _side_nodes(negative, corner)[0] = value < 0
    return on_side


def _links(negative: Flags, us: Array, vs: Array, saddles: Array) -> tuple[dict[int, int], Ints]:
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
        out, into = _rim(negative, i, j)
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


def _rim(negative: Flags, i: int, j: int) -> tuple[list[int], list[int]]:
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


def _chained(
    level: Surface,
    follow: dict[int, int],
    values: Array,
    us: Array,
    vs: Array,
    borders: tuple[Border, ...],
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
        arcs.append(_arc(chain, values, us, vs, borders, saddles))
    while left:
        chain = [next(iter(left))]
        while chain[-1] in left:
            chain.append(left.pop(chain[-1]))
        path = _positions(np.array(chain), values, us, vs)
        half = len(path) // 2
        path[0] = path[-1] = _onto(level, path[0])
        path[half] = _onto(level, path[half])
        ends: list[End] = [("point", len(points), 0), ("point", len(points) + 1, 0)]
        points += [path[0], path[half]]
        arcs += [Arc(path[: half + 1], ends[0], ends[1]), Arc(path[half:], ends[1], ends[0])]
    return tuple(arcs), np.array(points).reshape(-1, 2)


def _onto(level: Surface, p: Array) -> Array:
    """The zero of `level` that Newton steps along the gradient find from p."""
    for _ in range(20):
        g, gu, gv = (float(level(p[0], p[1], a, b)[0]) for a, b in ((0, 0), (1, 0), (0, 1)))
        step = g / (gu * gu + gv * gv) * np.array([gu, gv])
        p = p - step
        if np.abs(step).max() < 1e-15:
            break
    return p


def _arc(chain: list[int], values: Array, us: Array, vs: Array, borders: tuple[Border, ...], saddles: Array) -> Arc:
    ends, exact = [], []
    for crossing in (chain[0], chain[-1]):
        if crossing < 0:
            saddle = (-crossing - 1) // 4
            ends.append(("point", saddle, 0))
            exact.append(saddles[saddle])
        else:
            end, at = _border_end(crossing, us, vs, borders)
            ends.append(end)
            exact.append(at)
    inner = np.array([c for c in chain[1:-1]], np.int64)
    path = np.vstack([exact[0], _positions(inner, values, us, vs), exact[1]])
    return Arc(path, ends[0], ends[1])


def _border_end(crossing: int, us: Array, vs: Array, borders: tuple[Border, ...]) -> tuple[End, Array]:
    """What a crossed border edge of the grid stands for, and its exact place."""
    nu, nv = len(us), len(vs)
    i, j = divmod(crossing % (nu * nv), nv)
    if crossing < nu * nv:
        side, number = (0, i) if j == 0 else (2, nu - 2 - i)
    else:
        side, number = (3, nv - 2 - j) if i == 0 else (1, j)
    x = _fractions(us, vs, side)[number : number + 2]
    roots = borders[side].roots
    inside = np.searchsorted(roots, x)
    corners = np.array([[us[0], vs[0]], [us[-1], vs[0]], [us[-1], vs[-1]], [us[0], vs[-1]]])
    if inside[1] - inside[0] == 1:
        a, b = corners[side], corners[(side + 1) % 4]
        return ("root", side, int(inside[0])), a + roots[inside[0]] * (b - a)
    corner = side if number == 0 else (side + 1) % 4
    if inside[0] != inside[1] or (number != 0 and number != len(_fractions(us, vs, side)) - 2):
        raise TrimmingError("a cut leaves a patch where its edge has no root")
    return ("corner", corner, 0), corners[corner]


def _positions(crossings: Ints, values: Array, us: Array, vs: Array) -> Array:
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
