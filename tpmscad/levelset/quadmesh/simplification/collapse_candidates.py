"""Candidate collapses of a mesh, ranked by the shape of the polygons that they leave and the patches that they save."""

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

SCORE_PER_SAVED_PATCH = 0.05
"""Reward for each saved patch, in units of distortion."""

SCORE_RESOLUTION = 1e-6
"""Scores are ranked in steps of this. Images of one collapse under a symmetry of the level set differ by round-off only, which
must not decide which of them comes first."""


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """n candidate collapses; a lower score is better.

    `polygon` (n,): the polygon from which the collapse starts. `removed`, `kept` (n,): the ends of its diagonal, or of another
    collapse two vertices that it touches. `seed`: the seed of a strip or edge collapse, None for a diagonal.
    """

    polygon: IntArray
    removed: IntArray
    kept: IntArray
    score: Array
    seed: tuple[CollapseSeed | None, ...]

    @staticmethod
    def empty() -> Candidates:
        """No candidates."""
        no_rows = np.zeros(0, np.int64)
        return Candidates(no_rows, no_rows, no_rows, np.zeros(0), ())

    def ranking(self) -> IntArray:
        """Indices from the best to the worst score; ties are broken by the numbers involved."""
        return np.lexsort((self.kept, self.removed, self.polygon, np.rint(self.score / SCORE_RESOLUTION)))

    def select(self, mask: BoolArray) -> Candidates:
        """The candidates where `mask` (n,) is true."""
        rows = np.flatnonzero(mask)
        seed = tuple(self.seed[k] for k in rows.tolist())
        return Candidates(self.polygon[rows], self.removed[rows], self.kept[rows], self.score[rows], seed)

    def drop_indices(self, indices: Sequence[int]) -> Candidates:
        """All candidates except those of these indices."""
        mask = np.ones(len(self.polygon), bool)
        mask[list(indices)] = False
        return self.select(mask)

    def drop_stale(self, alive: IntArray, requeued: IntArray) -> Candidates:
        """The candidates whose polygon is alive and not queued to be rated again."""
        return self.select(np.isin(self.polygon, alive) & ~np.isin(self.polygon, requeued))

    def combine(self, more: Candidates) -> Candidates:
        """These candidates followed by `more`."""
        pairs = ((self.polygon, more.polygon), (self.removed, more.removed), (self.kept, more.kept))
        polygon, removed, kept = (np.concatenate(pair) for pair in pairs)
        return Candidates(polygon, removed, kept, np.concatenate([self.score, more.score]), self.seed + more.seed)


def rank_candidates(
    polygons: PolygonMesh, surface: SurfaceVertices, numbers: IntArray, max_distortion: float
) -> Candidates:
    """The collapses that start from the polygons of these numbers and leave none that is distorted beyond `max_distortion`."""
    if not len(numbers):
        return Candidates.empty()
    stars = build_vertex_stars(polygons.rows, len(surface.vertices))
    found = rate_diagonal_collapses(stars, surface, numbers)
    score = found.distortion - SCORE_PER_SAVED_PATCH * found.patches_saved
    diagonals = Candidates(found.polygon, found.removed, found.kept, score, (None,) * len(score)).select(
        found.distortion <= max_distortion
    )
    on_box, rows = np.asarray(surface.fixed.any(axis=1)), polygons.rows[numbers]
    has_box_side = (on_box[rows] & on_box[np.roll(rows, -1, axis=1)]).any(axis=1)
    starts = numbers[(rows[:, 3] < 0) | has_box_side]
    seeds = {seed: number for number in starts.tolist() for seed in find_strip_seeds(polygons, number)}
    if not seeds:
        return diagonals
    touched = np.array([seed.merges[0] if seed.merges else seed.shared_edge for seed in seeds])
    distortion, saved = rate_strip_collapses(stars, surface, list(seeds))
    score = distortion - SCORE_PER_SAVED_PATCH * saved
    strips = Candidates(np.array(list(seeds.values())), touched[:, 0], touched[:, 1], score, tuple(seeds))
    return diagonals.combine(strips.select(distortion <= max_distortion))
