"""The polygons round each vertex of a layout as arrays, to look at many changes at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad.patches.levelset.layout.octree import Array, Ints, Mask


@dataclass(frozen=True, slots=True, eq=False)
class Stars:
    """Polygons `rows` (N, 4) by number, triangles with a last -1; `first` (V + 1,) where those of each vertex begin among
    `polygon` (S,), with the vertex at their corner `slot` (S,). `sides`: sorted keys of the sides."""

    rows: Ints
    first: Ints
    polygon: Ints
    slot: Ints
    sides: Ints

    @property
    def count(self) -> Ints:
        """Polygons round each vertex, (V,)."""
        return np.diff(self.first)

    def around(self, vertices: Ints) -> tuple[Ints, Ints, Ints]:
        """The polygons round these vertices (n,): which of the vertices (m,), polygons (m,) and corners (m,)."""
        count = self.first[vertices + 1] - self.first[vertices]
        owner = np.repeat(np.arange(len(vertices)), count)
        at = np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count) + self.first[vertices][owner]
        return owner, self.polygon[at], self.slot[at]

    def beside(self, polygon: Ints, slot: Ints, steps: int) -> Ints:
        """The corners of polygons (m,) that many after the one at `slot`."""
        size = np.where(self.rows[polygon, 3] < 0, 3, 4)
        return self.rows[polygon, (slot + steps) % size]

    def joined(self, one: Ints, other: Ints) -> Mask:
        """Whether a side joins these vertices (n,)."""
        keys = _keys(one, other, len(self.first))
        at = np.minimum(np.searchsorted(self.sides, keys), len(self.sides) - 1)
        return np.asarray(self.sides[at] == keys)


def stars(rows: Ints, vertices: int) -> Stars:
    """The stars of so many vertices, of polygons (N, 4) by number."""
    polygon, slot = np.nonzero(rows >= 0)
    vertex = rows[polygon, slot]
    following = rows[polygon, (slot + 1) % np.where(rows[polygon, 3] < 0, 3, 4)]
    order = np.argsort(vertex, kind="stable")
    first = np.concatenate([[0], np.cumsum(np.bincount(vertex, minlength=vertices))])
    return Stars(rows, first, polygon[order], slot[order], np.unique(_keys(vertex, following, vertices + 1)))


def _keys(one: Ints, other: Ints, count: int) -> Ints:
    return np.minimum(one, other) * count + np.maximum(one, other)


def most(values: Array, owner: Ints, count: int) -> Array:
    """The greatest of the values (m,) of each owner, (count,); nothing for those of none."""
    result = np.zeros(count)
    np.maximum.at(result, owner, values)
    return result
