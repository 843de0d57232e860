"""Curves of two surfaces in cells in which they are known to be graphs: points to round-off, and the pieces that are edges.

A piece is cut where the curve leaves its cell and where a third surface vanishes. Neighbouring cells compute a point in their
common side from the same equations.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.polynomial import chebyshev

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.fields.analysis.level_surfaces import LevelSurfaces

NEWTON_STEPS, NEWTON_TOL = 12, 1e-11
"""Steps of Newton's method, and the last step, in longest edges of the box, at which a point is found."""

N_NODES = 7
"""Chebyshev nodes of a piece's interpolant in its height, which gives starting points for Newton's method only."""

N_FINE = 49
"""Heights at which a piece is looked at for the sides of its cell."""

SIDE_TOL = 1e-9
"""In longest edges of the box: distance from its sides within which a crease belongs to it."""

LOBATTO = np.array([-1.0, -np.sqrt(3 / 7), 0.0, np.sqrt(3 / 7), 1.0])
LOBATTO_WEIGHTS = np.array([0.1, 49 / 90, 32 / 45, 49 / 90, 0.1])
"""Nodes and weights of the quadrature of lengths, exact for polynomials of degree seven."""

FACE, SIDE, CUT = 0, 1, 2
"""What ends a piece: a side of its cell, a side of the box, or a third surface, numbered from CUT on."""


@dataclass(frozen=True, slots=True, eq=False)
class CellPairs:
    """Pairs of surfaces (n, 2) and cells: corners lo, hi (n, 3), and the known signs of all surfaces (n, k)."""

    pairs: IntArray
    lo: Array
    hi: Array
    sides: IntArray

    def take(self, rows: Any) -> CellPairs:
        """Some of them."""
        return CellPairs(self.pairs[rows], self.lo[rows], self.hi[rows], self.sides[rows])

    def __len__(self) -> int:
        return len(self.pairs)


@dataclass(frozen=True, slots=True, eq=False)
class Graphs:
    """Curves as graphs over the height along a tangent.

    point, tangent (n, 3): of the curve. turn (n, 3): bounds of the differences of directions, of height 1, from the tangent.
    heights (2, n): of the cell above the point.
    """

    point: Array
    tangent: Array
    turn: Array
    heights: Array

    def take(self, rows: BoolArray) -> Graphs:
        """Some of them."""
        return Graphs(self.point[rows], self.tangent[rows], self.turn[rows], self.heights[:, rows])


@dataclass(frozen=True, slots=True, eq=False)
class Pieces:
    """Pieces of edges: pairs of surfaces (n, 2), points (n, 5, 3) from end to end, lengths (n,), what ends them (n, 2)."""

    pairs: IntArray
    points: Array
    lengths: Array
    ends: IntArray


@dataclass(frozen=True, slots=True, eq=False)
class CellCurves:
    """Curves of pairs of surfaces in cells of the box [lo, hi]."""

    surfaces: LevelSurfaces
    lo: Array
    hi: Array

    @property
    def extent(self) -> float:
        """The longest edge of the box."""
        return float((self.hi - self.lo).max())

    def solve(self, pairs: IntArray, start: Array, row: Array | None, height: Array | None) -> tuple[Array, BoolArray]:
        """Points (n, 3) of two surfaces at which row . x = height, or near the start for no row, and whether they were found.

        Rows (n,) of surfaces, instead of (n, 3), are third surfaces that vanish.
        """
        points, last = start.copy(), np.full(len(start), np.inf)
        for _ in range(NEWTON_STEPS):
            active = np.flatnonzero(~(last <= NEWTON_TOL * self.extent) & np.isfinite(points).all(axis=1))
            if not len(active):
                break
            x = points[active]
            f, g = self.surfaces.evaluate(pairs[active, 0], x)
            h, k = self.surfaces.evaluate(pairs[active, 1], x)
            if row is None:
                third, rest = np.cross(g, k), np.zeros(len(x))
            elif row.ndim == 1:
                rest, third = self.surfaces.evaluate(row[active].astype(np.int64), x)
            else:
                assert height is not None
                third, rest = row[active], (row[active] * x).sum(axis=1) - height[active]
            with np.errstate(all="ignore"):
                step = _solve_rows(g, k, third, f, h, rest)
            # no further than the box is long
            size = np.linalg.norm(step, axis=1)
            points[active] = x - step * np.minimum(1.0, 0.5 * self.extent / np.maximum(size, 1e-300))[:, None]
            last[active] = size
        return points, np.asarray(last <= NEWTON_TOL * self.extent)

    def cut(self, items: CellPairs, graph: Graphs) -> tuple[BoolArray, Pieces]:
        """Pieces of the graphs within their cells and between third surfaces; False for items of which a point was not found."""
        n = len(items)
        empty = Pieces(np.zeros((0, 2), np.int64), np.zeros((0, 5, 3)), np.zeros(0), np.zeros((0, 2), np.int64))
        if not n:
            return np.zeros(0, bool), empty
        nodes = -np.cos(np.pi * (np.arange(N_NODES) + 0.5) / N_NODES)
        heights = 0.5 * (graph.heights[0] + graph.heights[1]), 0.5 * (graph.heights[1] - graph.heights[0])
        at = heights[0][:, None] + heights[1][:, None] * nodes
        points, ok = self._at_heights(np.repeat(np.arange(n), N_NODES), at.ravel(), items, graph, None)
        done = np.asarray(ok.reshape(n, N_NODES).all(axis=1))
        inverse = np.asarray(np.linalg.inv(chebyshev.chebvander(nodes, N_NODES - 1)), float)
        curve = np.einsum("kj,njd->nkd", inverse, np.where(done[:, None, None], points.reshape(n, N_NODES, 3), 0.0))
        fine = np.linspace(-1, 1, N_FINE)
        path = np.einsum("fk,nkd->nfd", chebyshev.chebvander(fine, N_NODES - 1), curve)
        # a curve enters and leaves by crossings of the planes of the six faces, in the order of their heights
        faces = np.concatenate([items.lo, items.hi], axis=1)
        beyond = np.concatenate([path - items.lo[:, None], items.hi[:, None] - path], axis=2) < 0
        item, place, plane = np.nonzero((beyond[:, 1:] != beyond[:, :-1]) & done[:, None, None])
        axis, before, after = plane % 3, path[item, place], path[item, place + 1]
        rows, level = np.arange(len(item)), faces[item, plane]
        first, last = before[rows, axis] - level, after[rows, axis] - level
        start = before + np.clip(first / (first - last), 0, 1)[:, None] * (after - before)
        ends, ok = self.solve(items.pairs[item], start, np.eye(3)[axis], level)
        height = ((ends - graph.point[item]) * graph.tangent[item]).sum(axis=1)
        step = heights[1][item] * (fine[1] - fine[0])
        ok &= np.abs(height - (heights[0][item] + heights[1][item] * 0.5 * (fine[place] + fine[place + 1]))) <= 2 * step
        done[item[~ok]] = False
        order = np.lexsort([height, item])
        item, height, ends, plane, axis = item[order], height[order], ends[order], plane[order], axis[order]
        # how many planes the curve is beyond after each crossing: it is in the cell where that is none
        number = beyond[:, 0].sum(axis=1)[item] + _sum_crossings(item, plane, beyond[:, 0])
        inside = np.flatnonzero((number[:-1] == 0) & (item[:-1] == item[1:]))
        tol = 2 * SIDE_TOL * self.extent
        at = ends[np.arange(len(item)), axis]
        in_side = (np.abs(at - self.lo[axis]) <= tol) | (np.abs(at - self.hi[axis]) <= tol)
        kind = np.where(in_side, SIDE, FACE)
        inside = inside[done[item[inside]]]
        both = np.stack([inside, inside + 1], axis=1)
        return self._cut_by_thirds(items, graph, done, item[inside], height[both], ends[both], kind[both])

    def _at_heights(
        self, item: IntArray, height: Array, items: CellPairs, graph: Graphs, start: Array | None
    ) -> tuple[Array, BoolArray]:
        """Points (m, 3) of graphs at heights (m,) above their points, and whether they were found."""
        point, tangent = graph.point[item], graph.tangent[item]
        if start is None:
            start = point + tangent * height[:, None]
        return self.solve(items.pairs[item], start, tangent, (point * tangent).sum(axis=1) + height)

    def _cut_by_thirds(
        self,
        items: CellPairs,
        graph: Graphs,
        done: BoolArray,
        item: IntArray,
        heights: Array,
        ends: Array,
        kinds: IntArray,
    ) -> tuple[BoolArray, Pieces]:
        """Parts of pieces (m,) between third surfaces, where they are edges."""
        breaks = [(item, heights[:, k], ends[:, k], kinds[:, k]) for k in (0, 1)]
        sides = items.sides[item].copy()
        matters = ~self.surfaces.may_be_edge(items.pairs[item], sides)[1]
        piece = np.arange(len(item))
        found = [(piece, *b[1:]) for b in breaks]
        thirds = []
        for surface in range(sides.shape[1]):
            own = np.flatnonzero(matters & (sides[:, surface] == 0) & (items.pairs[item] != surface).all(axis=1))
            if not len(own):
                continue
            first, last = (self.surfaces.evaluate(np.full(len(own), surface), ends[own, k])[0] for k in (0, 1))
            crossed = (first > 0) != (last > 0)
            thirds.append((surface, own))
            cut, f0, f1 = own[crossed], first[crossed], last[crossed]
            if not len(cut):
                continue
            height, point, ok = self._find_zero(surface, item[cut], heights[cut], ends[cut], f0, f1, items, graph)
            done[item[cut[~ok]]] = False
            found.append((cut, height, point, np.full(len(cut), CUT + surface)))
        owner, height, point, kind = (np.concatenate([f[k] for f in found]) for k in range(4))
        order = np.lexsort([height, owner])
        owner, height, point, kind = owner[order], height[order], point[order], kind[order]
        next_same = np.flatnonzero(owner[:-1] == owner[1:])
        own, a, b = owner[next_same], height[next_same], height[next_same + 1]
        ok = done[item[own]]
        next_same, own, a, b = next_same[ok], own[ok], a[ok], b[ok]
        members = item[own]
        at = 0.5 * (a + b)[:, None] + 0.5 * (b - a)[:, None] * LOBATTO
        points = np.empty((len(own), 5, 3))
        points[:, 0], points[:, 4] = point[next_same], point[next_same + 1]
        part = (at[:, 1:4] - a[:, None]) / np.maximum(b - a, 1e-300)[:, None]
        start = points[:, :1] + part[..., None] * (points[:, 4:] - points[:, :1])
        inner, ok = self._at_heights(np.repeat(members, 3), at[:, 1:4].ravel(), items, graph, start.reshape(-1, 3))
        points[:, 1:4] = inner.reshape(-1, 3, 3)
        done[members[~ok.reshape(-1, 3).all(axis=1)]] = False
        signs = sides[own]
        for surface, _ in thirds:
            unknown = np.flatnonzero(signs[:, surface] == 0)
            values = self.surfaces.evaluate(np.full(len(unknown), surface), points[unknown, 2])[0]
            signs[unknown, surface] = np.where(values > 0, 1, -1)
        for k in (0, 1):
            signs[np.arange(len(own)), items.pairs[members, k]] = 0
        # what else is unknown does not matter
        ends_of = np.stack([kind[next_same], kind[next_same + 1]], axis=1)
        active = self.surfaces.may_be_edge(items.pairs[members], signs)[0] & done[members] & (b > a)
        points, members = points[active], members[active]
        lengths = self._measure(items.pairs[members], points, graph.tangent[members], (b - a)[active])
        return done, Pieces(items.pairs[members], points, lengths, ends_of[active])

    def _find_zero(
        self,
        surface: int,
        item: IntArray,
        heights: Array,
        ends: Array,
        first: Array,
        last: Array,
        items: CellPairs,
        graph: Graphs,
    ) -> tuple[Array, Array, BoolArray]:
        """Where a third surface vanishes on pieces between their ends: heights (m,), points (m, 3), whether found."""
        low, high = heights[:, 0].copy(), heights[:, 1].copy()
        f0, f1, p0, p1 = first.copy(), last.copy(), ends[:, 0].copy(), ends[:, 1].copy()
        which = np.full(len(item), surface)
        ok = np.ones(len(item), bool)
        for step in range(6):
            # false position, with a bisection now and then
            part = np.full(len(item), 0.5) if step % 3 == 2 else np.clip(f0 / (f0 - f1), 0.02, 0.98)
            at = low + part * (high - low)
            point, found = self._at_heights(item, at, items, graph, p0 + part[:, None] * (p1 - p0))
            ok &= found
            value = self.surfaces.evaluate(which, point)[0]
            before = (value > 0) == (f0 > 0)
            low, f0, p0 = np.where(before, at, low), np.where(before, value, f0), np.where(before[:, None], point, p0)
            high, f1, p1 = np.where(before, high, at), np.where(before, f1, value), np.where(before[:, None], p1, point)
        part = np.clip(f0 / (f0 - f1), 0, 1)
        start = p0 + part[:, None] * (p1 - p0)
        point, found = self.solve(items.pairs[item], start, which, None)
        tol = SIDE_TOL * self.extent
        height = ((point - graph.point[item]) * graph.tangent[item]).sum(axis=1)
        ok &= found & (height >= low - tol) & (height <= high + tol)
        return np.clip(height, heights[:, 0], heights[:, 1]), point, ok

    def _measure(self, pairs: IntArray, points: Array, tangent: Array, height: Array) -> Array:
        """Lengths (n,) of pieces between two heights that are this far apart."""
        flat = points.reshape(-1, 3)
        g, h = (self.surfaces.evaluate(np.repeat(pairs[:, k], 5), flat)[1] for k in (0, 1))
        along = np.cross(g, h)
        rate = np.linalg.norm(along, axis=1) / np.abs((along * np.repeat(tangent, 5, axis=0)).sum(axis=1))
        return np.asarray(0.5 * height * (rate.reshape(-1, 5) @ LOBATTO_WEIGHTS))


def _sum_crossings(item: IntArray, plane: IntArray, beyond: BoolArray) -> IntArray:
    """The change (m,), after each crossing of an item, of the number of planes (six an item) that the curve is beyond.

    Crossings are in order; `beyond` (n, 6) says where it begins, and a crossing of a plane takes it to its other side.
    """
    code = 6 * item + plane
    order = np.argsort(code, kind="stable")
    first = np.searchsorted(code[order], code[order])
    again = np.empty(len(code), np.int64)
    again[order] = np.arange(len(code)) - first
    change = np.where(beyond[item, plane] ^ (again % 2 == 1), -1, 1)
    total = np.cumsum(change)
    begin = np.searchsorted(item, item)
    return np.asarray(total - (total - change)[begin] if len(item) else total)


def _solve_rows(a: Array, b: Array, c: Array, f: Array, g: Array, h: Array) -> Array:
    """Solutions (n, 3) of systems with rows a, b, c (n, 3) and right-hand sides f, g, h (n,); not a number if singular."""
    first, second, third = np.cross(b, c), np.cross(c, a), np.cross(a, b)
    determinant = (a * first).sum(axis=1)
    return np.asarray((f[:, None] * first + g[:, None] * second + h[:, None] * third) / determinant[:, None])
