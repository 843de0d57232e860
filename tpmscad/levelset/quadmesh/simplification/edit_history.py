"""A simplified layout in which changes are undone again, here and there, where its patches can't be fitted.

A change can be undone once those are that came after it on the same polygons. What comes back has its vertices where they were
and is relaxed with what is round it; polygons that are asked for again when they have come back keep them.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.fields.field import Field
from tpmscad.levelset.quadmesh.dual_mesh import QuadMesh
from tpmscad.levelset.quadmesh.simplification.greedy_simplification import SimplifiedMesh
from tpmscad.levelset.quadmesh.simplification.polygon_mesh import extract_mesh
from tpmscad.levelset.quadmesh.smoothing import smooth_vertices

RINGS_AROUND_UNDONE, SWEEPS_AFTER_UNDO = 2, 40
"""Polygons round what has come back that are relaxed, and sweeps."""


class EditHistory:
    """The changes of a simplified layout that still stand. It takes over the polygons of what it is made of."""

    def __init__(self, original: QuadMesh, simple: SimplifiedMesh, field: Field, lo: Array, hi: Array) -> None:
        self._original, self._field, self._lo, self._hi = original, field, lo, hi
        self._polygons = simple.polygons
        self._vertices, self._size = original.vertices.copy(), original.size.copy()
        self._vertices[simple.of], self._size[simple.of] = simple.mesh.vertices, simple.mesh.size
        self._made = dict(enumerate(simple.history))
        self._by = {number: i for i, made in self._made.items() for number in made.numbers}
        self._before = {number: i for i, made in self._made.items() for number in made.old}
        self._held = np.zeros(len(original.vertices), bool)

    def mesh(self) -> tuple[QuadMesh, IntArray]:
        """The layout as it is now, and the number of each of its polygons (Q,)."""
        numbers = sorted(self._polygons.polygon)
        return extract_mesh(self._polygons, self._vertices, self._size, numbers)[0], np.array(numbers, np.int64)

    def undo(self, numbers: Iterable[int], levels: int) -> bool:
        """Undo what made the polygons of these numbers, and those within `levels` - 1 of them, and of these that come back as
        often again. False where all of it had come back before, to where it was."""
        polygon, around = self._polygons.polygon, self._polygons.around
        region = {n for n in numbers if n in polygon}
        came_back = {v for n in region if n not in self._by for v in polygon[n]}
        for _ in range(levels - 1):
            region |= {f for n in region for v in polygon[n] for f in around[v]}
        chosen: set[int] = set()
        for _ in range(levels):
            chosen |= self._with_later({self._by[n] for n in region if n in self._by} - chosen)
            region |= {n for i in chosen for n in self._made[i].old}
        while clashing := self._clashing(chosen) - chosen:
            chosen |= self._with_later(clashing)
        for i in sorted(chosen, reverse=True):
            made = self._made.pop(i)
            self._polygons.undo(made.change, made.numbers, made.old, made.plane)
            region |= set(made.old)
            for number in made.numbers:
                del self._by[number]
            for number in made.old:
                del self._before[number]
        back = list({v for n in region if n in polygon for v in polygon[n]})
        hold = [v for v in (came_back if chosen else back) if not any(n in self._by for n in around[v])]
        if not chosen and self._held[hold].all():
            return False
        self._held[hold] = True
        self._vertices[back], self._size[back] = self._original.vertices[back], self._original.size[back]
        self._relax(set(back))
        return True

    def _with_later(self, chosen: Iterable[int]) -> set[int]:
        """Changes with those that came after them on the same polygons."""
        found: set[int] = set()
        ahead = list(chosen)
        while ahead:
            i = ahead.pop()
            if i not in found:
                found.add(i)
                ahead += [self._before[n] for n in self._made[i].numbers if n in self._before]
        return found

    def _clashing(self, chosen: set[int]) -> set[int]:
        """Changes by which sides came about that those of polygons that are to come back would be once more."""
        gone = {n for i in chosen for n in self._made[i].numbers}
        back = {n: polygon for i in chosen for n, polygon in self._made[i].old.items() if n not in gone}
        edges = ((p[k - 1], v) for p in back.values() for k, v in enumerate(p))
        owners = {self._polygons.beside.get(edge, -1) for edge in edges} - gone
        return {self._by[n] for n in owners if n in self._by}

    def _relax(self, near: set[int]) -> None:
        polygon, around = self._polygons.polygon, self._polygons.around
        for _ in range(RINGS_AROUND_UNDONE):
            near = {w for v in near for f in around[v] for w in polygon[f]}
        free = np.zeros(len(self._vertices), bool)
        free[list(near)] = True
        free &= ~self._held
        touched = sorted({f for v in np.flatnonzero(free).tolist() for f in around[v]})
        if touched:
            part, of = extract_mesh(self._polygons, self._vertices, self._size, touched)
            self._vertices[of] = smooth_vertices(
                part, free[of], self._field, self._lo, self._hi, SWEEPS_AFTER_UNDO
            ).vertices
