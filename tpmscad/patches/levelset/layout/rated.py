"""Changes of a layout with how good the polygons would be that they leave."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tpmscad.patches.levelset.layout.changes import Start, sideways
from tpmscad.patches.levelset.layout.collapse import Polygons
from tpmscad.patches.levelset.layout.diagonals import diagonals
from tpmscad.patches.levelset.layout.merged import Surface
from tpmscad.patches.levelset.layout.octree import Array, Ints, Mask
from tpmscad.patches.levelset.layout.stars import stars
from tpmscad.patches.levelset.layout.strips import rated_starts

BEFORE = 1.25
"""Changes are tried that are worse than the limits by this before vertices are relaxed."""

PATCH = 0.05
"""What a patch less counts, in the same measure."""


@dataclass(frozen=True, slots=True, eq=False)
class Rated:
    """Changes (n,) by the number of the polygon they start from, the better the lower their score. `start` is None for
    diagonals of that polygon, from the vertex that goes to that which stays; of others these are two that they touch."""

    number: Ints
    goes: Ints
    stays: Ints
    score: Array
    start: tuple[Start | None, ...]

    @staticmethod
    def none() -> Rated:
        empty = np.zeros(0, np.int64)
        return Rated(empty, empty, empty, np.zeros(0), ())

    def order(self) -> Ints:
        """From the best to the worst."""
        return np.lexsort((self.stays, self.goes, self.number, self.score))

    def kept(self, mask: Mask) -> Rated:
        at = np.flatnonzero(mask)
        start = tuple(self.start[k] for k in at.tolist())
        return Rated(self.number[at], self.goes[at], self.stays[at], self.score[at], start)

    def but(self, places: Sequence[int]) -> Rated:
        """Without those at these places."""
        mask = np.ones(len(self.number), bool)
        mask[list(places)] = False
        return self.kept(mask)

    def without(self, alive: Ints, numbers: Ints) -> Rated:
        """Without those of other polygons than the ones alive, and those of these numbers."""
        return self.kept(np.isin(self.number, alive) & ~np.isin(self.number, numbers))

    def with_more(self, more: Rated) -> Rated:
        arrays = ((self.number, more.number), (self.goes, more.goes), (self.stays, more.stays))
        number, goes, stays = (np.concatenate(pair) for pair in arrays)
        return Rated(number, goes, stays, np.concatenate([self.score, more.score]), self.start + more.start)


def rated(polygons: Polygons, surface: Surface, numbers: Ints) -> Rated:
    """The changes that start from the polygons of these numbers."""
    if not len(numbers):
        return Rated.none()
    around = stars(polygons.rows, len(surface.vertices))
    found = diagonals(around, surface, numbers)
    score = found.bad - PATCH * found.saved
    across = Rated(found.number, found.goes, found.stays, score, (None,) * len(score)).kept(found.bad <= BEFORE)
    held, rows = np.asarray(surface.fixed.any(axis=1)), polygons.rows[numbers]
    from_sides = numbers[(rows[:, 3] < 0) | ((held[rows] & held[np.roll(rows, -1, axis=1)]).any(axis=1))]
    starts = {start: number for number in from_sides.tolist() for start in sideways(polygons, number)}
    if not starts:
        return across
    touched = np.array([start.into[0] if start.into else start.joint for start in starts])
    bad, saved = rated_starts(around, surface, list(starts))
    number = np.array(list(starts.values()))
    along = Rated(number, touched[:, 0], touched[:, 1], bad - PATCH * saved, tuple(starts))
    return across.with_more(along.kept(bad <= BEFORE))
