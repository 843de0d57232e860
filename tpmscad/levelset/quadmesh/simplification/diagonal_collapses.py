"""The diagonals of a layout's quadrilaterals that may be collapsed, found and rated all at once.

What is found is possible as far as the polygons round the diagonal's ends tell; `Polygons.collapsed` has the last word.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.levelset.quadmesh.quality import corner_distortion
from tpmscad.levelset.quadmesh.simplification.polygon_mesh import MAX_VALENCE, MIN_VALENCE
from tpmscad.levelset.quadmesh.simplification.vertex_stars import SurfaceVertices, VertexStars, segment_max


@dataclass(frozen=True, slots=True, eq=False)
class DiagonalCollapses:
    """Quadrilaterals by number (n,), the corner that goes and that it goes into, how bad the worst polygon becomes, and the
    patches saved."""

    number: IntArray
    goes: IntArray
    stays: IntArray
    bad: Array
    saved: IntArray


@dataclass(frozen=True, slots=True, eq=False)
class _CollapsibleQuads:
    """Quadrilaterals (n,) from the corner that goes on, counter-clockwise (4, n); whether the second and the last lie inside
    with two polygons beside, which then become one (2, n)."""

    number: IntArray
    corner: IntArray
    odd: BoolArray

    def kept(self, mask: BoolArray) -> _CollapsibleQuads:
        return _CollapsibleQuads(self.number[mask], self.corner[:, mask], self.odd[:, mask])


def rate_diagonal_collapses(stars: VertexStars, surface: SurfaceVertices, numbers: IntArray) -> DiagonalCollapses:
    """The diagonals of the quadrilaterals among the polygons of these numbers."""
    quads = _find_feasible_diagonals(stars, surface, numbers)
    goes, stays, count = quads.corner[0], quads.corner[2], len(quads.number)
    merged = len(surface.vertices) + np.arange(count)
    ends = [_other_polygons_at_corner(stars, quads, i) for i in (0, 2)]
    rows, owners, whole = [], [], np.ones(count, bool)
    used = [np.zeros(len(owner), bool) for owner, _, _ in ends]
    for middle, first, second in ((1, 0, 1), (3, 1, 0)):
        row, owner, at = _merge_doublet_polygons(stars, quads, middle, ends[first], ends[second], merged)
        whole[owner[row[:, 2] < 0]] = False
        used[first][at[0]] = used[second][at[1]] = True
        rows.append(row)
        owners.append(owner)
    for vertex, (owner, polygon, _), gone in zip((goes, stays), ends, used, strict=True):
        owner, polygon = owner[~gone], polygon[~gone]
        row = stars.rows[polygon]
        rows.append(np.where(row == vertex[owner][:, None], merged[owner][:, None], row))
        owners.append(owner)
    there = surface.append_merged_vertices(goes, stays)
    each, owner = np.concatenate(rows), np.concatenate(owners)
    fine = whole[owner]
    bad = corner_distortion(there.vertices, there.normals, there.fixed, each[fine])
    worst = np.where(whole, segment_max(bad, owner[fine], count), np.inf)
    return DiagonalCollapses(quads.number, goes, stays, worst, 1 + quads.odd.sum(axis=0))


def _find_feasible_diagonals(stars: VertexStars, surface: SurfaceVertices, numbers: IntArray) -> _CollapsibleQuads:
    """Diagonals whose collapse leaves a surface without two sides between the same vertices, and no more sides at a vertex
    than are wanted."""
    held, count = surface.fixed.sum(axis=1), stars.count
    numbers = numbers[stars.rows[numbers, 3] >= 0]
    number, slot = np.repeat(numbers, 2), np.tile([0, 1], len(numbers))
    a, c = stars.rows[number, slot], stars.rows[number, slot + 2]
    slot = np.where((held[c] > held[a]) | ((held[c] == held[a]) & (c > a)), slot, slot + 2)
    corner = np.stack([stars.rows[number, (slot + k) % 4] for k in range(4)])
    goes, stays, sides = corner[0], corner[2], corner[1::2]
    odd = (held[sides] == 0) & (count[sides] == MIN_VALENCE)
    left = count[goes] + count[stays] - 2 - odd.sum(axis=0)
    fine = (held[goes] == 0) & (left <= MAX_VALENCE) & ((left >= MIN_VALENCE) | (held[stays] > 0))
    quads = _CollapsibleQuads(number, corner, odd).kept(fine)
    owner, polygon, slot = _other_polygons_at_corner(stars, quads, 0)
    _, second, other, last = quads.corner[:, owner]
    after = stars.beside(polygon, slot, 1)
    twice = stars.joined(after, other) & (after != second) & (after != last)
    twice |= (stars.rows[polygon] == other[:, None]).any(axis=1)
    fine = np.ones(len(quads.number), bool)
    fine[owner[twice]] = False
    return quads.kept(fine)


def _other_polygons_at_corner(
    stars: VertexStars, quads: _CollapsibleQuads, corner: int
) -> tuple[IntArray, IntArray, IntArray]:
    """The other polygons at this corner of quadrilaterals: of which it is, their numbers, and their corners there, (m,)."""
    owner, polygon, slot = stars.around(quads.corner[corner])
    other = polygon != quads.number[owner]
    return owner[other], polygon[other], slot[other]


CornerPolygons = tuple[IntArray, IntArray, IntArray]


def _merge_doublet_polygons(
    stars: VertexStars,
    quads: _CollapsibleQuads,
    middle: int,
    first: CornerPolygons,
    second: CornerPolygons,
    merged: IntArray,
) -> tuple[IntArray, IntArray, tuple[IntArray, IntArray]]:
    """The polygons (n, 4) that come of the two left at an odd corner `middle`, with a -1 third where that is none; of which
    quadrilaterals (n,); and which they were of those beside the ends before and behind, (n,) each."""
    odd = quads.odd[middle // 2]
    here = quads.corner[middle]
    at = []
    for (owner, polygon, slot), steps in ((first, -1), (second, 1)):
        at.append(np.flatnonzero(odd[owner] & (stars.beside(polygon, slot, steps) == here[owner])))
    owner = first[0][at[0]]
    (one, i), (other, k) = (first[1][at[0]], first[2][at[0]]), (second[1][at[1]], second[2][at[1]])
    three = stars.rows[one, 3] < 0, stars.rows[other, 3] < 0
    far = stars.beside(one, i, -2)
    rows = np.stack([merged[owner], stars.beside(one, i, 1), far, stars.beside(other, k, -1)], axis=1)
    rows[three[1], 3] = -1
    rows[three[0], 1:] = np.stack([far, rows[:, 3], np.full(len(far), -1)], axis=1)[three[0]]
    return rows, owner, (at[0], at[1])
