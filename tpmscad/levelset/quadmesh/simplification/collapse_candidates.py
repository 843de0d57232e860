"""Candidate collapses of a mesh, ranked by the shape of the polygons that they leave and the patches that they save."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tpmscad._compiled_loops import njit_cached
from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.array_table import ArrayTable
from tpmscad.levelset.quadmesh.simplification.collapses import CollapseSeeds, find_seeds, rate_collapses
from tpmscad.levelset.quadmesh.simplification.vertex_stars import SurfaceVertices, VertexStars

SCORE_PER_SAVED_PATCH = 0.05
"""Reward for each saved patch, in units of distortion."""

SCORE_RESOLUTION = 1e-6
"""Scores are ranked in steps of this. Images of one collapse under a symmetry of the level set differ by round-off only, which
must not decide which of them comes first."""


@dataclass(frozen=True, slots=True, eq=False)
class Candidates(ArrayTable):
    """n candidate collapses with their scores (n,); a lower score is better."""

    seeds: CollapseSeeds
    score: Array

    @staticmethod
    def empty() -> Candidates:
        """No candidates."""
        return Candidates(CollapseSeeds.allocate(0), np.zeros(0))

    def ranking(self) -> IntArray:
        """Indices from the best to the worst score; ties are broken by the first polygon and two vertices of a collapse."""
        merge = self.seeds.merges[:, 0]
        one, other = np.where(merge >= 0, merge, self.seeds.shared_edge).T
        return np.lexsort((other, one, self.seeds.removed[:, 0], np.rint(self.score / SCORE_RESOLUTION)))

    def drop_indices(self, indices: Sequence[int]) -> Candidates:
        """All candidates except those of these indices."""
        mask = np.ones(len(self), bool)
        mask[list(indices)] = False
        return self[mask]

    def drop_stale(self, alive: BoolArray, requeued: IntArray) -> Candidates:
        """The candidates whose first polygon is alive, by a mask over the numbers, and not queued to be rated again."""
        kept = alive.copy()
        kept[requeued] = False
        return self[kept[self.seeds.removed[:, 0]]]

    def find_next_free(self, order: IntArray, start: int, stars: VertexStars, is_taken: BoolArray) -> int:
        """The first place from `start` on in `order` of a candidate that changes no polygon at a taken vertex, or its length.

        `is_taken` (V,) marks the vertices.
        """
        return _find_next_free(order, start, stars, is_taken, self.seeds.merges, self.seeds.removed)


def rank_candidates(
    stars: VertexStars, surface: SurfaceVertices, numbers: IntArray, max_distortion: float
) -> Candidates:
    """The collapses that start from the polygons of these numbers and leave none that is distorted beyond `max_distortion`."""
    seeds = find_seeds(stars, surface.fixed.sum(axis=1), numbers)
    if not len(seeds):
        return Candidates.empty()
    distortion, saved = rate_collapses(stars, surface, seeds)
    return Candidates(seeds, distortion - SCORE_PER_SAVED_PATCH * saved)[distortion <= max_distortion]


@njit_cached
def _find_next_free(
    order: IntArray, start: int, stars: VertexStars, is_taken: BoolArray, merges: IntArray, removed: IntArray
) -> int:  # pragma: no cover
    """As `Candidates.find_next_free`."""
    for place in range(start, len(order)):
        if _is_free(stars, is_taken, merges[order[place]], removed[order[place]]):
            return place
    return len(order)


@njit_cached
def _is_free(stars: VertexStars, is_taken: BoolArray, merges: IntArray, removed: IntArray) -> bool:  # pragma: no cover
    """Whether a collapse changes no polygon at a taken vertex; polygons that are gone do not count."""
    for number in removed:
        if number >= 0 and _is_touched(stars, is_taken, number):
            return False
    for pair in merges:
        for v in pair:
            if v >= 0 and not _is_star_free(stars, is_taken, v):
                return False
    return True


@njit_cached
def _is_touched(stars: VertexStars, is_taken: BoolArray, number: int) -> bool:  # pragma: no cover
    """Whether a corner of a polygon is taken; not if the polygon is gone."""
    is_touched = False
    for v in stars.rows[number]:
        is_touched |= v >= 0 and is_taken[v]
    return is_touched


@njit_cached
def _is_star_free(stars: VertexStars, is_taken: BoolArray, vertex: int) -> bool:  # pragma: no cover
    """Whether no polygon round a vertex has a corner that is taken."""
    for entry in range(stars.first[vertex], stars.first[vertex + 1]):
        if _is_touched(stars, is_taken, stars.polygon[entry]):
            return False
    return True
