"""Whole cells whose border touches itself nowhere.

Any choice of one patch for each class of patches modulo the block's translations makes "cells[0] x cells[1] x cells[2] cells".
Tiling one cell's choice leaves vertices where two parts of the block meet in a point: the walls above them would touch along a
line, which no solid modeller takes for a solid. Patches at such a vertex are exchanged for their copies on the other side of the
block, one at a time, as long as the number of pinched vertices falls.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from tpmscad._typing import Array, IntArray

PatchAddress = tuple[int, int, int, int]
"""A patch of the infinite lattice: its number in the cell, and the cell."""


@dataclass(frozen=True, slots=True, eq=False)
class PatchIncidence:
    """How the patches of the infinite lattice meet.

    side_ids, corner_ids (n, 4, 4): for each of the cell's n patches and each side or corner, the number of the class of sides
    or corners modulo whole cells, then the cell it lies in. `around[c]` are the patches at corner class c of cell 0.
    """

    side_ids: IntArray
    corner_ids: IntArray
    around: tuple[tuple[PatchAddress, ...], ...]


def build_incidence(side_middles: Array, corners: Array) -> PatchIncidence:
    """From the side middles and corners (n, 4, 3) of one cell's patches, in cells."""
    side_ids, _ = _label_modulo_cells(side_middles)
    corner_ids, count = _label_modulo_cells(corners)
    around: list[list[PatchAddress]] = [[] for _ in range(count)]
    for patch, own in enumerate(corner_ids):
        for label, *cell in own.tolist():
            around[label].append((patch, -cell[0], -cell[1], -cell[2]))
    return PatchIncidence(side_ids, corner_ids, tuple(tuple(a) for a in around))


def _label_modulo_cells(points: Array) -> tuple[IntArray, int]:
    """Label modulo whole cells and the cell, for points (n, 4, 3): (n, 4, 4)."""
    grains = np.rint(points * SNAP_STEPS_PER_CELL).astype(np.int64)
    cell, within = np.divmod(grains, SNAP_STEPS_PER_CELL)
    found, label = np.unique(within.reshape(-1, 3), axis=0, return_inverse=True)
    return np.concatenate([label.reshape(*points.shape[:2], 1), cell], axis=2), len(found)


SNAP_STEPS_PER_CELL = 64
"""Corners and side middles of the patches are told apart on a grid of 1/64 of the cell; they lie on one of 1/32 at most."""


@dataclass(slots=True)
class _CellBlock:
    """The chosen patches of a block, one per class modulo the block's translations."""

    incidence: PatchIncidence
    cells: tuple[int, int, int]
    chosen: dict[PatchAddress, PatchAddress] = field(default_factory=dict)  # class -> where its patch stands

    def home(self, patch: PatchAddress) -> PatchAddress:
        k, x, y, z = patch
        return k, x % self.cells[0], y % self.cells[1], z % self.cells[2]

    def has(self, patch: PatchAddress) -> bool:
        return self.chosen[self.home(patch)] == patch

    def corners(self, patch: PatchAddress) -> list[PatchAddress]:
        return _translate_addresses(self.incidence.corner_ids[patch[0]], patch)

    def sides(self, patch: PatchAddress) -> list[PatchAddress]:
        return _translate_addresses(self.incidence.side_ids[patch[0]], patch)

    def at(self, corner: PatchAddress) -> list[PatchAddress]:
        """All patches of the infinite lattice around a corner."""
        label, x, y, z = corner
        return [(k, a + x, b + y, c + z) for k, a, b, c in self.incidence.around[label]]

    def fans(self, corner: PatchAddress) -> int:
        """Groups of chosen patches around a corner that hang together by sides ending there."""
        groups: list[set[PatchAddress]] = []
        for patch in self.at(corner):
            if self.has(patch):
                corners, sides = self.corners(patch), self.sides(patch)
                i = corners.index(corner)
                own = {sides[i], sides[i - 1]}  # the sides that start and end in corner i
                joined = [g for g in groups if g & own]
                groups = [g for g in groups if not g & own]
                groups.append(own.union(*joined))
        return len(groups)

    def flaws(self, corners: set[PatchAddress]) -> int:
        """Pinches at these corners, and chosen patches around them that share no side with another chosen one."""
        pinches = sum(max(self.fans(corner) - 1, 0) for corner in corners)
        chosen = {patch for corner in corners for patch in self.at(corner) if self.has(patch)}
        return pinches + sum(self.lonely(patch) for patch in chosen)

    def lonely(self, patch: PatchAddress) -> bool:
        own = set(self.sides(patch))
        return not any(
            own & set(self.sides(other))
            for corner in self.corners(patch)
            for other in self.at(corner)
            if other != patch and self.has(other)
        )

    def exchanged(self, patch: PatchAddress) -> int:
        """Choose `patch` instead of its class's present one; the change in flaws."""
        home = self.home(patch)
        affected = set(self.corners(patch)) | set(self.corners(self.chosen[home]))
        before = self.flaws(affected)
        self.chosen[home] = patch
        return self.flaws(affected) - before


def _translate_addresses(ids: IntArray, patch: PatchAddress) -> list[PatchAddress]:
    _, x, y, z = patch
    return [(label, a + x, b + y, c + z) for label, a, b, c in ids.tolist()]


def choose_unpinched_patches(incidence: PatchIncidence, cells: tuple[int, int, int]) -> list[PatchAddress]:
    """The patches of a block of cells, tiled from one cell's and exchanged until no corner is pinched; in order of class."""
    block = _CellBlock(incidence, cells)
    for k in range(len(incidence.side_ids)):
        for x, y, z in np.ndindex(*cells):
            block.chosen[k, x, y, z] = (k, x, y, z)
    todo = {c for patch in block.chosen.values() for c in block.corners(patch)}
    todo = {c for c in todo if block.fans(c) > 1}
    while todo:
        corner = min(todo)
        todo.remove(corner)
        touched = _remove_pinch(block, corner, depth=1) or _remove_pinch(block, corner, depth=2)
        todo |= {c for c in touched if block.fans(c) > 1}
    return list(block.chosen.values())


def _remove_pinch(block: _CellBlock, corner: PatchAddress, depth: int, debt: int = 0) -> set[PatchAddress]:
    """Make the first exchanges, at most `depth`, that repay `debt` and remove a flaw besides; the corners they touch.

    Nothing is touched where there are none.
    """
    for move in _candidate_exchanges(block, corner):
        home = block.home(move)
        present = block.chosen[home]
        touched = set(block.corners(move)) | set(block.corners(present))
        change = debt + block.exchanged(move)
        if change < 0:
            return touched
        if depth > 1 and change <= 1:
            for next_corner in sorted(touched | {corner}):
                further = _remove_pinch(block, next_corner, depth - 1, change)
                if further:
                    return touched | further
        block.chosen[home] = present
    return set()


def _candidate_exchanges(block: _CellBlock, corner: PatchAddress) -> list[PatchAddress]:
    """Exchanges that may mend a corner: first to bring an absent patch there, then to take a present one away."""
    around = block.at(corner)
    bring = [p for p in around if not block.has(p)]
    away = [
        (p[0], p[1] + x * block.cells[0], p[2] + y * block.cells[1], p[3] + z * block.cells[2])
        for p in around
        if block.has(p)
        for x, y, z in np.ndindex(3, 3, 3)
    ]
    shift = [(k, x - block.cells[0], y - block.cells[1], z - block.cells[2]) for k, x, y, z in away]
    return bring + [p for p in shift if not block.has(p)]
