"""Octrees over a box, balanced 2:1 across faces, edges and corners, with the leaves numbered on the finest grid.

Positions are integers in units of the finest cell. One dense array says which leaf every finest cell belongs to: neighbours,
hanging nodes and minimal faces are then look-ups. A leaf of size s has s finest cells along each axis.
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
    """Leaves of a box [lo, hi]: `origin` (N, 3) and `size` (N,) on the finest grid, `leaf` which one each finest cell is in."""

    lo: Array
    hi: Array
    origin: IntArray
    size: IntArray
    leaf: NDArray[np.int32]

    @property
    def shape(self) -> IntArray:
        """Finest cells along each axis."""
        return np.array(self.leaf.shape)

    @property
    def step(self) -> Array:
        """Edges of a finest cell, in model units."""
        return (self.hi - self.lo) / self.shape

    def points(self, nodes: Array | IntArray) -> Array:
        """Model coordinates of positions on the finest grid; those on the box are exact."""
        t = nodes / self.shape
        return self.lo * (1.0 - t) + self.hi * t


def uniform_octree(lo: Array, hi: Array, counts: IntArray) -> Octree:
    """The octree of one level: `counts` (3,) leaves along each axis."""
    origin = np.stack(np.meshgrid(*(np.arange(n) for n in counts), indexing="ij"), axis=-1).reshape(-1, 3)
    return Octree(
        lo,
        hi,
        origin,
        np.ones(len(origin), np.int64),
        _number_finest_cells(origin, np.ones(len(origin), np.int64), counts),
    )


def split_leaves(tree: Octree, chosen: BoolArray) -> Octree:
    """The octree with the chosen leaves (N,) split in eight, and every other that 2:1 balance then asks for."""
    while chosen.any():
        origin, size, shape = tree.origin, tree.size, tree.shape
        if (size[chosen] == 1).any():
            origin, size, shape = 2 * origin, 2 * size, 2 * shape
        half = size[chosen] // 2
        children = origin[chosen][:, None] + half[:, None, None] * CHILD_OFFSETS
        origin = np.concatenate([origin[~chosen], children.reshape(-1, 3)])
        size = np.concatenate([size[~chosen], np.repeat(half, 8)])
        tree = Octree(tree.lo, tree.hi, origin, size, _number_finest_cells(origin, size, shape))
        chosen = _find_unbalanced_leaves(tree)
    return tree


def _find_unbalanced_leaves(tree: Octree) -> BoolArray:
    """Leaves that touch one less than half their size.

    A larger leaf beside a smaller one holds all of the block of the smaller's size beside it: one look-up a direction.
    """
    result = np.zeros(len(tree.size), bool)
    for direction in NEIGHBOUR_OFFSETS:
        cell = tree.origin + tree.size[:, None] * direction
        inside = ((cell >= 0) & (cell < tree.shape)).all(axis=1)
        beside = tree.leaf[tuple(cell[inside].T)]
        result[beside[tree.size[beside] > 2 * tree.size[inside]]] = True
    return result


def _number_finest_cells(origin: IntArray, size: IntArray, shape: IntArray) -> NDArray[np.int32]:
    """The leaf number of every finest cell."""
    leaf = np.empty(tuple(shape), np.int32)
    for s in np.unique(size):
        at = np.flatnonzero(size == s)
        blocks = leaf.reshape(shape[0] // s, s, shape[1] // s, s, shape[2] // s, s)
        i, j, k = (origin[at] // s).T
        blocks[i, :, j, :, k, :] = at[:, None, None, None]
    return leaf
