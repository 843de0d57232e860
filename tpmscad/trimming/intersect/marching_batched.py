"""Batched marching of the simple cases: patches on whose uniform grid no branch is hidden and no further line is needed.

Most patches are simple. The others have a critical point near zero, crowded roots on a side, a side in the surface, or a closed
or ambiguous branch; they are marched one by one by `marching.march_patch`, which does the same on a refined grid.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.splines.basis import design_matrix
from tpmscad.splines.bspline import BSplineSurface
from tpmscad.trimming.intersect.critical_points import detect_critical_points
from tpmscad.trimming.intersect.marching import EMPTY_TRACE, Arc, Trace, interpolate_crossings, link_cells, march_patch
from tpmscad.trimming.intersect.patch_borders import CELLS_U, CELLS_V, BorderSide, grid_corners, side_fractions
from tpmscad.trimming.operands.quadric_table import QuadricTable

PATCHES_PER_BATCH = 32
"""Patches per batch: their grids fit in the processor's cache."""


def march_patches(
    patches: Sequence[BSplineSurface],
    implicit: QuadricTable,
    borders: Sequence[tuple[BorderSide, ...]],
    on_corner: BoolArray,
    zero_tol: float,
) -> list[Trace]:
    """The traces of n pairs of a patch and an implicit surface, as by `march_patch`; on_corner (n, 4)."""
    traces: list[Trace | None] = [None] * len(patches)
    groups: dict[tuple[int, bool], list[int]] = {}
    for i, (patch, is_plane) in enumerate(zip(patches, implicit.is_plane.tolist(), strict=True)):
        groups.setdefault((id(patch), is_plane), []).append(i)
    for (_, is_plane), members in groups.items():
        at, patch = np.array(members), patches[members[0]]
        if is_plane:
            at = at[~_skip_missed_patches(patch, implicit.take(at), on_corner[at], at, traces)]
        grid = _build_grid(patch)
        for rows in np.array_split(at, -(-len(at) // PATCHES_PER_BATCH)) if len(at) else ():
            table = _tabulate_borders([borders[i] for i in rows])
            made = _march_simple_patches(grid, implicit.take(rows), table, on_corner[rows])
            for i, trace in zip(rows.tolist(), made, strict=True):
                traces[i] = trace
    return [
        march_patch(patches[i], implicit.row(i), borders[i], on_corner[i], zero_tol) if trace is None else trace
        for i, trace in enumerate(traces)
    ]


def _skip_missed_patches(
    patch: BSplineSurface, planes: QuadricTable, on_corner: BoolArray, at: IntArray, traces: list[Trace | None]
) -> BoolArray:
    """The planes that miss the convex hull of the patch's poles (m,); their traces are entered in `traces` at `at`."""
    values = patch.poles.reshape(-1, 3) @ planes.axis.T + planes.parameter_a
    above = np.asarray((values > 0).all(axis=0))
    result: BoolArray = np.asarray((above | (values < 0).all(axis=0)) & ~on_corner.any(axis=1))
    for k in np.flatnonzero(result).tolist():
        traces[at[k]] = replace(EMPTY_TRACE, sign=1 if above[k] else -1)
    return result


@dataclass(frozen=True, slots=True, eq=False)
class _MarchingGrid:
    """The uniform grid lines of a patch, its bases on them, and its points and derivatives (nu nv, 3)."""

    patch: BSplineSurface
    us: Array
    vs: Array
    bases: tuple[Array, Array, Array, Array]
    jet: tuple[Array, Array, Array]

    def evaluate_distances(self, implicit: QuadricTable) -> tuple[Array, Array, Array]:
        """The distances from m surfaces, all planes or none, and their derivatives by u and by v: (m, nu, nv) each."""
        shape = len(implicit), len(self.us), len(self.vs)
        if implicit.is_plane.all():
            poles = np.einsum("uvk,mk->muv", self.patch.poles, implicit.axis) + implicit.parameter_a[:, None, None]
            u, v, du, dv = self.bases
            return u @ poles @ v.T, du @ poles @ v.T, u @ poles @ dv.T
        points, along_u, along_v = self.jet
        g, gradient = implicit.jet(np.broadcast_to(points, (len(implicit), *points.shape)), 1)
        by_u, by_v = (np.einsum("mnk,nk->mn", gradient, along) for along in (along_u, along_v))
        return g.reshape(shape), by_u.reshape(shape), by_v.reshape(shape)


def _build_grid(patch: BSplineSurface) -> _MarchingGrid:
    us = np.linspace(*patch.domain[0], CELLS_U + 1)
    vs = np.linspace(*patch.domain[1], CELLS_V + 1)
    u, du = (design_matrix(patch.knots_u, patch.degree_u, us, order) for order in (0, 1))
    v, dv = (design_matrix(patch.knots_v, patch.degree_v, vs, order) for order in (0, 1))
    jet = tuple(patch.grid(us, vs, *d).reshape(-1, 3) for d in ((0, 0), (1, 0), (0, 1)))
    return _MarchingGrid(patch, us, vs, (u, v, du, dv), (jet[0], jet[1], jet[2]))


@dataclass(frozen=True, slots=True, eq=False)
class _BorderTable:
    """The borders of m patches: initial signs and numbers of roots (m, 4), and roots padded by infinity (m, 4, r)."""

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
    grid: _MarchingGrid, implicit: QuadricTable, borders: _BorderTable, on_corner: BoolArray
) -> list[Trace | None]:
    """The traces of the simple ones of m patches, None for the others."""
    g, gu, gv = grid.evaluate_distances(implicit)
    us, vs = grid.us, grid.vs
    m, nu, nv = g.shape
    simple = ~detect_critical_points(grid.patch, implicit, g, gu, gv, us, vs) & (borders.sign != 0).all(axis=1)
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
        simple &= (each <= 1).all(axis=1)  # a grid line between any two roots, and between a root and a corner
        before, after = last[:, side - 1], borders.sign[:, side]
        simple &= (before == after) | on_corner[:, side]
        nodes[:, 0] = (before == after) & (after < 0)
    simple &= ((borders.roots > 0) & ~((borders.roots >= 1) & np.isfinite(borders.roots))).all(axis=(1, 2))
    start, end, ambiguous = link_cells(negative)
    simple[ambiguous[:, 0]] = False
    chain, heads, length = _chain_links(start, end, m * 2 * nu * nv)
    owner, ends = heads // (2 * nu * nv), np.cumsum(length)
    in_arcs = np.bincount(owner, length - 1, minlength=m)
    simple &= in_arcs == np.bincount(start // (2 * nu * nv), minlength=m)  # else there are closed branches
    paths = interpolate_crossings(chain, g, us, vs)
    tips = []
    for at in (ends - length, ends - 1):
        side, number, place = _locate_border_roots(chain[at] % (2 * nu * nv), owner, us, vs, borders)
        paths[at] = place
        simple[owner[number < 0]] = False  # an arc that starts at a corner
        tips.append([("root", *tip) for tip in zip(side.tolist(), number.tolist(), strict=True)])
    arcs: dict[int, list[Arc]] = {i: [] for i in np.flatnonzero(simple).tolist()}
    for i, path, first_end, last_end in zip(owner.tolist(), np.split(paths, ends)[:-1], *tips, strict=True):
        if i in arcs:
            arcs[i].append(Arc(path, first_end, last_end))
    result: list[Trace | None] = [None] * m
    for i, own in arcs.items():
        sign = 0 if own else -1 if negative[i].flat[nu * nv // 2] else 1
        result[i] = replace(EMPTY_TRACE, arcs=tuple(own), sign=sign)
    return result


def _chain_links(start: IntArray, end: IntArray, edges: int) -> tuple[IntArray, IntArray, IntArray]:
    """The crossings of all open chains of links, chain by chain; the first crossing of each chain, and its length."""
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
    """For crossed border edges: the side, the number of the one root there (-1: none), and its (u, v) (n, 2)."""
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
    corners = grid_corners(us, vs)
    a, b = corners[side], corners[(side + 1) % 4]
    with np.errstate(invalid="ignore"):
        return side, number, a + roots[np.arange(len(roots)), number][:, None] * (b - a)
