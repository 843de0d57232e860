"""The leaves of a tree of minima and maxima that matter in the cells of a grid, found by bounds on their slopes.

With the slope of a leaf bounded by L, its sign is constant in a cell if its value in the centre exceeds L times half the
diagonal. In a cell it is solid (-1), void (+1) or undecided (0), and so is each node of the tree: the minimum or maximum of these
numbers. A leaf matters where it and all nodes above it are undecided; elsewhere it changes nothing in the whole cell. Cells are
halved along the axes from a coarse grid on, and a leaf is asked again only where it still matters: the cost goes with the number
of leaves that are near each other, not with that of all.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.fields.analysis.outermost_extremes import expose_extremes, list_leaves, list_operands
from tpmscad.fields.analysis.slope_bounds import bound_slope
from tpmscad.fields.field import Field, MinMaxField

ROUND_OFF = 1e-9
"""Relative excess of the half diagonal: values are exact to a few units in the last place of the coordinates."""

FIRST_CELLS = 4
"""Cells along the longest edge of a box on the first grid."""

CELLS_AT_A_TIME = 512
"""Cells that are halved together in a search depth first."""

OCTANTS = np.array(list(product((0, 1), repeat=3)))
"""Positions (8, 3) of the halves of a cell."""


@dataclass(frozen=True, slots=True, eq=False)
class LocalLeaves:
    """The cells of a grid in which a tree is undecided, and the leaves that matter there.

    slopes: bounds on the slopes of the leaves in the grid's box. lo, size (3,): corner of the grid, edges of a cell; counts
    (3,): of cells along the axes. cells (n, 3): positions of the undecided ones. members: of each leaf, in the order of
    `list_leaves`, the rows of `cells` in which it matters, ascending. solid: boxes that are solid all over, as positions (m, 3)
    in a grid whose cells are that many times larger.
    """

    tree: Field
    leaves: tuple[Field, ...]
    slopes: tuple[float, ...]
    lo: Array
    size: Array
    counts: IntArray
    cells: IntArray
    members: tuple[IntArray, ...]
    solid: tuple[tuple[IntArray, int], ...]

    @property
    def solid_volume(self) -> float:
        """The volume of the boxes that are solid all over."""
        return float(np.prod(self.size)) * sum(len(boxes) * edge**3 for boxes, edge in self.solid)

    def is_solid(self, offsets: Array) -> BoolArray:
        """Whether points at offsets (n, k, 3), from 0 to 1 within the undecided cells, are solid: (n, k)."""
        signs = []
        for leaf, rows in zip(self.leaves, self.members, strict=True):
            points = self.lo + (self.cells[rows, None] + offsets[rows]) * self.size
            signs.append(_Signs(rows, np.where(leaf(points) < 0, -1, 1).astype(np.int8)))
        found = np.zeros(offsets.shape[:2], bool)
        combined = _combine_signs(self.tree, iter(signs), len(self.cells))
        found[combined.rows] = combined.signs < 0
        return found

    def on_grid(self) -> BoolArray:
        """Whether the centres of all cells of the grid are solid: an array of the shape `counts`."""
        found = np.zeros(tuple(self.counts), bool)
        for boxes, edge in self.solid:
            for shift in product(range(edge), repeat=3):
                found[tuple((edge * boxes + shift).T)] = True
        found[tuple(self.cells.T)] = self.is_solid(np.full((len(self.cells), 1, 3), 0.5))[:, 0]
        return found


def has_slope_bounds(field: Field, lo: Array, hi: Array) -> bool:
    """Whether the slopes of all leaves are bounded in a box."""
    return all(np.isfinite(bound_slope(leaf, lo, hi)) for leaf in list_leaves(expose_extremes(field)))


def count_first_cells(lo: Array, hi: Array) -> IntArray:
    """The cells (3,) along the axes of a box on the first grid, FIRST_CELLS along the longest one."""
    return np.ceil(FIRST_CELLS * (hi - lo) / (hi - lo).max()).astype(np.int64)


def locate_leaves(field: Field, lo: Array, hi: Array, counts: IntArray) -> LocalLeaves:
    """The leaves that matter in the cells of a grid with `counts` (3,) cells along the axes of a box."""
    tree = expose_extremes(field)
    leaves = list_leaves(tree)
    cells = np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), axis=-1).reshape(-1, 3)
    everywhere = np.arange(len(cells))
    slopes, members = tuple(bound_slope(leaf, lo, hi) for leaf in leaves), (everywhere,) * len(leaves)
    return _decide(LocalLeaves(tree, leaves, slopes, lo, (hi - lo) / counts, counts, cells, members, ()))


def halve_cells(local: LocalLeaves, selected: IntArray | None = None) -> LocalLeaves:
    """The same on a grid of twice as many cells along each axis; of the undecided cells the selected (m,) only."""
    if selected is None:
        selected = np.arange(len(local.cells))
    row_of = np.full(len(local.cells), -1)
    row_of[selected] = np.arange(len(selected))
    members = [row_of[rows] for rows in local.members]
    eight = np.arange(8)
    finer = replace(
        local,
        size=local.size / 2,
        counts=2 * local.counts,
        cells=(2 * local.cells[selected, None] + OCTANTS).reshape(-1, 3),
        members=tuple((8 * rows[rows >= 0, None] + eight).ravel() for rows in members),
        solid=tuple((boxes, 2 * edge) for boxes, edge in local.solid),
    )
    return _decide(finer)


def find_meeting_leaves(field: Field, lo: Array, hi: Array, reach: float, among: Sequence[bool]) -> Array | None:
    """The centre (3,) of a box of edges below `reach` in which two leaves matter, None if there is none in the box [lo, hi].

    One of the two is `among` those flagged, in the order of `list_leaves`. Depth first: of a tree of many crossings the first one
    is found in a fraction of the time that all would take.
    """
    waiting = [locate_leaves(field, lo, hi, count_first_cells(lo, hi))]
    while waiting:
        local = waiting.pop()
        count, flagged = np.zeros(len(local.cells), np.int64), np.zeros(len(local.cells), bool)
        for rows, flag in zip(local.members, among, strict=True):
            count[rows] += 1
            flagged[rows] |= flag
        shared = np.flatnonzero((count > 1) & flagged)
        if not len(shared):
            continue
        if local.size.max() <= reach:
            return np.asarray(local.lo + (local.cells[shared[0]] + 0.5) * local.size)
        parts = np.array_split(shared, int(np.ceil(len(shared) / CELLS_AT_A_TIME)))
        waiting += [halve_cells(local, part) for part in parts[1:]]
        waiting.append(halve_cells(local, parts[0]))
    return None


def keeps_sign(leaf: Field, lo: Array, hi: Array) -> bool:
    """Whether a leaf is proved solid all over a box, or void, by cells of a sixteenth of its edges; False if it is not."""
    local = locate_leaves(leaf, lo, hi, np.ones(3, np.int64))
    for _ in range(4):
        local = halve_cells(local)
    return not len(local.cells) and sum(len(boxes) * edge**3 for boxes, edge in local.solid) in (0, 16**3)


def _decide(local: LocalLeaves) -> LocalLeaves:
    """The cells that stay undecided, with the leaves that matter in them."""
    half_diagonal = 0.5 * float(np.linalg.norm(local.size)) * (1 + ROUND_OFF)
    signs = []
    for leaf, slope, rows in zip(local.leaves, local.slopes, local.members, strict=True):
        if np.isinf(slope):
            found = np.zeros(len(rows), np.int8)
        else:
            value = leaf(local.lo + (local.cells[rows] + 0.5) * local.size)
            found = np.where(np.abs(value) > slope * half_diagonal, np.sign(value), 0).astype(np.int8)
        signs.append(_Signs(rows, found))
    root = _combine_signs(local.tree, iter(signs), len(local.cells))
    state = np.ones(len(local.cells), np.int8)
    state[root.rows] = root.signs
    kept = np.flatnonzero(state == 0)
    row_of = np.full(len(local.cells), -1)
    row_of[kept] = np.arange(len(kept))
    members = tuple(row_of[rows] for rows in _list_mattering(root, state == 0))
    solid = (*local.solid, (local.cells[state < 0], 1))
    return replace(local, cells=local.cells[kept], members=members, solid=solid)


@dataclass(frozen=True, slots=True, eq=False)
class _Signs:
    """The signs (m, ...) of a node of the tree in the cells `rows` (m,) in which a leaf below it matters; none for leaves."""

    rows: IntArray
    signs: NDArray[np.int8]
    parts: tuple[_Signs, ...] = ()


def _combine_signs(tree: Field, leaves: Iterator[_Signs], n_cells: int) -> _Signs:
    """The signs of a tree from those of its leaves; a part without leaves that matter in a cell changes nothing there."""
    if not isinstance(tree, MinMaxField):
        return next(leaves)
    parts = tuple(_combine_signs(part, leaves, n_cells) for part in list_operands(tree))
    choose = np.maximum if tree.sign > 0 else np.minimum
    signs = np.full((n_cells, *parts[0].signs.shape[1:]), -tree.sign, np.int8)
    present = np.zeros(n_cells, bool)
    for part in parts:
        signs[part.rows] = choose(signs[part.rows], part.signs)
        present[part.rows] = True
    rows = np.flatnonzero(present)
    return _Signs(rows, signs[rows], parts)


def _list_mattering(node: _Signs, undecided: BoolArray) -> Sequence[IntArray]:
    """The rows in which each leaf below a node matters, where all nodes above are `undecided` (n,)."""
    own = node.rows[(node.signs == 0) & undecided[node.rows]]
    if not node.parts:
        return [own]
    inner = np.zeros(len(undecided), bool)
    inner[own] = True
    return [rows for part in node.parts for rows in _list_mattering(part, inner)]
