"""Collapses of the diagonals of quadrilaterals, found and rated all at once (Tarini et al. 2010).

A diagonal collapse merges one corner of a quadrilateral into the opposite one and removes the quadrilateral. An inner corner of
valence three beside the diagonal becomes a doublet, whose two polygons are joined. Feasibility is tested here only as far as the
stars of the diagonal's ends tell; `PolygonMesh.plan_collapse` makes the full test.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.levelset.quadmesh.quality import corner_distortion
from tpmscad.levelset.quadmesh.simplification.polygon_mesh import MAX_VALENCE, MIN_VALENCE
from tpmscad.levelset.quadmesh.simplification.vertex_stars import SurfaceVertices, VertexStars, segment_max

CornerPolygons = tuple[IntArray, IntArray, IntArray]
"""Polygons at corners of quadrilaterals: the quadrilateral, the polygon and the corner's slot in it, (m,) each."""


@dataclass(frozen=True, slots=True, eq=False)
class DiagonalCollapses:
    """n diagonal collapses: quadrilateral, removed and kept vertex, distortion of the worst polygon afterwards, patches saved."""

    polygon: IntArray
    removed: IntArray
    kept: IntArray
    distortion: Array
    patches_saved: IntArray


@dataclass(frozen=True, slots=True, eq=False)
class _CollapsibleQuads:
    """Quadrilaterals (n,), and their corners (4, n) counter-clockwise from the removed one.

    `doublet` (2, n): whether the second and the fourth corner become doublets.
    """

    number: IntArray
    corner: IntArray
    doublet: BoolArray

    def select(self, mask: BoolArray) -> _CollapsibleQuads:
        return _CollapsibleQuads(self.number[mask], self.corner[:, mask], self.doublet[:, mask])


def rate_diagonal_collapses(stars: VertexStars, surface: SurfaceVertices, numbers: IntArray) -> DiagonalCollapses:
    """The diagonal collapses of the quadrilaterals among these polygons, with an infinite distortion if a polygon degenerates."""
    quads = _find_feasible_diagonals(stars, surface, numbers)
    removed, kept, count = quads.corner[0], quads.corner[2], len(quads.number)
    merged = len(surface.vertices) + np.arange(count)
    ends = [_other_polygons_at_corner(stars, quads, i) for i in (0, 2)]
    rows, owners, valid = [], [], np.ones(count, bool)
    used = [np.zeros(len(owner), bool) for owner, _, _ in ends]
    for side_corner, first, second in ((1, 0, 1), (3, 1, 0)):
        row, owner, joined = _merge_doublet_polygons(stars, quads, side_corner, ends[first], ends[second], merged)
        valid[owner[row[:, 2] < 0]] = False
        used[first][joined[0]] = used[second][joined[1]] = True
        rows.append(row)
        owners.append(owner)
    for vertex, (owner, polygon, _), in_doublet in zip((removed, kept), ends, used, strict=True):
        owner, polygon = owner[~in_doublet], polygon[~in_doublet]
        row = stars.rows[polygon]
        rows.append(np.where(row == vertex[owner][:, None], merged[owner][:, None], row))
        owners.append(owner)
    after = surface.append_merged_vertices(removed, kept)
    row, owner = np.concatenate(rows), np.concatenate(owners)
    measured = valid[owner]
    distortion = corner_distortion(after.vertices, after.normals, after.fixed, row[measured])
    worst = np.where(valid, segment_max(distortion, owner[measured], count), np.inf)
    return DiagonalCollapses(quads.number, removed, kept, worst, 1 + quads.doublet.sum(axis=0))


def _find_feasible_diagonals(stars: VertexStars, surface: SurfaceVertices, numbers: IntArray) -> _CollapsibleQuads:
    """Diagonals whose collapse leaves allowed valences and no double edges.

    The removed vertex lies inside the box; of two vertices inside, that of the lower number is removed.
    """
    n_fixed, valence = surface.fixed.sum(axis=1), stars.valence
    numbers = numbers[stars.rows[numbers, 3] >= 0]
    number, slot = np.repeat(numbers, 2), np.tile([0, 1], len(numbers))
    a, c = stars.rows[number, slot], stars.rows[number, slot + 2]
    slot = np.where((n_fixed[c] > n_fixed[a]) | ((n_fixed[c] == n_fixed[a]) & (c > a)), slot, slot + 2)
    corner = np.stack([stars.rows[number, (slot + k) % 4] for k in range(4)])
    removed, kept, sides = corner[0], corner[2], corner[1::2]
    doublet = (n_fixed[sides] == 0) & (valence[sides] == MIN_VALENCE)
    left = valence[removed] + valence[kept] - 2 - doublet.sum(axis=0)
    allowed = (n_fixed[removed] == 0) & (left <= MAX_VALENCE) & ((left >= MIN_VALENCE) | (n_fixed[kept] > 0))
    quads = _CollapsibleQuads(number, corner, doublet).select(allowed)

    owner, polygon, slot = _other_polygons_at_corner(stars, quads, 0)
    _, second, opposite, last = quads.corner[:, owner]
    neighbour = stars.corner_after(polygon, slot, 1)
    double = stars.are_adjacent(neighbour, opposite) & (neighbour != second) & (neighbour != last)
    double |= (stars.rows[polygon] == opposite[:, None]).any(axis=1)
    feasible = np.ones(len(quads.number), bool)
    feasible[owner[double]] = False
    return quads.select(feasible)


def _other_polygons_at_corner(stars: VertexStars, quads: _CollapsibleQuads, corner: int) -> CornerPolygons:
    """The polygons other than the quadrilaterals themselves at this corner of them."""
    owner, polygon, slot = stars.polygons_around(quads.corner[corner])
    other = polygon != quads.number[owner]
    return owner[other], polygon[other], slot[other]


def _merge_doublet_polygons(
    stars: VertexStars,
    quads: _CollapsibleQuads,
    side_corner: int,
    first: CornerPolygons,
    second: CornerPolygons,
    merged: IntArray,
) -> tuple[IntArray, IntArray, tuple[IntArray, IntArray]]:
    """The polygons (n, 4) into which the two polygons at each doublet are joined, with -1 in the third place where none is left.

    Also the quadrilateral (n,) of each, and its two polygons as entries (n,) of `first` and `second`, the polygons at the corners
    before and behind the doublet.
    """
    doublet = quads.doublet[side_corner // 2]
    vertex = quads.corner[side_corner]
    entries = []
    for (owner, polygon, slot), steps in ((first, -1), (second, 1)):
        at_doublet = doublet[owner] & (stars.corner_after(polygon, slot, steps) == vertex[owner])
        entries.append(np.flatnonzero(at_doublet))
    owner = first[0][entries[0]]
    (one, i), (other, k) = (first[1][entries[0]], first[2][entries[0]]), (second[1][entries[1]], second[2][entries[1]])
    triangular = stars.rows[one, 3] < 0, stars.rows[other, 3] < 0
    far = stars.corner_after(one, i, -2)
    rows = np.stack([merged[owner], stars.corner_after(one, i, 1), far, stars.corner_after(other, k, -1)], axis=1)
    rows[triangular[1], 3] = -1
    rows[triangular[0], 1:] = np.stack([far, rows[:, 3], np.full(len(far), -1)], axis=1)[triangular[0]]
    return rows, owner, (entries[0], entries[1])
