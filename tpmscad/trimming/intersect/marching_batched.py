"""The plain ones of many marches at once: patches on whose grid nothing is hidden and nothing needs another line.

Such are all but a few. The others, with a critical point near zero, roots crowded on a side, a side in the plane, a closed or
an ambiguous branch, are marched one by one (`marching`), which does the same on a finer grid.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.splines.basis import design_matrix
from tpmscad.splines.bspline import BSplineSurface
from tpmscad.trimming.intersect.critical_points import detect_critical_points
from tpmscad.trimming.intersect.marching import EMPTY_TRACE, Arc, Trace, march_patch
from tpmscad.trimming.intersect.patch_borders import CELLS_U, CELLS_V, BorderSide, side_fractions
from tpmscad.trimming.operands.implicit_surfaces import ImplicitSurfaces

PATCHES_PER_BATCH = 32
"""Patches looked at together: their grids stay in the processor's cache."""


def march_patches(
    surfaces: Sequence[BSplineSurface],
    levels: ImplicitSurfaces,
    borders: Sequence[tuple[BorderSide, ...]],
    on_corner: BoolArray,
    flat: float,
) -> list[Trace]:
    """`march` for n surfaces, levels and borders; on_corner (n, 4)."""
    traces: list[Trace | None] = [None] * len(surfaces)
    groups: dict[tuple[int, bool], list[int]] = {}
    for i, (surface, is_plane) in enumerate(zip(surfaces, levels.flat.tolist(), strict=True)):
        groups.setdefault((id(surface), is_plane), []).append(i)
    for (_, is_plane), members in groups.items():
        at, surface = np.array(members), surfaces[members[0]]
        if is_plane:
            at = at[~_skip_missed_patches(surface, levels.of(at), on_corner[at], at, traces)]
        grid = _build_grid(surface)
        for rows in np.array_split(at, -(-len(at) // PATCHES_PER_BATCH)) if len(at) else ():
            table = _tabulate_borders([borders[i] for i in rows])
            for i, trace in zip(
                rows.tolist(), _march_simple_patches(grid, levels.of(rows), table, on_corner[rows]), strict=True
            ):
                traces[i] = trace
    return [
        march_patch(surfaces[i], levels.of(np.array([i])), borders[i], on_corner[i], flat) if trace is None else trace
        for i, trace in enumerate(traces)
    ]


def _skip_missed_patches(
    surface: BSplineSurface, planes: ImplicitSurfaces, on_corner: BoolArray, at: IntArray, traces: list[Trace | None]
) -> BoolArray:
    """Which planes pass the patch by, as its poles tell: their traces are entered at `at`."""
    values = surface.poles.reshape(-1, 3) @ planes.axis.T + planes.a
    above = np.asarray((values > 0).all(axis=0))
    result: BoolArray = np.asarray((above | (values < 0).all(axis=0)) & ~on_corner.any(axis=1))
    for k in np.flatnonzero(result).tolist():
        traces[at[k]] = replace(EMPTY_TRACE, sign=1 if above[k] else -1)
    return result


@dataclass(frozen=True, slots=True, eq=False)
class _MarchingGrid:
    """The uniform lines of a patch, the bases there, and its points and derivatives (nu nv, 3)."""

    surface: BSplineSurface
    us: Array
    vs: Array
    bases: tuple[Array, Array, Array, Array]
    jet: tuple[Array, Array, Array]

    def levels(self, levels: ImplicitSurfaces) -> tuple[Array, Array, Array]:
        """The distances from m surfaces and their derivatives by u and by v: (m, nu, nv) each; all planes or none."""
        shape = len(levels), len(self.us), len(self.vs)
        if levels.flat.all():
            poles = np.einsum("uvk,mk->muv", self.surface.poles, levels.axis) + levels.a[:, None, None]
            u, v, du, dv = self.bases
            return u @ poles @ v.T, du @ poles @ v.T, u @ poles @ dv.T
        points, along_u, along_v = self.jet
        g, gradient = levels.jet(np.broadcast_to(points, (len(levels), *points.shape)), 1)
        by_u, by_v = (np.einsum("mnk,nk->mn", gradient, along) for along in (along_u, along_v))
        return g.reshape(shape), by_u.reshape(shape), by_v.reshape(shape)


def _build_grid(surface: BSplineSurface) -> _MarchingGrid:
    us = np.linspace(*surface.domain[0], CELLS_U + 1)
    vs = np.linspace(*surface.domain[1], CELLS_V + 1)
    u, du = (design_matrix(surface.knots_u, surface.degree_u, us, order) for order in (0, 1))
    v, dv = (design_matrix(surface.knots_v, surface.degree_v, vs, order) for order in (0, 1))
    jet = tuple(surface.grid(us, vs, *d).reshape(-1, 3) for d in ((0, 0), (1, 0), (0, 1)))
    return _MarchingGrid(surface, us, vs, (u, v, du, dv), (jet[0], jet[1], jet[2]))


@dataclass(frozen=True, slots=True, eq=False)
class _BorderTable:
    """The borders of m patches: first signs and numbers of roots (m, 4), roots filled up with infinity (m, 4, r)."""

    sign: IntArray
    count: IntArray
    roots: Array


def _tabulate_borders(borders: Sequence[tuple[BorderSide, ...]]) -> _BorderTable:
    count = np.array([[len(b.roots) for b in four] for four in borders])
    roots = np.full((*count.shape, max(1, count.max())), np.inf)
    for i, k in np.argwhere(count):
        roots[i, k, : count[i, k]] = borders[i][k].roots
    return _BorderTable(np.array([[b.sign for b in four] for four in borders]), count, roots)


def _march_simple_patches(
    grid: _MarchingGrid, levels: ImplicitSurfaces, borders: _BorderTable, on_corner: BoolArray
) -> list[Trace | None]:
    """Traces of those patches that are plain."""
    g, gu, gv = grid.levels(levels)
    us, vs = grid.us, grid.vs
    m, nu, nv = g.shape
    plain = ~detect_critical_points(grid.surface, levels, g, gu, gv, us, vs) & (borders.sign != 0).all(axis=1)
    negative = g < 0
    sides = negative[:, :, 0], negative[:, -1], negative[:, ::-1, -1], negative[:, 0, ::-1]
    last = borders.sign * (1 - 2 * (borders.count % 2))
    for side, nodes in enumerate(sides):
        x = side_fractions(us, vs, side)
        below = (borders.roots[:, side, :, None] < x).sum(axis=1)  # roots before each line: (m, nodes)
        nodes[:, 1:-1] = (below[:, 1:-1] % 2 == 1) ^ (borders.sign[:, side, None] < 0)
        each = np.diff(below, axis=1)
        each[:, 0] += on_corner[:, side]
        each[:, -1] += on_corner[:, (side + 1) % 4]
        plain &= (each <= 1).all(axis=1)  # a line between any two roots, and between a root and a corner
        before, after = last[:, side - 1], borders.sign[:, side]
        plain &= (before == after) | on_corner[:, side]
        nodes[:, 0] = (before == after) & (after < 0)
    plain &= ((borders.roots > 0) & ~((borders.roots >= 1) & np.isfinite(borders.roots))).all(axis=(1, 2))
    start, end, ambiguous = _link_crossings(negative)
    plain[ambiguous] = False
    chain, heads, length = _chain_links(start, end, m * 2 * nu * nv)
    of, ends = heads // (2 * nu * nv), np.cumsum(length)
    in_arcs = np.bincount(of, length - 1, minlength=m)
    plain &= in_arcs == np.bincount(start // (2 * nu * nv), minlength=m)  # else there are loops
    paths = _interpolate_crossings(chain, g, us, vs)
    tips = []
    for at in (ends - length, ends - 1):
        side, number, place = _locate_border_roots(chain[at] % (2 * nu * nv), of, us, vs, borders)
        paths[at] = place
        plain[of[number < 0]] = False  # a cut that starts from a corner
        tips.append([("root", *tip) for tip in zip(side.tolist(), number.tolist(), strict=True)])
    arcs: dict[int, list[Arc]] = {i: [] for i in np.flatnonzero(plain).tolist()}
    for i, path, first, last_ in zip(of.tolist(), np.split(paths, ends)[:-1], *tips, strict=True):
        if i in arcs:
            arcs[i].append(Arc(path, first, last_))
    result: list[Trace | None] = [None] * m
    for i, own in arcs.items():
        sign = 0 if own else -1 if negative[i].flat[nu * nv // 2] else 1
        result[i] = replace(EMPTY_TRACE, arcs=tuple(own), sign=sign)
    return result


def _link_crossings(negative: BoolArray) -> tuple[IntArray, IntArray, IntArray]:
    """Directed links between crossed grid edges, negative on the left, through cells with one; patches with ambiguous cells.

    Edges are numbered as in `marching`, 2 nu nv for each patch.
    """
    _, nu, nv = negative.shape
    corner = np.stack([negative[:, :-1, :-1], negative[:, 1:, :-1], negative[:, 1:, 1:], negative[:, :-1, 1:]])
    ahead = np.roll(corner, -1, axis=0)
    leaves, enters = corner & ~ahead, ~corner & ahead
    count = leaves.sum(axis=0)
    p, i, j = np.nonzero(count)
    base = 2 * nu * nv * p + i * nv + j
    number = np.stack([base, nu * nv + base + nv, base + 1, nu * nv + base])
    column = np.arange(len(p))
    start = number[leaves[:, p, i, j].argmax(axis=0), column]
    end = number[enters[:, p, i, j].argmax(axis=0), column]
    simple = count[p, i, j] == 1
    return start[simple], end[simple], np.unique(p[~simple])


def _chain_links(start: IntArray, end: IntArray, edges: int) -> tuple[IntArray, IntArray, IntArray]:
    """All open chains of links, one after the other: their crossings; the first crossing and the number of them of each."""
    follow, reached = np.full(edges, -1), np.zeros(edges, bool)
    follow[start], reached[end] = end, True
    heads = np.sort(start[~reached[start]])
    steps, at = [heads], heads
    while (at >= 0).any():
        at = np.where(at >= 0, follow[at], -1)
        steps.append(at)
    table = np.array(steps).T
    real = table >= 0
    return table[real], heads, real.sum(axis=1)


def _locate_border_roots(
    crossings: IntArray, patch: IntArray, us: Array, vs: Array, borders: _BorderTable
) -> tuple[IntArray, IntArray, Array]:
    """Of crossed border edges: the side, the number of the one root there (-1: none) and its place (n, 2)."""
    nu, nv = len(us), len(vs)
    i, j = np.divmod(crossings % (nu * nv), nv)
    along_u = crossings < nu * nv
    side = np.where(along_u, np.where(j == 0, 0, 2), np.where(i == 0, 3, 1))
    interval = np.choose(side, [i, j, nu - 2 - i, nv - 2 - j])
    lines = np.full((4, max(nu, nv)), np.inf)
    for k in range(4):
        own = side_fractions(us, vs, k)
        lines[k, : len(own)] = own
    roots = borders.roots[patch, side]
    before, after = ((roots < lines[side, interval + k, None]).sum(axis=1) for k in (0, 1))
    number = np.where(after - before == 1, before, -1)
    corners = np.array([[us[0], vs[0]], [us[-1], vs[0]], [us[-1], vs[-1]], [us[0], vs[-1]]])
    a, b = corners[side], corners[(side + 1) % 4]
    with np.errstate(invalid="ignore"):
        return side, number, a + roots[np.arange(len(roots)), number][:, None] * (b - a)


def _interpolate_crossings(crossings: IntArray, values: Array, us: Array, vs: Array) -> Array:
    """Places of crossed grid edges by linear interpolation: (n, 2)."""
    _, nu, nv = values.shape
    patch, crossings = np.divmod(crossings, 2 * nu * nv)
    i, j = np.divmod(crossings % (nu * nv), nv)
    along_u = crossings < nu * nv
    a, b = values[patch, i, j], values[patch, i + along_u, j + ~along_u]
    with np.errstate(divide="ignore", invalid="ignore"):
        f = np.clip(np.nan_to_num(a / (a - b), nan=0.5), 1e-3, 1 - 1e-3)
    u = us[i] + np.where(along_u, f, 0.0) * (us[i + along_u] - us[i])
    v = vs[j] + np.where(along_u, 0.0, f) * (vs[j + ~along_u] - vs[j])
    return np.column_stack([u, v])
