"""Octree over a box, 2:1 balanced across faces, edges and corners, with its leaves numbered on the finest grid.

Positions are integers in units of the finest cell. One dense array gives the leaf of every finest cell, so that neighbours,
hanging nodes and minimal faces are found by look-up. A leaf of size s covers s finest cells along each axis.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from tpmscad._typing import Array, BoolArray, IntArray

CHILD_OFFSETS = np.array(list(product((0, 1), repeat=3)))
NEIGHBOUR_OFFSETS = np.array([d for d in product((-1, 0, 1), repeat=3) if any(d)])


@dataclass(frozen=True, slots=True, eq=False)
class Octree:
    """Leaves of the box [lo, hi]: lowest finest cell `origin` (N, 3) and edge `size` (N,) in finest cells.

    `leaf_of_cell` (X, Y, Z) is the number of the leaf that contains each finest cell.
    """

    lo: Array
    hi: Array
    origin: IntArray
    size: IntArray
    leaf_of_cell: NDArray[np.int32]

    @property
    def shape(self) -> IntArray:
        """Number of finest cells along each axis, (3,)."""
        return np.array(self.leaf_of_cell.shape)

    @property
    def cell_edges(self) -> Array:
        """Edge lengths (3,) of a finest cell in model units."""
        return (self.hi - self.lo) / self.shape

    def points(self, nodes: Array | IntArray) -> Array:
        """Model coordinates (..., 3) of positions on the finest grid; positions on the box are exact."""
        t = nodes / self.shape
        return self.lo * (1.0 - t) + self.hi * t

    def leaf_centres(self, leaves: IntArray) -> Array:
        """Model coordinates (n, 3) of the centres of leaves (n,)."""
        return self.points(self.origin[leaves] + 0.5 * self.size[leaves][:, None])


def uniform_octree(lo: Array, hi: Array, counts: IntArray) -> Octree:
    """Octree with one level: `counts` (3,) leaves along each axis."""
    origin = np.stack(np.meshgrid(*(np.arange(n) for n in counts), indexing="ij"), axis=-1).reshape(-1, 3)
    size = np.ones(len(origin), np.int64)
    return Octree(lo, hi, origin, size, _number_finest_cells(origin, size, counts))


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
        tree = Octree(tree.lo, tree.hi, origin, size, _number_finest_cells(origin, size, shape))
        split = _find_unbalanced_leaves(tree)
    return tree


def _find_unbalanced_leaves(tree: Octree) -> BoolArray:
    """Mask (N,) of leaves with a neighbour of less than half their size.

    The larger of two neighbours contains the whole block of the smaller one's size beside it, so one look-up per direction
    suffices.
    """
    result = np.zeros(len(tree.size), bool)
    for direction in NEIGHBOUR_OFFSETS:
        cell = tree.origin + tree.size[:, None] * direction
        inside = ((cell >= 0) & (cell < tree.shape)).all(axis=1)
        neighbour = tree.leaf_of_cell[tuple(cell[inside].T)]
        result[neighbour[tree.size[neighbour] > 2 * tree.size[inside]]] = True
    return result


def _number_finest_cells(origin: IntArray, size: IntArray, shape: IntArray) -> NDArray[np.int32]:
    """Leaf number of every finest cell, (X, Y, Z)."""
    leaf = np.empty(tuple(shape), np.int32)
    for s in np.unique(size):
        numbers = np.flatnonzero(size == s)
        blocks = leaf.reshape(shape[0] // s, s, shape[1] // s, s, shape[2] // s, s)
        i, j, k = (origin[numbers] // s).T
        blocks[i, :, j, :, k, :] = numbers[:, None, None, None]
    return leaf
