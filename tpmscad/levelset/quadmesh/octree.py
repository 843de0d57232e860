"""Octree over a box, 2:1 balanced across faces, edges and corners, with its leaves numbered on the finest grid.

Positions are integers in units of the finest cell. A leaf of size s, a power of two, covers s finest cells along each axis, and
starts at a multiple of s. It therefore covers a range of Morton codes without gaps (Morton, "A computer oriented geodetic data
base", 1966): the leaf that contains a cell is the last one, in the order of the codes, that does not start after the cell.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray

CHILD_OFFSETS = np.array(list(product((0, 1), repeat=3)))
MORTON_STEPS = (
    (32, 0x1F00000000FFFF), (16, 0x1F0000FF0000FF), (8, 0x100F00F00F00F00F), (4, 0x10C30C30C30C30C3), (2, 0x1249249249249249),
)  # fmt: skip
"""Shifts and masks that put two zeros before each of the lowest 21 bits of a number."""

NEIGHBOUR_OFFSETS = np.array([d for d in product((-1, 0, 1), repeat=3) if any(d)])


@dataclass(frozen=True, slots=True, eq=False)
class Octree:
    """Leaves of the box [lo, hi]: lowest finest cell `origin` (N, 3) and edge `size` (N,) in finest cells.

    `shape` (3,) is the number of finest cells along each axis. `codes` (N,) are the sorted Morton codes of the leaves' lowest
    cells, `leaf_of_code` (N,) the leaf of each.
    """

    lo: Array
    hi: Array
    origin: IntArray
    size: IntArray
    shape: IntArray
    codes: IntArray
    leaf_of_code: IntArray

    @property
    def cell_edges(self) -> Array:
        """Edge lengths (3,) of a finest cell in model units."""
        return (self.hi - self.lo) / self.shape

    def points(self, nodes: Array | IntArray) -> Array:
        """Model coordinates (..., 3) of positions on the finest grid; positions on the box are exact."""
        t = nodes / self.shape
        return self.lo * (1.0 - t) + self.hi * t

    def leaves_at(self, cells: IntArray) -> IntArray:
        """Numbers (...) of the leaves that contain finest cells (..., 3) of the box."""
        return np.asarray(self.leaf_of_code[np.searchsorted(self.codes, _morton_codes(cells), side="right") - 1])

    def leaf_centres(self, leaves: IntArray) -> Array:
        """Model coordinates (n, 3) of the centres of leaves (n,)."""
        return self.points(self.origin[leaves] + 0.5 * self.size[leaves][:, None])


def uniform_octree(lo: Array, hi: Array, counts: IntArray) -> Octree:
    """Octree with one level: `counts` (3,) leaves along each axis."""
    origin = np.stack(np.meshgrid(*(np.arange(n) for n in counts), indexing="ij"), axis=-1).reshape(-1, 3)
    size = np.ones(len(origin), np.int64)
    return _order_leaves(lo, hi, origin, size, np.array(counts))


def split_leaves(tree: Octree, chosen: BoolArray | IntArray) -> Octree:
    """Octree with the chosen leaves (a mask (N,) or numbers) split in eight, and all others that 2:1 balance then requires."""
    split = np.zeros(len(tree.size), bool)
    split[chosen] = True
    while split.any():
        origin, size, shape = tree.origin, tree.size, tree.shape
        if (size[split] == 1).any():
            origin, size, shape = 2 * origin, 2 * size, 2 * shape
        half = size[split] // 2
        children = origin[split][:, None] + half[:, None, None] * CHILD_OFFSETS
        origin = np.concatenate([origin[~split], children.reshape(-1, 3)])
        size = np.concatenate([size[~split], np.repeat(half, 8)])
        tree = _order_leaves(tree.lo, tree.hi, origin, size, shape)
        split = _find_unbalanced_leaves(tree, np.arange(len(size) - 8 * len(half), len(size)))
    return tree


def _find_unbalanced_leaves(tree: Octree, small: IntArray) -> BoolArray:
    """Mask (N,) of leaves of which one of the leaves `small` (n,) is a neighbour of less than half the size.

    The larger of two neighbours contains the whole block of the smaller one's size beside it, so one look-up per direction
    suffices.
    """
    result = np.zeros(len(tree.size), bool)
    origin, size = tree.origin[small], tree.size[small]
    for direction in NEIGHBOUR_OFFSETS:
        cell = origin + size[:, None] * direction
        inside = ((cell >= 0) & (cell < tree.shape)).all(axis=1)
        neighbour = tree.leaves_at(cell[inside])
        result[neighbour[tree.size[neighbour] > 2 * size[inside]]] = True
    return result


def _order_leaves(lo: Array, hi: Array, origin: IntArray, size: IntArray, shape: IntArray) -> Octree:
    """The octree of these leaves."""
    codes = _morton_codes(origin)
    order = np.argsort(codes)
    return Octree(lo, hi, origin, size, shape, codes[order], order)


def _morton_codes(cells: IntArray) -> IntArray:
    """Morton codes (...) of cells (..., 3): the bits of the three coordinates, at most 21 of each, interleaved."""
    code = np.zeros(cells.shape[:-1], np.int64)
    for axis in range(3):
        x = cells[..., axis].astype(np.int64)
        for shift, mask in MORTON_STEPS:
            x = (x | (x << shift)) & mask
        code |= x << (2 - axis)
    return code
