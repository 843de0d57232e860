"""Where vertices of a layout would be that two of its own are merged to.

The polygons round each vertex of a layout as arrays, to look at many changes at once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.fields.field import Field
from tpmscad.levelset.quadmesh.vectors import MIN_DIVISOR, normalize


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceVertices:
    """Vertices (V, 3) of a layout on a field, the surface's normals there, and which coordinates lie on the box."""

    field: Field
    vertices: Array
    normals: Array
    fixed: BoolArray

    def append_merged_vertices(self, goes: IntArray, stays: IntArray) -> SurfaceVertices:
        """With a vertex more for each pair, (n,), of which one goes into the other, near where that would be."""
        one, other = self.vertices[goes], self.vertices[stays]
        fixed = self.fixed[stays]
        points, normals = other.copy(), self.normals[stays].copy()
        between = np.flatnonzero(fixed.sum(axis=1) <= self.fixed[goes].sum(axis=1))
        chord, free = (other - one)[between], ~fixed[between]
        # the middle of the cubic along the chord that is tangent to the surface at its ends, and one step of Newton's
        lift = [np.einsum("ni,ni->n", chord, n)[:, None] * n for n in (self.normals[goes[between]], normals[between])]
        middle = 0.5 * (one + other)[between] + np.where(free, lift[1] - lift[0], 0.0) / 8
        value, slope = self.field.value_and_gradient(middle)
        along = np.where(free, slope, 0.0)
        step = -(value / np.maximum(np.einsum("ni,ni->n", along, along), MIN_DIVISOR))[:, None] * along
        reach = np.linalg.norm(chord, axis=1) / np.maximum(np.linalg.norm(step, axis=1), MIN_DIVISOR)
        points[between] = middle + np.minimum(1.0, reach)[:, None] * step
        normals[between] = normalize(slope)
        return SurfaceVertices(
            self.field,
            np.concatenate([self.vertices, points]),
            np.concatenate([self.normals, normals]),
            np.concatenate([self.fixed, fixed]),
        )


@dataclass(frozen=True, slots=True, eq=False)
class VertexStars:
    """Polygons `rows` (N, 4) by number, triangles with a last -1; `first` (V + 1,) where those of each vertex begin among
    `polygon` (S,), with the vertex at their corner `slot` (S,). `sides`: sorted keys of the sides."""

    rows: IntArray
    first: IntArray
    polygon: IntArray
    slot: IntArray
    sides: IntArray

    @property
    def count(self) -> IntArray:
        """Polygons round each vertex, (V,)."""
        return np.diff(self.first)

    def around(self, vertices: IntArray) -> tuple[IntArray, IntArray, IntArray]:
        """The polygons round these vertices (n,): which of the vertices (m,), polygons (m,) and corners (m,)."""
        count = self.first[vertices + 1] - self.first[vertices]
        owner = np.repeat(np.arange(len(vertices)), count)
        at = np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count) + self.first[vertices][owner]
        return owner, self.polygon[at], self.slot[at]

    def beside(self, polygon: IntArray, slot: IntArray, steps: int) -> IntArray:
        """The corners of polygons (m,) that many after the one at `slot`."""
        size = np.where(self.rows[polygon, 3] < 0, 3, 4)
        return self.rows[polygon, (slot + steps) % size]

    def joined(self, one: IntArray, other: IntArray) -> BoolArray:
        """Whether a side joins these vertices (n,)."""
        keys = _side_keys(one, other, len(self.first))
        at = np.minimum(np.searchsorted(self.sides, keys), len(self.sides) - 1)
        return np.asarray(self.sides[at] == keys)


def build_vertex_stars(rows: IntArray, vertices: int) -> VertexStars:
    """The stars of so many vertices, of polygons (N, 4) by number."""
    polygon, slot = np.nonzero(rows >= 0)
    vertex = rows[polygon, slot]
    following = rows[polygon, (slot + 1) % np.where(rows[polygon, 3] < 0, 3, 4)]
    order = np.argsort(vertex, kind="stable")
    first = np.concatenate([[0], np.cumsum(np.bincount(vertex, minlength=vertices))])
    return VertexStars(rows, first, polygon[order], slot[order], np.unique(_side_keys(vertex, following, vertices + 1)))


def _side_keys(one: IntArray, other: IntArray, count: int) -> IntArray:
    return np.minimum(one, other) * count + np.maximum(one, other)


def segment_max(values: Array, owner: IntArray, count: int) -> Array:
    """The greatest of the values (m,) of each owner, (count,); nothing for those of none."""
    result = np.zeros(count)
    np.maximum.at(result, owner, values)
    return result
