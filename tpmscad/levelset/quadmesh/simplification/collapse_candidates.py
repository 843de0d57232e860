"""Changes of a layout with how good the polygons would be that they leave."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.levelset.quadmesh.simplification.diagonal_collapses import rate_diagonal_collapses
from tpmscad.levelset.quadmesh.simplification.polygon_mesh import PolygonMesh
from tpmscad.levelset.quadmesh.simplification.strip_collapses import (
    CollapseSeed,
    find_strip_seeds,
    rate_strip_collapses,
)
from tpmscad.levelset.quadmesh.simplification.vertex_stars import SurfaceVertices, build_vertex_stars

MAX_DISTORTION_BEFORE_SMOOTHING = 1.25
"""Changes are tried that are worse than the limits by this before vertices are relaxed."""

SCORE_PER_SAVED_PATCH = 0.05
"""What a patch less counts, in the same measure."""


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """Changes (n,) by the number of the polygon they start from, the better the lower their score. `start` is None for
    diagonals of that polygon, from the vertex that goes to that which stays; of others these are two that they touch."""

    number: IntArray
    goes: IntArray
    stays: IntArray
    score: Array
    start: tuple[CollapseSeed | None, ...]

    @staticmethod
    def none() -> Candidates:
        empty = np.zeros(0, np.int64)
        return Candidates(empty, empty, empty, np.zeros(0), ())

    def order(self) -> IntArray:
        """From the best to the worst."""
        return np.lexsort((self.stays, self.goes, self.number, self.score))

    def kept(self, mask: BoolArray) -> Candidates:
        at = np.flatnonzero(mask)
        start = tuple(self.start[k] for k in at.tolist())
        return Candidates(self.number[at], self.goes[at], self.stays[at], self.score[at], start)

    def drop_indices(self, places: Sequence[int]) -> Candidates:
        """Without those at these places."""
        mask = np.ones(len(self.number), bool)
        mask[list(places)] = False
        return self.kept(mask)

    def drop_stale(self, alive: IntArray, numbers: IntArray) -> Candidates:
        """Without those of other polygons than the ones alive, and those of these numbers."""
        return self.kept(np.isin(self.number, alive) & ~np.isin(self.number, numbers))

    def combine(self, more: Candidates) -> Candidates:
        arrays = ((self.number, more.number), (self.goes, more.goes), (self.stays, more.stays))
        number, goes, stays = (np.concatenate(pair) for pair in arrays)
        return Candidates(number, goes, stays, np.concatenate([self.score, more.score]), self.start + more.start)


def rank_candidates(polygons: PolygonMesh, surface: SurfaceVertices, numbers: IntArray) -> Candidates:
    """The changes that start from the polygons of these numbers."""
    if not len(numbers):
        return Candidates.none()
    around = build_vertex_stars(polygons.rows, len(surface.vertices))
    found = rate_diagonal_collapses(around, surface, numbers)
    score = found.bad - SCORE_PER_SAVED_PATCH * found.saved
    across = Candidates(found.number, found.goes, found.stays, score, (None,) * len(score)).kept(
        found.bad <= MAX_DISTORTION_BEFORE_SMOOTHING
    )
    held, rows = np.asarray(surface.fixed.any(axis=1)), polygons.rows[numbers]
    from_sides = numbers[(rows[:, 3] < 0) | ((held[rows] & held[np.roll(rows, -1, axis=1)]).any(axis=1))]
    starts = {start: number for number in from_sides.tolist() for start in find_strip_seeds(polygons, number)}
    if not starts:
        return across
    touched = np.array([start.into[0] if start.into else start.shared_edge for start in starts])
    bad, saved = rate_strip_collapses(around, surface, list(starts))
    number = np.array(list(starts.values()))
    along = Candidates(number, touched[:, 0], touched[:, 1], bad - SCORE_PER_SAVED_PATCH * saved, tuple(starts))
    return across.combine(along.kept(bad <= MAX_DISTORTION_BEFORE_SMOOTHING))
