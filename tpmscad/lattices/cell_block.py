"""Choice of the patches of a block of whole cells so that its boundary is a manifold.

Any choice of one patch from each class of patches modulo the translations of the block makes up "n x m x k cells". The choice of
one cell repeated over the block has non-manifold vertices, where two parts of the block meet in a point only: the walls above
them would touch along a line, which solid modellers reject. Patches at such a vertex are therefore exchanged for their translates
on the other side of the block, one or two at a time, while the number of defects decreases (a local search).

A block may close along some axes, as a ring does: then the block repeats without end along them, translates by its length are one
patch, and nothing ends there.

Points are known by integer addresses: the number of their class modulo whole cells and the cell that they lie in.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import product

import numpy as np

from tpmscad._typing import Array, IntArray

PatchAddress = tuple[int, int, int, int]
"""A patch, side or corner of the infinite lattice: its number in the cell, then the cell."""

SNAP_STEPS_PER_CELL = 64
"""Corners and side middles are identified on a grid of this many steps per cell; they lie on one of 32 steps at most."""


@dataclass(frozen=True, slots=True, eq=False)
class PatchIncidence:
    """Incidence of the patches of the infinite lattice.

    side_ids, corner_ids (n, 4, 4): for each of the n patches of a cell, the addresses of its sides and corners.
    around[c]: the patches at corner c of cell 0.
    """

    side_ids: IntArray
    corner_ids: IntArray
    around: tuple[tuple[PatchAddress, ...], ...]


def build_incidence(side_middles: Array, corners: Array) -> PatchIncidence:
    """The incidence from the side middles and corners (n, 4, 3) of the patches of one cell, in cells."""
    side_ids, _ = _address_points(side_middles)
    corner_ids, count = _address_points(corners)
    around: list[list[PatchAddress]] = [[] for _ in range(count)]
    for patch, corners_of_patch in enumerate(corner_ids):
        for label, *cell in corners_of_patch.tolist():
            around[label].append((patch, -cell[0], -cell[1], -cell[2]))
    return PatchIncidence(side_ids, corner_ids, tuple(tuple(a) for a in around))


def _address_points(points: Array) -> tuple[IntArray, int]:
    """Addresses (n, 4, 4) of points (n, 4, 3), and the number of classes."""
    steps = np.rint(points * SNAP_STEPS_PER_CELL).astype(np.int64)
    cell, within = np.divmod(steps, SNAP_STEPS_PER_CELL)
    classes, label = np.unique(within.reshape(-1, 3), axis=0, return_inverse=True)
    return np.concatenate([label.reshape(*points.shape[:2], 1), cell], axis=2), len(classes)


@dataclass(slots=True)
class _CellBlock:
    """The chosen patches of a block, one for each class modulo the translations of the block (key: its home address).

    Around a corner of a closed block the infinite repetition looks as the block does, so fans are counted there.
    """

    incidence: PatchIncidence
    cells: tuple[int, int, int]
    closed: tuple[bool, bool, bool]
    chosen: dict[PatchAddress, PatchAddress] = field(default_factory=dict)

    def home(self, patch: PatchAddress) -> PatchAddress:
        """The translate of a patch whose cell lies in the block: the key of its class."""
        k, x, y, z = patch
        return k, x % self.cells[0], y % self.cells[1], z % self.cells[2]

    def representative(self, patch: PatchAddress) -> PatchAddress:
        """The translate of a patch along the closed axes whose cell lies between the ends of the block there."""
        k, x, y, z = (
            at if closed else own for at, own, closed in zip(self.home(patch), patch, (True, *self.closed), strict=True)
        )
        return k, x, y, z

    def is_chosen(self, patch: PatchAddress) -> bool:
        """Whether the patch, or a translate of it along the closed axes, is chosen: a search asks this half a million times."""
        k, x, y, z = patch
        nx, ny, nz = self.cells
        _, own_x, own_y, own_z = self.chosen[k, x % nx, y % ny, z % nz]
        any_x, any_y, any_z = self.closed
        return (any_x or own_x == x) and (any_y or own_y == y) and (any_z or own_z == z)

    def corners(self, patch: PatchAddress) -> list[PatchAddress]:
        return _translate_addresses(self.incidence.corner_ids[patch[0]], patch)

    def sides(self, patch: PatchAddress) -> list[PatchAddress]:
        return _translate_addresses(self.incidence.side_ids[patch[0]], patch)

    def patches_at(self, corner: PatchAddress) -> list[PatchAddress]:
        """All patches of the infinite lattice around a corner."""
        label, x, y, z = corner
        return [(k, a + x, b + y, c + z) for k, a, b, c in self.incidence.around[label]]

    def count_fans(self, corner: PatchAddress) -> int:
        """Number of fans of chosen patches around a corner, each connected by sides that end there; 1 at a manifold vertex."""
        fans: list[set[PatchAddress]] = []
        for patch in self.patches_at(corner):
            if self.is_chosen(patch):
                corners, sides = self.corners(patch), self.sides(patch)
                i = corners.index(corner)
                incident = {sides[i], sides[i - 1]}  # the sides that start and end in corner i
                joined = [fan for fan in fans if fan & incident]
                fans = [fan for fan in fans if not fan & incident]
                fans.append(incident.union(*joined))
        return len(fans)

    def count_defects(self, corners: set[PatchAddress]) -> int:
        """Surplus fans at these corners, and isolated chosen patches around them."""
        surplus = sum(max(self.count_fans(corner) - 1, 0) for corner in corners)
        chosen = {patch for corner in corners for patch in self.patches_at(corner) if self.is_chosen(patch)}
        return surplus + sum(self.is_isolated(patch) for patch in chosen)

    def is_isolated(self, patch: PatchAddress) -> bool:
        """Whether a patch shares no side with another chosen one."""
        sides = set(self.sides(patch))
        return not any(
            sides & set(self.sides(other))
            for corner in self.corners(patch)
            for other in self.patches_at(corner)
            if other != patch and self.is_chosen(other)
        )

    def exchange(self, patch: PatchAddress) -> int:
        """Choose `patch` in place of the chosen one of its class; returns the change in the number of defects."""
        home = self.home(patch)
        affected = set(self.corners(patch)) | set(self.corners(self.chosen[home]))
        before = self.count_defects(affected)
        self.chosen[home] = self.representative(patch)
        return self.count_defects(affected) - before


def _translate_addresses(ids: IntArray, patch: PatchAddress) -> list[PatchAddress]:
    _, x, y, z = patch
    return [(label, a + x, b + y, c + z) for label, a, b, c in ids.tolist()]


def choose_manifold_block(
    incidence: PatchIncidence, cells: tuple[int, int, int], closed: tuple[bool, bool, bool] = (False, False, False)
) -> list[PatchAddress]:
    """The patches of a block of cells without non-manifold vertices, in the order of their classes.

    Along a `closed` axis the block meets itself.
    """
    block = _CellBlock(incidence, cells, closed)
    for k in range(len(incidence.side_ids)):
        for x, y, z in np.ndindex(*cells):
            block.chosen[k, x, y, z] = (k, x, y, z)
    pinched = {c for patch in block.chosen.values() for c in block.corners(patch)}
    pinched = {c for c in pinched if block.count_fans(c) > 1}
    while pinched:
        corner = min(pinched)
        pinched.remove(corner)
        touched = _remove_pinch(block, corner, depth=1) or _remove_pinch(block, corner, depth=2)
        pinched |= {c for c in touched if block.count_fans(c) > 1}
    return list(block.chosen.values())


def _remove_pinch(block: _CellBlock, corner: PatchAddress, depth: int, allowed_increase: int = 0) -> set[PatchAddress]:
    """Make the first sequence of at most `depth` exchanges that leaves fewer defects than before; the corners it touches.

    `allowed_increase` is the number of defects that earlier exchanges of the sequence have added. Without such a sequence the
    block is left as it was and the result is empty.
    """
    for candidate in _candidate_exchanges(block, corner):
        home = block.home(candidate)
        present = block.chosen[home]
        touched = set(block.corners(candidate)) | set(block.corners(present))
        change = allowed_increase + block.exchange(candidate)
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
    """Patches to choose instead of their translates: those absent at the corner, then translates of those present there."""
    around = block.patches_at(corner)
    absent = [p for p in around if not block.is_chosen(p)]
    nx, ny, nz = block.cells
    steps = [(0,) if closed else (-1, 0, 1) for closed in block.closed]
    translates = [
        (k, x + i * nx, y + j * ny, z + m * nz)
        for k, x, y, z in around
        if block.is_chosen((k, x, y, z))
        for i, j, m in product(*steps)
    ]
    return absent + [p for p in translates if not block.is_chosen(p)]
