"""Polygons round each vertex in arrays, and the positions of merged vertices, for compiled loops over many collapses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tpmscad._compiled_loops import njit_cached
from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.fields.field import Field
from tpmscad.levelset.quadmesh.smoothing import project_with_gradients
from tpmscad.levelset.quadmesh.vectors import normalize


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
        longest = np.linalg.norm(chord, axis=1)
        points[rows], gradient = project_with_gradients(self.field, middle, ~free, longest, 1, 0.0)
        normals[rows] = normalize(gradient)
        return SurfaceVertices(
            self.field,
            np.concatenate([self.vertices, points]),
            np.concatenate([self.normals, normals]),
            np.concatenate([self.fixed, fixed]),
        )


class VertexStars(NamedTuple):
    """Polygons round each vertex, in compressed rows: those of vertex v are entries `first[v]` to `first[v + 1]`.

    A named tuple, which compiled loops accept. `rows` (N, 4): polygons by number, triangles padded with -1. `first` (V + 1,).
    `polygon`, `slot` (S,): an incident polygon and the place of the vertex among its corners.
    """

    rows: IntArray
    first: IntArray
    polygon: IntArray
    slot: IntArray


def build_vertex_stars(rows: IntArray, n_vertices: int) -> VertexStars:
    """The stars of all vertices of polygons (N, 4) by number."""
    first, count = np.zeros(n_vertices + 1, np.int64), int(np.count_nonzero(rows >= 0))
    stars = VertexStars(rows, first, np.empty(count, np.int64), np.empty(count, np.int64))
    _sort_incidences(stars)
    return stars


@njit_cached
def _sort_incidences(stars: VertexStars) -> None:  # pragma: no cover
    """Fill in the stars of the rows, by counting."""
    rows, first = stars.rows, stars.first
    for q in range(len(rows)):
        for k in range(4):
            if rows[q, k] >= 0:
                first[rows[q, k] + 1] += 1
    for v in range(1, len(first)):
        first[v] += first[v - 1]
    place = first[:-1].copy()
    for q in range(len(rows)):
        for k in range(4):
            if rows[q, k] >= 0:
                v = rows[q, k]
                stars.polygon[place[v]], stars.slot[place[v]] = q, k
                place[v] += 1


@njit_cached
def corner_after(stars: VertexStars, entry: int, steps: int) -> int:  # pragma: no cover
    """The vertex `steps` positions counter-clockwise, -2 to 2, of the corner at an entry of the stars."""
    row = stars.rows[stars.polygon[entry]]
    size = 3 if row[3] < 0 else 4
    return row[(stars.slot[entry] + steps + size) % size]


@njit_cached
def polygon_left_of(stars: VertexStars, a: int, b: int) -> int:  # pragma: no cover
    """The polygon with a side from vertex a to vertex b, -1 if there is none."""
    for entry in range(stars.first[a], stars.first[a + 1]):
        if corner_after(stars, entry, 1) == b:
            return stars.polygon[entry]
    return -1


def segment_max(values: Array, owner: IntArray, count: int) -> Array:
    """Largest of the non-negative values (m,) of each owner: (count,), zero for an owner of none."""
    result = np.zeros(count)
    np.maximum.at(result, owner, values)
    return result
