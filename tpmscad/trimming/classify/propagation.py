"""Propagation of an in/out classification over linked items: votes are cast for some items and hold for connected ones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad._typing import BoolArray, IntArray
from tpmscad.brep.linked_items import label_linked


@dataclass(frozen=True, slots=True, eq=False)
class InsideVotes:
    """Votes for in (column 1) and out (column 0) of components: `component` (n,) of each item, `count` (components, 2)."""

    component: IntArray
    count: IntArray

    @classmethod
    def of_links(cls, n: int, links: IntArray) -> InsideVotes:
        """No votes yet, for n items joined by `links` (L, 2)."""
        component = label_linked(n, links)
        return cls(component, np.zeros((int(component.max(initial=-1)) + 1, 2), np.int64))

    def add(self, item: int, inside: bool) -> None:
        """Cast a vote for the component of an item."""
        self.count[self.component[item], int(inside)] += 1

    def find_contradiction(self) -> int | None:
        """The first item of a component with votes for both, or None."""
        torn = np.flatnonzero(self.count.all(axis=1))
        return int(np.flatnonzero(self.component == torn[0])[0]) if len(torn) else None

    def undecided_components(self) -> IntArray:
        """The components without a vote."""
        return np.flatnonzero(~self.count.any(axis=1))

    def inside(self) -> BoolArray:
        """Items whose component has votes for in: (n,)."""
        return self.count[self.component, 1] > 0
