"""Changes of a layout with how good the polygons would be that they leave."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tpmscad.patches.levelset.layout.changes import sideways
from tpmscad.patches.levelset.layout.collapse import Change, Polygons
from tpmscad.patches.levelset.layout.diagonals import diagonals
from tpmscad.patches.levelset.layout.merged import Surface
from tpmscad.patches.levelset.layout.octree import Array, Ints, Mask
from tpmscad.patches.levelset.layout.shape import badness
from tpmscad.patches.levelset.layout.stars import most, stars

BEFORE = 1.25
"""Changes are tried that are worse than the limits by this before vertices are relaxed."""

PATCH = 0.05
"""What a patch less counts, in the same measure."""


@dataclass(frozen=True, slots=True, eq=False)
class Rated:
    """Changes (n,) by the number of the polygon they start from, the better the lower their score. `change` is None for
    diagonals of that polygon, from the vertex that goes to that which stays; for others these are any two that they touch."""

    number: Ints
    goes: Ints
    stays: Ints
    score: Array
    change: tuple[Change | None, ...]

    @staticmethod
    def none() -> Rated:
        empty = np.zeros(0, np.int64)
        return Rated(empty, empty, empty, np.zeros(0), ())

    def order(self) -> Ints:
        """From the best to the worst."""
        return np.lexsort((self.stays, self.goes, self.number, self.score))

    def kept(self, mask: Mask) -> Rated:
        at = np.flatnonzero(mask)
        change = tuple(self.change[k] for k in at.tolist())
        return Rated(self.number[at], self.goes[at], self.stays[at], self.score[at], change)

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
        return Rated(number, goes, stays, np.concatenate([self.score, more.score]), self.change + more.change)


def rated(polygons: Polygons, surface: Surface, numbers: Ints, locked: Mask) -> Rated:
    """The changes that start from the polygons of these numbers."""
    if not len(numbers):
        return Rated.none()
    found = diagonals(stars(polygons.rows, len(surface.vertices)), surface, numbers, locked)
    score = found.bad - PATCH * found.saved
    across = Rated(found.number, found.goes, found.stays, score, (None,) * len(score)).kept(found.bad <= BEFORE)
    return across.with_more(_sideways(polygons, surface, numbers))


def _sideways(polygons: Polygons, surface: Surface, numbers: Ints) -> Rated:
    held = np.asarray(surface.fixed.any(axis=1))
    rows = polygons.rows[numbers]
    starting = numbers[(rows[:, 3] < 0) | ((held[rows] & held[np.roll(rows, -1, axis=1)]).any(axis=1))]
    found = [(number, change) for number in starting.tolist() for change in sideways(polygons, number)]
    if not found:
        return Rated.none()
    pairs = [(v, w) for _, change in found for v, w in change.into.items()]
    goes, stays = np.array(pairs, np.int64).reshape(-1, 2).T
    there = surface.with_merged(goes, stays)
    rows_after, owner = [], []
    first = len(surface.vertices)
    for i, (_, change) in enumerate(found):
        own = dict(zip(change.into.values(), range(first, first + len(change.into)), strict=True))
        first += len(change.into)
        around = {f for w in own for f in polygons.around[w]}.difference(change.old)
        for polygon in [*change.new, *(polygons.polygon[f] for f in sorted(around))]:
            row = [own.get(v, v) for v in polygon]
            rows_after.append(row if len(row) == 4 else [*row, -1])
            owner.append(i)
    corners = np.array(rows_after, np.int64)
    bad = most(badness(there.vertices, there.normals, there.fixed, corners), np.array(owner), len(found))
    score = bad - PATCH * np.array([change.saved for _, change in found])
    touched = np.array([next(iter(change.into.items()), change.new[0][:2]) for _, change in found])
    number = np.array([number for number, _ in found])
    all_changes = tuple(change for _, change in found)
    return Rated(number, touched[:, 0], touched[:, 1], score, all_changes).kept(bad <= BEFORE)
