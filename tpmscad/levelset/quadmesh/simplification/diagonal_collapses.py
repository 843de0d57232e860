"""Collapses of the diagonals of quadrilaterals, found and rated all at once (Tarini et al. 2010).

A diagonal collapse merges one corner of a quadrilateral into the opposite one and removes the quadrilateral. An inner corner of
valence three beside the diagonal becomes a doublet, whose two polygons are joined. Feasibility is tested here only as far as the
stars of the diagonal's ends tell; `PolygonMesh.plan_collapse` makes the full test.
"""

from __future__ import annotations

import numpy as np

from tpmscad._compiled_loops import njit_cached
from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.levelset.quadmesh.quality import measure_polygon
from tpmscad.levelset.quadmesh.simplification.polygon_mesh import MAX_VALENCE, MIN_VALENCE
from tpmscad.levelset.quadmesh.simplification.strip_collapses import CollapseSeeds
from tpmscad.levelset.quadmesh.simplification.vertex_stars import (
    SurfaceVertices,
    VertexStars,
    are_adjacent,
    corner_after,
)


def rate_diagonal_collapses(
    stars: VertexStars, surface: SurfaceVertices, numbers: IntArray
) -> tuple[CollapseSeeds, Array, IntArray]:
    """The diagonal collapses of the quadrilaterals among these polygons.

    Seeds, the distortion (n,) of the worst polygon afterwards, infinite if one degenerates, and the patches saved (n,).
    """
    number, corner, is_doublet = _find_feasible_diagonals(stars, surface.fixed.sum(axis=1), numbers)
    after = surface.append_merged_vertices(corner[:, 0], corner[:, 2])
    worst = _rate_diagonals(stars, after.vertices, after.normals, after.fixed, number, corner, is_doublet)
    seeds = CollapseSeeds.allocate(len(number))
    seeds.merges[:, 0], seeds.removed[:, 0] = corner[:, ::2], number
    return seeds, worst, 1 + is_doublet.sum(axis=1)


@njit_cached
def _find_feasible_diagonals(
    stars: VertexStars, n_fixed: IntArray, numbers: IntArray
) -> tuple[IntArray, IntArray, BoolArray]:  # pragma: no cover
    """Diagonals whose collapse leaves allowed valences and no double edges.

    The removed vertex lies inside the box; of two vertices inside, that of the lower number is removed. Found are the
    quadrilaterals (n,), their corners (n, 4) counter-clockwise from the removed one, and whether the second and the fourth corner
    (n, 2) become doublets.
    """
    found, most = 0, 2 * len(numbers)
    number, corner = np.empty(most, np.int64), np.empty((most, 4), np.int64)
    is_doublet = np.empty((most, 2), np.bool_)
    for q in numbers:
        row = stars.rows[q]
        if row[3] < 0:
            continue
        for start in range(2):
            a, c, turn = row[start], row[start + 2], start
            if not (n_fixed[c] > n_fixed[a] or (n_fixed[c] == n_fixed[a] and c > a)):
                turn = start + 2
            for k in range(4):
                corner[found, k] = row[(turn + k) % 4]
            removed, kept = corner[found, 0], corner[found, 2]
            left = -2
            for vertex in (removed, kept):
                left += stars.first[vertex + 1] - stars.first[vertex]
            for k in range(2):
                vertex = corner[found, 2 * k + 1]
                valence = stars.first[vertex + 1] - stars.first[vertex]
                is_doublet[found, k] = n_fixed[vertex] == 0 and valence == MIN_VALENCE
                left -= is_doublet[found, k]
            if n_fixed[removed] > 0 or left > MAX_VALENCE or (left < MIN_VALENCE and n_fixed[kept] == 0):
                continue
            if not _makes_double_edge(stars, q, corner[found]):
                number[found] = q
                found += 1
    return number[:found], corner[:found], is_doublet[:found]


@njit_cached
def _makes_double_edge(stars: VertexStars, number: int, corner: IntArray) -> bool:  # pragma: no cover
    """Whether the ends of a quadrilateral's diagonal share a polygon or a neighbour that are not its own."""
    second, kept, last = corner[1], corner[2], corner[3]
    for entry in range(stars.first[corner[0]], stars.first[corner[0] + 1]):
        polygon = stars.polygon[entry]
        if polygon == number:
            continue
        for k in range(4):
            if stars.rows[polygon, k] == kept:
                return True
        neighbour = corner_after(stars, entry, 1)
        if neighbour != second and neighbour != last and are_adjacent(stars, neighbour, kept):
            return True
    return False


@njit_cached
def _rate_diagonals(
    stars: VertexStars,
    vertices: Array,
    normals: Array,
    fixed: BoolArray,
    number: IntArray,
    corner: IntArray,
    is_doublet: BoolArray,
) -> Array:  # pragma: no cover
    """The distortion (n,) of the worst polygon after each collapse; the last n vertices are the merged ones."""
    first_merged = len(vertices) - len(number)
    row, worst = np.empty(4, np.int64), np.empty(len(number))
    for i in range(len(number)):
        merged, result = first_merged + i, 0.0
        for k in range(2):
            if is_doublet[i, k]:
                one = _entry_beside(stars, corner[i, 2 * k], corner[i, 2 * k + 1], -1)
                other = _entry_beside(stars, corner[i, 2 - 2 * k], corner[i, 2 * k + 1], 1)
                if _join_at_doublet(stars, one, other, merged, row):
                    result = max(result, measure_polygon(vertices, normals, fixed, row))
                else:
                    result = np.inf
        for end in (0, 2):
            vertex = corner[i, end]
            for entry in range(stars.first[vertex], stars.first[vertex + 1]):
                polygon = stars.polygon[entry]
                # before one end and behind the other lie the polygons that are joined at doublets
                before, behind = corner_after(stars, entry, -1), corner_after(stars, entry, 1)
                is_joined = is_doublet[i, end // 2] and before == corner[i, end + 1]
                is_joined |= is_doublet[i, 1 - end // 2] and behind == corner[i, 3 - end]
                if polygon == number[i] or is_joined:
                    continue
                row[:] = stars.rows[polygon]
                row[stars.slot[entry]] = merged
                result = max(result, measure_polygon(vertices, normals, fixed, row))
        worst[i] = result
    return worst


@njit_cached
def _entry_beside(stars: VertexStars, vertex: int, doublet: int, steps: int) -> int:  # pragma: no cover
    """The entry round a vertex at whose polygon the doublet is `steps` corners away."""
    for entry in range(stars.first[vertex], stars.first[vertex + 1]):
        if corner_after(stars, entry, steps) == doublet:
            return entry
    return -1


@njit_cached
def _join_at_doublet(stars: VertexStars, one: int, other: int, merged: int, row: IntArray) -> bool:  # pragma: no cover
    """The polygon (4,) into which the polygons at entries `one` and `other`, before and behind a doublet, are joined.

    False if none is left.
    """
    far, last = corner_after(stars, one, -2), corner_after(stars, other, -1)
    if stars.rows[stars.polygon[other], 3] < 0:
        last = -1
    row[0] = merged
    if stars.rows[stars.polygon[one], 3] < 0:
        row[1], row[2], row[3] = far, last, -1
    else:
        row[1], row[2], row[3] = corner_after(stars, one, 1), far, last
    return row[2] >= 0
