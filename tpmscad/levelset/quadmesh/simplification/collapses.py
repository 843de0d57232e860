"""Collapses of diagonals, single edges, strips of quadrilaterals, and pairs of triangles, found and rated many at once.

The collapse of a diagonal merges two opposite corners of a quadrilateral and removes it (Tarini et al. 2010). A strip (polychord)
collapse merges the ends of opposite edges along a chain of quadrilaterals between two triangles or sides on the box (Daniels et
al. 2008). A collapse is described by its seed, which `plan_edit` turns into an exact edit.

The ratings treat doublets approximately: the polygons at a doublet are left out, since their union is known only once the edit is
planned. Exact ratings of the diagonals beside them leave as many patches and take longer.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad._compiled_loops import njit_cached
from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.array_table import ArrayTable
from tpmscad.levelset.quadmesh.quality import measure_polygon
from tpmscad.levelset.quadmesh.simplification.polygon_mesh import (
    MAX_VALENCE,
    PATCHES_PER_TRIANGLE,
    MeshEdit,
    PolygonMesh,
)
from tpmscad.levelset.quadmesh.simplification.vertex_stars import (
    SurfaceVertices,
    VertexStars,
    polygon_left_of,
)

MAX_STRIP_QUADS = 8
"""Largest number of quadrilaterals in a strip."""

MAX_STRIP_LENGTH = MAX_STRIP_QUADS + 1
"""Largest number of merges, and of polygons that vanish, of a strip."""

MAX_SEEDS_PER_POLYGON = 9
"""Seeds that a triangle has at most: at each side two strips and the removal of the side. A quadrilateral has six."""


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


def find_seeds(stars: VertexStars, n_fixed: IntArray, numbers: IntArray) -> CollapseSeeds:
    """Seeds of all collapses that start from these polygons.

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
        for i in range(n - 2 if n == 4 else 0):
            a, b = _collapse_direction(n_fixed, row[i], row[i + 2], False)
            if a >= 0:
                merges[found, 0, 0], merges[found, 0, 1], removed[found, 0] = a, b, number
                found += 1
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


def rate_collapses(stars: VertexStars, surface: SurfaceVertices, seeds: CollapseSeeds) -> tuple[Array, IntArray]:
    """Distortion of the worst polygon after each collapse, and the number of patches saved: (n,) each.

    The distortion is infinite if a polygon outside `removed` would degenerate, a valence would be too high or no patch would be
    saved.
    """
    removed, kept = seeds.merges[seeds.merges[..., 0] >= 0].T
    after = surface.append_merged_vertices(removed, kept)
    vertices = after.vertices, after.normals, after.fixed, len(surface.vertices)
    return _rate_seeds(stars, *vertices, seeds.merges, seeds.removed, seeds.shared_edge)


@njit_cached
def _rate_seeds(
    stars: VertexStars,
    vertices: Array,
    normals: Array,
    fixed: BoolArray,
    n_vertices: int,
    merges: IntArray,
    removed: IntArray,
    shared_edge: IntArray,
) -> tuple[Array, IntArray]:  # pragma: no cover
    """The worst distortion and the patches saved (n,); vertices beyond the first `n_vertices` are the merged ones, in order."""
    worst, saved = np.empty(len(merges)), np.empty(len(merges), np.int64)
    new_name = np.full(n_vertices, -1)
    n_gone_at, n_joined_at = np.zeros(n_vertices, np.int64), np.zeros(n_vertices, np.int64)
    done, is_gone = np.full(len(stars.rows), -1), np.full(len(stars.rows), -1)
    valence = np.zeros(merges.shape[1], np.int64)
    row = np.empty(4, np.int64)
    first_merged = n_vertices
    for i in range(len(merges)):
        n_merges = 0
        while n_merges < merges.shape[1] and merges[i, n_merges, 0] >= 0:
            for v in merges[i, n_merges]:
                new_name[v] = first_merged + n_merges
            valence[n_merges] = 0
            n_merges += 1
        total = 0
        for q in removed[i]:
            if q >= 0:
                is_gone[q] = i
                total += _patch_count(stars.rows[q])
                for v in stars.rows[q]:
                    if v >= 0:
                        n_gone_at[v] += 1
        if not n_merges:
            _join_triangles(stars, removed[i], shared_edge[i], row)
            for v in row:
                n_joined_at[v] = 1

        # doublets: inner corners of removed polygons, or of joined triangles, at which two polygons are left
        n_doublets = 0
        for q in removed[i]:
            if q >= 0:
                for v in stars.rows[q]:
                    if v >= 0 and _is_doublet(stars, fixed, new_name, n_gone_at, n_joined_at, v):
                        n_gone_at[v] = -1 - n_gone_at[v]  # marked, and counted once
                        n_doublets += 1

        result = 0.0
        if not n_merges:
            total -= 1
            if not _has_doublet(row, n_gone_at, n_vertices):
                result = measure_polygon(vertices, normals, fixed, row)
        for k in range(n_merges):
            for vertex in merges[i, k]:
                for entry in range(stars.first[vertex], stars.first[vertex + 1]):
                    polygon = stars.polygon[entry]
                    if done[polygon] == i or is_gone[polygon] == i:
                        continue
                    done[polygon] = i
                    total += _patch_count(stars.rows[polygon])
                    for c in range(4):
                        v = stars.rows[polygon, c]
                        row[c] = new_name[v] if v >= 0 and new_name[v] >= 0 else v
                    is_valid = _shrink_degenerate_quad(row)
                    total -= _patch_count(row)
                    for v in row:
                        if v >= n_vertices:
                            valence[v - first_merged] += 1
                    if not is_valid:
                        result = np.inf
                    elif not _has_doublet(row, n_gone_at, n_vertices):
                        result = max(result, measure_polygon(vertices, normals, fixed, row))
        for k in range(n_merges):
            if valence[k] > MAX_VALENCE + n_doublets:
                result = np.inf
        saved[i] = total + n_doublets
        worst[i] = np.inf if saved[i] <= 0 else result

        for k in range(n_merges):
            for v in merges[i, k]:
                new_name[v] = -1
        for q in removed[i]:
            if q >= 0:
                for v in stars.rows[q]:
                    if v >= 0:
                        n_gone_at[v], n_joined_at[v] = 0, 0
        first_merged += n_merges
    return worst, saved


@njit_cached
def _is_doublet(
    stars: VertexStars, fixed: BoolArray, new_name: IntArray, n_gone_at: IntArray, n_joined_at: IntArray, v: int
) -> bool:  # pragma: no cover
    """Whether two polygons are left at an inner vertex that is not merged and not marked yet."""
    if n_gone_at[v] < 0 or new_name[v] >= 0 or fixed[v, 0] or fixed[v, 1] or fixed[v, 2]:
        return False
    return stars.first[v + 1] - stars.first[v] - n_gone_at[v] + n_joined_at[v] == 2


@njit_cached
def _has_doublet(row: IntArray, n_gone_at: IntArray, n_vertices: int) -> bool:  # pragma: no cover
    """Whether a corner of a polygon (4,) is marked as a doublet."""
    is_marked = False
    for v in row:
        is_marked |= 0 <= v < n_vertices and n_gone_at[v] < 0
    return is_marked


@njit_cached
def _shrink_degenerate_quad(row: IntArray) -> bool:  # pragma: no cover
    """Make a quadrilateral (4,) with one zero side a triangle, in place; whether the corners are then distinct."""
    if row[3] >= 0:
        n_same, place = 0, 0
        for k in range(4):
            if row[k] == row[(k + 1) % 4]:
                n_same, place = n_same + 1, k
        if n_same == 1:
            a, b, c = row[(place + 1) % 4], row[(place + 2) % 4], row[(place + 3) % 4]
            row[0], row[1], row[2], row[3] = a, b, c, -1
    for k in range(4):
        for m in range(k):
            if row[k] == row[m]:
                return False
    return True


@njit_cached
def _join_triangles(
    stars: VertexStars, removed: IntArray, shared_edge: IntArray, row: IntArray
) -> None:  # pragma: no cover
    """The quadrilateral (4,) of two triangles without their shared edge."""
    a, b = shared_edge[0], shared_edge[1]
    c, d = -a - b, -a - b
    for k in range(3):
        c += stars.rows[removed[0], k]
        d += stars.rows[removed[1], k]
    row[0], row[1], row[2], row[3] = a, d, b, c


@njit_cached
def _patch_count(row: IntArray) -> int:  # pragma: no cover
    return PATCHES_PER_TRIANGLE if row[3] < 0 else 1
