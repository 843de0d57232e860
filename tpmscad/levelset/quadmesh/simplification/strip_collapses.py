"""Collapses that start from a triangle or from a side on the box: single edges, strips of quadrilaterals, and triangle pairs.

A strip (polychord) collapse merges the ends of opposite edges along a chain of quadrilaterals between two triangles or sides on
the box (Daniels et al. 2008). A collapse is described by its seed, which `plan_edit` turns into an exact edit. `plan_edits_from`
plans those of one polygon exactly; it is the reference for `strip_ratings`, which rates many at once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad._compiled_loops import njit_cached
from tpmscad._typing import IntArray
from tpmscad.array_table import ArrayTable
from tpmscad.levelset.quadmesh.simplification.polygon_mesh import MeshEdit, PolygonMesh
from tpmscad.levelset.quadmesh.simplification.vertex_stars import VertexStars, build_vertex_stars, polygon_left_of

MAX_STRIP_QUADS = 8
"""Largest number of quadrilaterals in a strip."""

MAX_STRIP_LENGTH = MAX_STRIP_QUADS + 1
"""Largest number of merges, and of polygons that vanish, of a strip."""

MAX_SEEDS_PER_POLYGON = 9
"""Seeds that a triangle has at most: at each side two strips and the removal of the side."""


@dataclass(frozen=True, slots=True)
class CollapseSeed:
    """What defines a collapse: vertex merges (from, into), and the polygons, by number, that vanish with them at least.

    Without merges the two removed polygons are triangles that lose their `shared_edge`.
    """

    merges: tuple[tuple[int, int], ...]
    removed: tuple[int, ...]
    shared_edge: tuple[int, int] = (-1, -1)


@dataclass(frozen=True, slots=True, eq=False)
class CollapseSeeds(ArrayTable):
    """The seeds of n collapses in arrays, padded with -1: merges (n, m, 2), removed polygons (n, m), shared edges (n, 2)."""

    merges: IntArray
    removed: IntArray
    shared_edge: IntArray

    @staticmethod
    def allocate(count: int) -> CollapseSeeds:
        """So many seeds without merges and polygons, to be filled in."""
        shapes = (count, MAX_STRIP_LENGTH, 2), (count, MAX_STRIP_LENGTH), (count, 2)
        return CollapseSeeds(*(np.full(shape, -1) for shape in shapes))

    def seed(self, row: int) -> CollapseSeed:
        """One of the seeds."""
        merges = tuple((a, b) for a, b in self.merges[row].tolist() if a >= 0)
        a, b = self.shared_edge[row].tolist()
        return CollapseSeed(merges, tuple(n for n in self.removed[row].tolist() if n >= 0), (a, b))


def plan_edit(polygons: PolygonMesh, seed: CollapseSeed) -> MeshEdit | None:
    """The edit of a seed, or None if it is not valid, or no longer so."""
    if any(number not in polygons.corners_of for number in seed.removed):
        return None
    if seed.merges:
        return polygons.plan_collapse(dict(seed.merges), seed.removed)
    one, other = seed.removed
    return polygons.plan_edge_removal(one, other, *seed.shared_edge)


def plan_edits_from(polygons: PolygonMesh, number: int) -> list[MeshEdit]:
    """All valid edits that start from one polygon, planned exactly one by one.

    From a quadrilateral: the collapses of its diagonals, and of the strips that begin at its sides on the box. From a triangle:
    the removal of edges to other triangles, and the collapses of its edges and of the strips that begin at them.
    """
    polygon, n_fixed = polygons.corners_of[number], np.array(polygons.n_fixed)
    seeds = []
    if len(polygon) == 4:
        for a, c in ((polygon[0], polygon[2]), (polygon[1], polygon[3])):
            start, end = _collapse_direction(n_fixed, a, c, False)
            if start >= 0:
                seeds.append(CollapseSeed(((start, end),), (number,)))
    strips = find_strip_seeds(build_vertex_stars(polygons.rows, len(n_fixed)), n_fixed, np.array([number]))
    seeds += [strips.seed(row) for row in range(len(strips))]
    return [edit for edit in (plan_edit(polygons, seed) for seed in seeds) if edit is not None]


def find_strip_seeds(stars: VertexStars, n_fixed: IntArray, numbers: IntArray) -> CollapseSeeds:
    """Seeds of all collapses that start from these polygons, except their diagonals.

    `n_fixed` (V,): number of fixed coordinates of each vertex.
    """
    found = CollapseSeeds.allocate(MAX_SEEDS_PER_POLYGON * len(numbers))
    count = _find_seeds(stars, n_fixed, numbers, found.merges, found.removed, found.shared_edge)
    return found[:count]


@njit_cached
def _find_seeds(
    stars: VertexStars,
    n_fixed: IntArray,
    numbers: IntArray,
    merges: IntArray,
    removed: IntArray,
    shared_edge: IntArray,
) -> int:  # pragma: no cover
    """Fill in the seeds of these polygons; their number."""
    found = 0
    for number in numbers:
        row = stars.rows[number]
        n = 3 if row[3] < 0 else 4
        for i in range(n):
            u, v = row[i - 1 if i else n - 1], row[i]
            other = polygon_left_of(stars, v, u)
            a, b, begins_strip = -1, -1, n == 3
            if n == 3 and other >= 0 and stars.rows[other, 3] < 0:
                removed[found, 0], removed[found, 1] = number, other
                shared_edge[found, 0], shared_edge[found, 1] = u, v
                found += 1
            if n == 4 and other < 0:
                a, b = _collapse_direction(n_fixed, u, v, other < 0)
                begins_strip = a >= 0
                u, v = row[(i + 1) % 4], row[(i + 2) % 4]
            if begins_strip:
                found = _grow_strip(stars, n_fixed, number, a, b, u, v, merges, removed, found)
    return found


@njit_cached
def _grow_strip(
    stars: VertexStars,
    n_fixed: IntArray,
    number: int,
    first_removed: int,
    first_kept: int,
    u: int,
    v: int,
    merges: IntArray,
    removed: IntArray,
    found: int,
) -> int:  # pragma: no cover
    """Seeds of the strip that crosses the edge from u to v and the edges opposite, up to a triangle or the box.

    The strip begins with polygon `number`: a triangle, or a quadrilateral with a first merge of its side on the box, which is -1
    for a triangle. Fills in the seeds from number `found` on, and returns the number of the next.
    """
    strip, gone = np.empty((MAX_STRIP_LENGTH, 2), np.int64), np.empty(MAX_STRIP_LENGTH, np.int64)
    gone[0] = number
    n_merges, n_gone = 0, 1
    if first_removed >= 0:
        strip[0, 0], strip[0, 1] = first_removed, first_kept
        n_merges = 1
    for _ in range(MAX_STRIP_QUADS):
        other = polygon_left_of(stars, v, u)
        a, b = _collapse_direction(n_fixed, u, v, other < 0)
        is_used = a < 0
        for k in range(n_merges):
            is_used |= strip[k, 0] == u or strip[k, 1] == u or strip[k, 0] == v or strip[k, 1] == v
        for k in range(n_gone):
            is_used |= gone[k] == other
        if is_used:
            break
        strip[n_merges, 0], strip[n_merges, 1] = a, b
        n_merges += 1
        ends_at_triangle = other >= 0 and stars.rows[other, 3] < 0
        if other < 0 or ends_at_triangle or (n_gone == 1 and first_removed < 0):
            merges[found, :n_merges], removed[found, :n_gone] = strip[:n_merges], gone[:n_gone]
            if ends_at_triangle:
                removed[found, n_gone] = other
            found += 1
        if other < 0 or ends_at_triangle:
            break
        gone[n_gone] = other
        n_gone += 1
        row, i = stars.rows[other], 0
        while row[i] != v:
            i += 1
        v, u = row[i - 1 if i else 3], row[(i + 2) % 4]
    return found


@njit_cached
def _collapse_direction(n_fixed: IntArray, a: int, b: int, on_box: bool) -> tuple[int, int]:  # pragma: no cover
    """The merge (from, into) of two vertices, towards the one with more fixed coordinates.

    (-1, -1) for two vertices on the box that no side on the box joins, and for two on edges of the box.
    """
    one, other = n_fixed[a], n_fixed[b]
    if one and other and (not on_box or one + other == 4):
        return -1, -1
    if other > one or (other == one and b > a):
        return a, b
    return b, a
