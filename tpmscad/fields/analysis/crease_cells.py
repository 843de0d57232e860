"""Cells that creases pass, found by subdivision with proof that no crease is missed.

A crease is a curve on which two surfaces of a tree vanish and the solid has an edge. Cells of an octree are excluded for a pair
of surfaces if the enclosures (`fields.tape.tape_enclosures`) of one of them, or of a combination of both, do not contain zero,
or if no edge can be there. In a cell that is left, Newton's method finds a point of both surfaces near it, with tangent t. A box
around the cell and the tangent is *simple* if all matrices of the gradients in it and t are regular (Neumaier, Interval methods
for systems of equations, 1990, chapter 5): the two surfaces and the height t . x are then coordinates in it. The directions of
the curve are enclosed, too; if it cannot leave the box before it has passed all heights of the cell, it is all that the two
surfaces have in common in the cell: one smooth graph over the height, without loops and other branches. What third surfaces do
to it must be simple, too: each is monotone along the curve, or without zero. Other cells are split, down to a size at which they
are reported as unresolved.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.fields.analysis.crease_pieces import SIDE_TOL, CellCurves, CellPairs, Graphs, Pieces
from tpmscad.fields.analysis.level_surfaces import LevelSurfaces

FIRST_CELLS = 8
"""Cells along the longest edge of the box at first."""

SMALL_CELL, LEAST_CELL = 1e-4, 1e-6
"""Half-widths, in longest edges of the box: of cells that are split if few are left, and of cells that are split no more."""

MAX_UNRESOLVED, MAX_OF_PAIR, MAX_SMALL = 50_000, 50, 4000
"""Pairs of surfaces in cells, at one level, from which on the search ends: of all, what each pair of surfaces adds, and in small
cells. Tangencies leave some hundred at every level; surfaces that coincide, or three in one curve, fill it with them."""

ANGLES = np.pi * np.arange(16) / 16
"""Combinations of two normalised surfaces that are tested for exclusion."""

MARGIN = 0.15
"""Of a cell's half-width: what a simple box has beyond the tangent, for the curve to bend in."""

BEYOND = 1.02
"""Of a cell's heights: what a curve is followed over, so that it begins and ends outside, also along an axis."""


MAX_CELLS = 500_000
"""Cells of a search, some 20 s: rough surfaces, of noisy images, leave their cells undecided from level to level. Creases are a
witness of a solid only; those of formulas take a tenth."""


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
    def curves(self) -> CellCurves:
        """Curves of the surfaces in cells of the box."""
        return CellCurves(self.surfaces, self.lo, self.hi)

    @property
    def extent(self) -> float:
        """The longest edge of the box."""
        return self.curves.extent

    @property
    def is_exhausted(self) -> bool:
        """Whether so many cells were tested that the search ends."""
        return self.cells_tested > MAX_CELLS

    def run(self, shift: Array) -> None:
        """Search in a grid that is shifted against the box by parts of a cell (3,)."""
        size = self.extent / FIRST_CELLS
        origin = self.lo - shift * size
        counts = np.ceil((self.hi - origin) / size).astype(int)
        cells = np.stack(np.meshgrid(*(np.arange(n) for n in counts), indexing="ij"), axis=-1).reshape(-1, 3)
        sides = np.zeros((len(cells), len(self.surfaces.fields)), np.int64)
        pending: tuple[IntArray, IntArray] | None = None
        level, k = 0, sides.shape[1]
        most = MAX_UNRESOLVED + MAX_OF_PAIR * k * (k - 1) // 2
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
            limit = most if size_left > SMALL_CELL else MAX_SMALL if size_left > LEAST_CELL else 0
            if len(left) > limit or self.is_exhausted:
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
            with np.errstate(over="ignore"):  # a function without bounds has no slope
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
        point, ok = self.curves.solve(items.pairs, center, None, None)
        rows = np.flatnonzero(ok & (np.linalg.norm(point - center, axis=1) < reach))
        rows, graph = self._find_graphs(items.take(rows), point[rows], rows)
        rows, graph = self._check_thirds(items.take(rows), graph, rows)
        done, pieces = self.curves.cut(items.take(rows), graph)
        if len(pieces.pairs):
            self.found.append(pieces)
        failed[rows[done]] = False
        return np.flatnonzero(failed)

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


def _invert_rows(a: Array, b: Array, c: Array) -> Array:
    """Inverses (n, 3, 3) of matrices with rows a, b, c (n, 3)."""
    columns = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=2)
    return np.asarray(columns / (a * np.cross(b, c)).sum(axis=1)[:, None, None])
