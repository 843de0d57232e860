"""Candidate collapses of a mesh, ranked by the shape of the polygons that they leave and the patches that they save."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tpmscad._compiled_loops import njit_cached
from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.levelset.quadmesh.simplification.diagonal_collapses import rate_diagonal_collapses
from tpmscad.levelset.quadmesh.simplification.strip_collapses import CollapseSeed, StripSeeds, find_strip_seeds
from tpmscad.levelset.quadmesh.simplification.strip_ratings import rate_strip_collapses
from tpmscad.levelset.quadmesh.simplification.vertex_stars import SurfaceVertices, VertexStars

SCORE_PER_SAVED_PATCH = 0.05
"""Reward for each saved patch, in units of distortion."""

SCORE_RESOLUTION = 1e-6
"""Scores are ranked in steps of this. Images of one collapse under a symmetry of the level set differ by round-off only, which
must not decide which of them comes first."""


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """n candidate collapses; a lower score is better.

    `polygon` (n,): the polygon from which the collapse starts. `removed`, `kept` (n,): the ends of its diagonal, or of another
    collapse two vertices that it touches. `strip` (n,): the row in `strips` of a strip or edge collapse, -1 for a diagonal.
    """

    polygon: IntArray
    removed: IntArray
    kept: IntArray
    score: Array
    strip: IntArray
    strips: StripSeeds

    @staticmethod
    def empty() -> Candidates:
        """No candidates."""
        no_rows = np.zeros(0, np.int64)
        return Candidates(no_rows, no_rows, no_rows, np.zeros(0), no_rows, StripSeeds.allocate(0))

    def __len__(self) -> int:
        return len(self.polygon)

    def seed(self, k: int) -> CollapseSeed:
        """The seed of a candidate."""
        if self.strip[k] >= 0:
            return self.strips.seed(int(self.strip[k]))
        return CollapseSeed(((int(self.removed[k]), int(self.kept[k])),), (int(self.polygon[k]),))

    def ranking(self) -> IntArray:
        """Indices from the best to the worst score; ties are broken by the numbers involved."""
        return np.lexsort((self.kept, self.removed, self.polygon, np.rint(self.score / SCORE_RESOLUTION)))

    def select(self, mask: BoolArray) -> Candidates:
        """The candidates where `mask` (n,) is true."""
        strip = self.strip[mask]
        is_strip = strip >= 0
        strips = self.strips.select(strip[is_strip])
        strip[is_strip] = np.arange(len(strips))
        return Candidates(self.polygon[mask], self.removed[mask], self.kept[mask], self.score[mask], strip, strips)

    def drop_indices(self, indices: Sequence[int]) -> Candidates:
        """All candidates except those of these indices."""
        mask = np.ones(len(self), bool)
        mask[list(indices)] = False
        return self.select(mask)

    def drop_stale(self, alive: BoolArray, requeued: IntArray) -> Candidates:
        """The candidates whose polygon is alive, by a mask over the numbers, and not queued to be rated again."""
        kept = alive.copy()
        kept[requeued] = False
        return self.select(kept[self.polygon])

    def combine(self, more: Candidates) -> Candidates:
        """These candidates followed by `more`."""
        strip = np.where(more.strip < 0, -1, more.strip + len(self.strips))
        return Candidates(
            np.concatenate([self.polygon, more.polygon]),
            np.concatenate([self.removed, more.removed]),
            np.concatenate([self.kept, more.kept]),
            np.concatenate([self.score, more.score]),
            np.concatenate([self.strip, strip]),
            self.strips.combine(more.strips),
        )

    def find_next_free(self, order: IntArray, start: int, stars: VertexStars, is_taken: BoolArray) -> int:
        """The first place from `start` on in `order` of a candidate that changes no polygon at a taken vertex, or its length.

        `is_taken` (V,) marks the vertices.
        """
        strips = self.strips.merges, self.strips.removed
        return _find_next_free(
            order, start, stars, is_taken, self.polygon, self.removed, self.kept, self.strip, *strips
        )


def rank_candidates(
    stars: VertexStars, surface: SurfaceVertices, numbers: IntArray, max_distortion: float
) -> Candidates:
    """The collapses that start from the polygons of these numbers and leave none that is distorted beyond `max_distortion`."""
    if not len(numbers):
        return Candidates.empty()
    found = rate_diagonal_collapses(stars, surface, numbers)
    score = found.distortion - SCORE_PER_SAVED_PATCH * found.patches_saved
    no_strip = np.full(len(score), -1)
    diagonals = Candidates(found.polygon, found.removed, found.kept, score, no_strip, StripSeeds.allocate(0))
    diagonals = diagonals.select(found.distortion <= max_distortion)
    seeds = find_strip_seeds(stars, surface.fixed.sum(axis=1), numbers)
    if not len(seeds):
        return diagonals
    touched = np.where(seeds.merges[:, 0] >= 0, seeds.merges[:, 0], seeds.shared_edge)
    distortion, saved = rate_strip_collapses(stars, surface, seeds)
    score = distortion - SCORE_PER_SAVED_PATCH * saved
    strips = Candidates(seeds.removed[:, 0], touched[:, 0], touched[:, 1], score, np.arange(len(seeds)), seeds)
    return diagonals.combine(strips.select(distortion <= max_distortion))


@njit_cached
def _find_next_free(
    order: IntArray,
    start: int,
    stars: VertexStars,
    is_taken: BoolArray,
    polygon: IntArray,
    removed: IntArray,
    kept: IntArray,
    strip: IntArray,
    merges: IntArray,
    gone: IntArray,
) -> int:  # pragma: no cover
    """As `Candidates.find_next_free`."""
    for place in range(start, len(order)):
        k = order[place]
        if is_taken[removed[k]] or is_taken[kept[k]] or _is_touched(stars, is_taken, polygon[k]):
            continue
        is_free = True
        if strip[k] < 0:
            is_free = _is_star_free(stars, is_taken, removed[k]) and _is_star_free(stars, is_taken, kept[k])
        else:
            for pair in merges[strip[k]]:
                for v in pair:
                    is_free = is_free and (v < 0 or _is_star_free(stars, is_taken, v))
            for number in gone[strip[k]]:
                is_free = is_free and (number < 0 or not _is_touched(stars, is_taken, number))
        if is_free:
            return place
    return len(order)


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
