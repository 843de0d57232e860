"""Polygons round each vertex in arrays, and the positions of merged vertices, for rating many collapses at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.fields.field import Field
from tpmscad.levelset.quadmesh.vectors import MIN_DIVISOR, normalize


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceVertices:
    """Vertices (V, 3) on a level set, the unit normals (V, 3) there, and their coordinates (V, 3) fixed on the box."""

    field: Field
    vertices: Array
    normals: Array
    fixed: BoolArray

    def append_merged_vertices(self, removed: IntArray, kept: IntArray) -> SurfaceVertices:
        """The vertices followed by one for each pair (n,), near the place where the pair would merge.

        The place is the kept vertex if that has more fixed coordinates, else close to the middle: the midpoint of the cubic over
        the chord that is tangent to the level set at both ends, and one Newton step from there.
        """
        one, other = self.vertices[removed], self.vertices[kept]
        fixed = self.fixed[kept]
        points, normals = other.copy(), self.normals[kept].copy()
        rows = np.flatnonzero(fixed.sum(axis=1) <= self.fixed[removed].sum(axis=1))
        chord, free = (other - one)[rows], ~fixed[rows]
        lift = [np.einsum("ni,ni->n", chord, n)[:, None] * n for n in (self.normals[removed[rows]], normals[rows])]
        middle = 0.5 * (one + other)[rows] + np.where(free, lift[1] - lift[0], 0.0) / 8
        value, gradient = self.field.value_and_gradient(middle)
        along = np.where(free, gradient, 0.0)
        step = -(value / np.maximum(np.einsum("ni,ni->n", along, along), MIN_DIVISOR))[:, None] * along
        shorten = np.linalg.norm(chord, axis=1) / np.maximum(np.linalg.norm(step, axis=1), MIN_DIVISOR)
        points[rows] = middle + np.minimum(1.0, shorten)[:, None] * step
        normals[rows] = normalize(gradient)
        return SurfaceVertices(
            self.field,
            np.concatenate([self.vertices, points]),
            np.concatenate([self.normals, normals]),
            np.concatenate([self.fixed, fixed]),
        )


@dataclass(frozen=True, slots=True, eq=False)
class VertexStars:
    """Polygons round each vertex, in compressed rows: those of vertex v are entries `first[v]` to `first[v + 1]`.

    `rows` (N, 4): polygons by number, triangles padded with -1. `first` (V + 1,). `polygon`, `slot` (S,): an incident polygon and
    the place of the vertex among its corners. `side_keys`: sorted keys of all sides.
    """

    rows: IntArray
    first: IntArray
    polygon: IntArray
    slot: IntArray
    side_keys: IntArray

    @property
    def valence(self) -> IntArray:
        """Number (V,) of polygons round each vertex."""
        return np.diff(self.first)

    def polygons_around(self, vertices: IntArray) -> tuple[IntArray, IntArray, IntArray]:
        """Polygons round vertices (n,): the index into `vertices`, the polygon and the slot of each incidence, (m,) each."""
        count = self.first[vertices + 1] - self.first[vertices]
        owner = np.repeat(np.arange(len(vertices)), count)
        entry = np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count) + self.first[vertices][owner]
        return owner, self.polygon[entry], self.slot[entry]

    def corner_after(self, polygon: IntArray, slot: IntArray, steps: int) -> IntArray:
        """Vertex (m,) `steps` positions counter-clockwise of corner `slot` in each polygon."""
        size = np.where(self.rows[polygon, 3] < 0, 3, 4)
        return self.rows[polygon, (slot + steps) % size]

    def are_adjacent(self, one: IntArray, other: IntArray) -> BoolArray:
        """Whether a side joins the vertices of each pair (n,)."""
        keys = _side_keys(one, other, len(self.first))
        entry = np.minimum(np.searchsorted(self.side_keys, keys), len(self.side_keys) - 1)
        return np.asarray(self.side_keys[entry] == keys)


def build_vertex_stars(rows: IntArray, n_vertices: int) -> VertexStars:
    """The stars of all vertices of polygons (N, 4) by number."""
    polygon, slot = np.nonzero(rows >= 0)
    vertex = rows[polygon, slot]
    next_vertex = rows[polygon, (slot + 1) % np.where(rows[polygon, 3] < 0, 3, 4)]
    order = np.argsort(vertex, kind="stable")
    first = np.concatenate([[0], np.cumsum(np.bincount(vertex, minlength=n_vertices))])
    side_keys = np.unique(_side_keys(vertex, next_vertex, n_vertices + 1))
    return VertexStars(rows, first, polygon[order], slot[order], side_keys)


def segment_max(values: Array, owner: IntArray, count: int) -> Array:
    """Largest of the non-negative values (m,) of each owner: (count,), zero for an owner of none."""
    result = np.zeros(count)
    np.maximum.at(result, owner, values)
    return result


def _side_keys(one: IntArray, other: IntArray, count: int) -> IntArray:
    return np.minimum(one, other) * count + np.maximum(one, other)
