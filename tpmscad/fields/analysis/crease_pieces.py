"""Pieces of creases in cells, found by subdivision with proof that none is missed.

A crease is a curve on which two surfaces of a tree vanish and the solid has an edge. Cells of an octree are excluded for a pair
of surfaces if the enclosures (`fields.tape.tape_enclosures`) of one of them, or of a combination of both, do not contain zero,
or if no edge can be there. In a cell that is left, Newton's method finds a point of both surfaces near it, with tangent t. A box
around the cell and the tangent is *simple* if all matrices of the gradients in it and t are regular (Neumaier, Interval methods
for systems of equations, 1990, chapter 5): the two surfaces and the height t . x are then coordinates in it. The directions of
the curve are enclosed, too; if it cannot leave the box before it has passed all heights of the cell, it is all that the two
surfaces have in common in the cell: one smooth graph over the height, without loops and other branches. Cells that are not
simple are split, down to a size at which they are reported as unresolved.

Within its cell a piece is computed to round-off, and cut where it leaves the cell and where a third surface changes what is an
edge. The third surface must be monotone along the piece, or without zero; otherwise the cell is split.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.polynomial import chebyshev

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.fields.analysis.level_surfaces import LevelSurfaces

FIRST_CELLS = 8
"""Cells along the longest edge of the box at first."""

SMALL_CELL, LEAST_CELL = 1e-4, 1e-6
"""Half-widths, in longest edges of the box: of cells that are split if few are left, and of cells that are split no more."""

MAX_UNRESOLVED, MAX_SMALL = 50_000, 4000
"""Pairs of surfaces in cells, at one level, from which on the search ends, and the same for small cells. Tangencies at points
leave some hundred at every level; surfaces that coincide, or three of them in one curve, fill a plane or curve with them."""

ANGLES = np.pi * np.arange(16) / 16
"""Combinations of two normalised surfaces that are tested for exclusion."""

MARGIN = 0.15
"""Of a cell's half-width: what a simple box has beyond the tangent, for the curve to bend in."""

BEYOND = 1.02
"""Of a cell's heights: what a curve is followed over, so that it begins and ends outside, also along an axis."""

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
class Pieces:
    """Pieces of edges: pairs of surfaces (n, 2), points (n, 5, 3) from end to end, lengths (n,), what ends them (n, 2)."""

    pairs: IntArray
    points: Array
    lengths: Array
    ends: IntArray


@dataclass(slots=True, eq=False)
class PieceSearch:
    """The search in a box: its surfaces, what was found, and what was not resolved."""

    surfaces: LevelSurfaces
    lo: Array
    hi: Array
    found: list[Pieces] = field(default_factory=list)
    unresolved: list[CellPairs] = field(default_factory=list)
    cells_tested: int = 0

    @property
    def extent(self) -> float:
        """The longest edge of the box."""
        return float((self.hi - self.lo).max())

    def run(self, shift: Array) -> None:
        """Search in a grid that is shifted against the box by parts of a cell (3,)."""
        size = self.extent / FIRST_CELLS
        origin = self.lo - shift * size
        counts = np.ceil((self.hi - origin) / size).astype(int)
        cells = np.stack(np.meshgrid(*(np.arange(n) for n in counts), indexing="ij"), axis=-1).reshape(-1, 3)
        sides = np.zeros((len(cells), len(self.surfaces.fields)), np.int64)
        pending: tuple[IntArray, IntArray] | None = None
        level = 0
        while len(cells):
            step = size / 2**level
            self.cells_tested += len(cells)
            margin = SIDE_TOL * self.extent
            lo, hi = origin + cells * step, origin + (cells + 1) * step
            lo, hi = np.maximum(lo, self.lo - margin), np.minimum(hi, self.hi + margin)
            inside = (lo < hi).all(axis=1)
            left, pairs = self._exclude(lo, hi, sides, inside, pending)
            items = CellPairs(pairs, lo[left], hi[left], sides[left])
            failed = self._resolve(items)
            left, pairs, items = left[failed], pairs[failed], items.take(failed)
            size_left = 0.5 * step / self.extent
            if not self.surfaces.are_enclosed:
                size_left = 0.0  # no cell is ever excluded
            limit = MAX_UNRESOLVED if size_left > SMALL_CELL else MAX_SMALL if size_left > LEAST_CELL else 0
            if len(left) > limit:
                self.unresolved.append(items)
                break
            kept, number = np.unique(left, return_inverse=True)
            octants = np.stack(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij"), axis=-1).reshape(8, 3)
            cells = (2 * cells[kept][:, None] + octants).reshape(-1, 3)
            sides = np.repeat(sides[kept], 8, axis=0)
            pending = (8 * number[:, None] + np.arange(8)).ravel(), np.repeat(pairs, 8, axis=0)
            level += 1

    def _exclude(
        self, lo: Array, hi: Array, sides: IntArray, inside: BoolArray, pending: tuple[IntArray, IntArray] | None
    ) -> tuple[IntArray, IntArray]:
        """Cells (m,) and pairs of surfaces (m, 2) that are not excluded; signs of surfaces are entered into `sides` (n, k)."""
        n, k = sides.shape
        center, slope, remainder = np.zeros((n, k)), np.zeros((n, k, 3)), np.zeros((n, k))
        for surface in range(k):
            own = np.flatnonzero((sides[:, surface] == 0) & inside)
            if not len(own):
                continue
            form = self.surfaces.enclose_value(surface, lo[own], hi[own]).value
            center[own, surface], slope[own, surface], remainder[own, surface] = (
                form.center,
                form.slope.T,
                form.remainder,
            )
            sides[own, surface] = (form.low > 0).astype(int) - (form.high < 0)
        unknown = (sides == 0) & inside[:, None]
        if pending is None:
            first, second = np.triu_indices(k, 1)
            cell, number = np.nonzero(unknown[:, first] & unknown[:, second])
            pairs = np.stack([first[number], second[number]], axis=1)
        else:
            cell, pairs = pending
            both = unknown[cell, pairs[:, 0]] & unknown[cell, pairs[:, 1]]
            cell, pairs = cell[both], pairs[both]
        possible = self.surfaces.may_be_edge(pairs, sides[cell])[0]
        cell, pairs = cell[possible], pairs[possible]
        half = 0.5 * (hi - lo)[cell]
        scaled = []
        for own in pairs.T:
            norm = np.maximum(np.linalg.norm(slope[cell, own], axis=1), np.finfo(float).tiny)
            parts = center[cell, own] / norm, slope[cell, own] / norm[:, None], remainder[cell, own] / norm
            scaled.append(parts)
        (c0, g0, r0), (c1, g1, r1) = scaled
        excluded = np.zeros(len(cell), bool)
        with np.errstate(all="ignore"):
            for angle in ANGLES:
                a, b = np.cos(angle), np.sin(angle)
                reach = (np.abs(a * g0 + b * g1) * half).sum(axis=1) + abs(a) * r0 + abs(b) * r1
                round_off = 1e-14 * (np.abs(c0) + np.abs(c1) + (np.abs(g0) + np.abs(g1)) @ np.ones(3) * self.extent)
                excluded |= np.abs(a * c0 + b * c1) > reach + round_off
        return cell[~excluded], pairs[~excluded]

    def _resolve(self, items: CellPairs) -> IntArray:
        """Add the pieces in simple cells to those found, and return the items (m,) that are not simple."""
        n = len(items)
        if not n:
            return np.zeros(0, np.int64)
        failed = np.ones(n, bool)
        center = 0.5 * (items.lo + items.hi)
        reach = np.linalg.norm(items.hi - items.lo, axis=1)
        point, ok = self._solve(items.pairs, center, None, None)
        rows = np.flatnonzero(ok & (np.linalg.norm(point - center, axis=1) < reach))
        rows, graph = self._find_graphs(items.take(rows), point[rows], rows)
        rows, graph = self._check_thirds(items.take(rows), graph, rows)
        done, pieces = self._cut_pieces(items.take(rows), graph)
        if len(pieces.pairs):
            self.found.append(pieces)
        failed[rows[done]] = False
        return np.flatnonzero(failed)

    def _solve(self, pairs: IntArray, start: Array, row: Array | None, height: Array | None) -> tuple[Array, BoolArray]:
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

    def _find_graphs(self, items: CellPairs, point: Array, rows: IntArray) -> tuple[IntArray, Graphs]:
        """The items whose curve is proved to be one graph over all heights of the cell, and these graphs."""
        with np.errstate(all="ignore"):
            g, h = (self.surfaces.evaluate(items.pairs[:, k], point)[1] for k in (0, 1))
            g_norm, h_norm = (np.linalg.norm(v, axis=1, keepdims=True) for v in (g, h))
            n, m = g / g_norm, h / h_norm
            t = np.cross(n, m)
            t /= np.linalg.norm(t, axis=1, keepdims=True)
            middle, half = 0.5 * (items.lo + items.hi), 0.5 * (items.hi - items.lo)
            at, around = ((middle - point) * t).sum(axis=1), (half * np.abs(t)).sum(axis=1)
            heights = np.stack([at - BEYOND * around, at + BEYOND * around])
            ends = point + t * heights[..., None]
            margin = MARGIN * half.max(axis=1, keepdims=True)
            lo = np.minimum(items.lo, np.minimum(*ends) - margin)
            hi = np.maximum(items.hi, np.maximum(*ends) + margin)
            usable = np.isfinite(lo).all(axis=1) & np.isfinite(hi).all(axis=1)
            lo, hi = np.where(usable[:, None], lo, middle), np.where(usable[:, None], hi, middle)
            change = []
            smooth = usable
            for k, own, norm in ((0, g, g_norm), (1, h, h_norm)):
                low, high, is_smooth = self.surfaces.enclose(items.pairs[:, k], lo, hi)
                change.append(np.maximum(high[:, 1:] - own, own - low[:, 1:]) / norm)
                smooth = smooth & is_smooth
            inverse = _invert_rows(n, m, t)
            spread = np.abs(inverse[:, :, :1]) * change[0][:, None] + np.abs(inverse[:, :, 1:2]) * change[1][:, None]
            smooth &= spread.sum(axis=2).max(axis=1) < 1 - 1e-9
            turn = np.full_like(t, np.inf)
            own = np.flatnonzero(smooth)
            turned = spread[own] @ np.abs(t[own])[..., None]
            turn[own] = np.linalg.solve(np.eye(3) - spread[own], turned)[..., 0] * (1 + 1e-9)
            away = turn * np.abs(heights[..., None])
            stays = ((ends - away >= lo) & (ends + away <= hi)).all(axis=(0, 2)) & ((point >= lo) & (point <= hi)).all(
                axis=1
            )
        good = smooth & stays
        graphs = Graphs(point[good], t[good], turn[good], heights[:, good])
        return rows[good], graphs

    def _check_thirds(self, items: CellPairs, graph: Graphs, rows: IntArray) -> tuple[IntArray, Graphs]:
        """The items along which every third surface of unknown sign, if it matters, is monotone or does not vanish."""
        good = np.ones(len(items), bool)
        matters = ~self.surfaces.may_be_edge(items.pairs, items.sides)[1]
        ends = graph.point + graph.tangent * graph.heights[..., None]
        away = graph.turn * np.abs(graph.heights[..., None])
        lo = np.maximum(np.minimum(*(ends - away)), items.lo)
        hi = np.maximum(np.minimum(np.maximum(*(ends + away)), items.hi), lo)
        for surface in range(items.sides.shape[1]):
            third = good & matters & (items.sides[:, surface] == 0) & (items.pairs != surface).all(axis=1)
            own = np.flatnonzero(third)
            if not len(own):
                continue
            low, high, smooth = self.surfaces.enclose(np.full(len(own), surface), lo[own], hi[own])
            along = [graph.tangent[own] + s * graph.turn[own] for s in (-1, 1)]
            with np.errstate(invalid="ignore"):
                products = np.stack([slope * t for slope in (low[:, 1:], high[:, 1:]) for t in along])
            rate = products.min(axis=0).sum(axis=1), products.max(axis=0).sum(axis=1)
            decided = (low[:, 0] > 0) | (high[:, 0] < 0) | (((rate[0] > 0) | (rate[1] < 0)) & smooth)
            good[own] = decided
        return rows[good], graph.take(good)

    def _cut_pieces(self, items: CellPairs, graph: Graphs) -> tuple[BoolArray, Pieces]:
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
        ends, ok = self._solve(items.pairs[item], start, np.eye(3)[axis], level)
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
        return self._solve(items.pairs[item], start, tangent, (point * tangent).sum(axis=1) + height)

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
        point, found = self._solve(items.pairs[item], start, which, None)
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


def _invert_rows(a: Array, b: Array, c: Array) -> Array:
    """Inverses (n, 3, 3) of matrices with rows a, b, c (n, 3)."""
    columns = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=2)
    return np.asarray(columns / (a * np.cross(b, c)).sum(axis=1)[:, None, None])
