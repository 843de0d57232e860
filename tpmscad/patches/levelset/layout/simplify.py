"""Layouts with fewer patches: polygons merged for as long as what is left is shaped well enough to be fitted.

A layout's patches are given by where its octree had to be fine: near necks, in 2:1 transitions, and in triangles, which count
three. Merging takes vertices into others (`changes`): along a diagonal of a quadrilateral, along a side of a triangle, or along
a strip of quadrilaterals between triangles or sides on the box. In every round the changes that leave the best polygons are made
wherever they are out of each other's way, the vertices near them are relaxed on the surface, and those after which a polygon is
worse than the limits, and worse than before, are taken back.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from tpmscad.fields.field import Field
from tpmscad.patches.levelset.layout.changes import changes
from tpmscad.patches.levelset.layout.collapse import Change, Made, Polygon, Polygons, mesh_of
from tpmscad.patches.levelset.layout.dual import Mesh
from tpmscad.patches.levelset.layout.octree import Array, Ints, Mask
from tpmscad.patches.levelset.layout.relax import onto, settled
from tpmscad.patches.levelset.layout.shape import badness, between, worst
from tpmscad.patches.levelset.layout.vectors import unit

BEFORE = 1.25
"""Changes are tried that are worse than the limits by this before vertices are relaxed."""

SWEEPS, LAST = 10, 60
"""Sweeps of the relaxation after a round, and of all that is not locked in the end."""

ROUNDS, BETWEEN = 10, 4
"""Times that polygons are looked at again whose surroundings have moved, and rounds from one to the next."""


@dataclass(frozen=True, slots=True, eq=False)
class Simplified:
    """A mesh, and which of its vertices each of the original's went into (V,).

    `of` (V',): which of the original's vertices the mesh's are, and `numbers` (Q,) which of the `polygons`. `history`: the
    changes made, in order; polygons numbered below the original's count are the original's, row by row.
    """

    mesh: Mesh
    into: Ints
    of: Ints
    numbers: Ints
    polygons: Polygons
    history: tuple[Made, ...]


def simplified(mesh: Mesh, field: Field, lo: Array, hi: Array, locked: Mask | None = None) -> Simplified:
    """The mesh with polygons merged; vertices that are `locked` (V,) stay where they are, bit for bit."""
    work = _Work(mesh, field, lo, hi, np.zeros(len(mesh.vertices), bool) if locked is None else locked)
    for _ in range(ROUNDS):
        for _ in range(BETWEEN):
            if not work.round():
                break
        if not work.refreshed():
            break
    polygons = work.polygons
    numbers = sorted(polygons.polygon)
    small, of = mesh_of(polygons, work.vertices, work.size(), numbers)
    into = work.into
    while (into != into[into]).any():
        into = into[into]
    into = np.searchsorted(of, into)
    free = np.ones(len(of), bool)
    free[into[work.locked]] = False
    last = settled(small, free, field, lo, hi, LAST)
    best = last if worst(last, field) <= max(1.0, worst(small, field)) else small
    return Simplified(best, into, of, np.array(numbers, np.int64), polygons, tuple(work.history))


class _Work:
    """A mesh in the course of its simplification."""

    def __init__(self, mesh: Mesh, field: Field, lo: Array, hi: Array, locked: Mask) -> None:
        self.field, self.lo, self.hi, self.locked = field, lo, hi, locked
        self.polygons = Polygons(mesh, locked)
        self.vertices, self.fixed = mesh.vertices.copy(), mesh.fixed
        self.leaf = mesh.size.copy()
        self.normals = unit(field.gradient(self.vertices))
        self.into = np.arange(len(mesh.vertices))
        self.known: dict[int, list[tuple[float, int, Change]]] = {}
        self.dirty = set(self.polygons.polygon)
        self.stale: set[int] = set()
        self.history: list[Made] = []

    def size(self) -> Array:
        """A length for each vertex: of its leaf, or of its shortest side where that has become longer."""
        ends = np.array(list(self.polygons.beside), np.int64)
        shortest = np.full(len(self.vertices), np.inf)
        np.minimum.at(
            shortest, ends[:, 0], np.linalg.norm(self.vertices[ends[:, 0]] - self.vertices[ends[:, 1]], axis=1)
        )
        return np.maximum(self.leaf, np.where(np.isfinite(shortest), shortest, 0.0))

    def refreshed(self) -> bool:
        """Polygons whose surroundings have moved are looked at once more; whether there are any."""
        self.dirty |= self.stale
        self.stale = set()
        return bool(self.dirty)

    def round(self) -> int:
        """One round of changes; how many were kept."""
        self._look()
        taken: set[int] = set()
        chosen: list[tuple[int, Change, set[int]]] = []
        for _, number, k in sorted(
            (score, number, k) for number, found in self.known.items() for k, (score, _, _) in enumerate(found)
        ):
            change = self.known[number][k][2]
            if not (taken.isdisjoint(change.vertices) and self.polygons.possible(change)):
                continue
            free = self._near(change)
            if taken.isdisjoint(free):
                taken |= free
                chosen.append((number, change, free))
        if not chosen:
            return 0
        return self._tried(chosen)

    def _near(self, change: Change) -> set[int]:
        """The vertices that are relaxed with a change: its own, and those round what its vertices go into."""
        free = change.vertices
        for v in set(change.into.values()):
            for f in self.polygons.around[v]:
                free |= set(self.polygons.polygon[f])
        return free

    def _tried(self, chosen: Sequence[tuple[int, Change, set[int]]]) -> int:
        polygons, before = self.polygons, self.vertices.copy()
        old_normals = self.normals.copy()
        undo = []
        beside = [{f for v in free for f in polygons.around[v]} for _, _, free in chosen]
        bad = self._bad({f for here in beside for f in here})
        worst_before = [max(bad[f] for f in here) for here in beside]
        for _, change, _ in chosen:
            kept = {f: polygons.polygon[f] for f in change.old}
            planes = polygons.rims(change.old)
            for v, w in change.into.items():
                if not self.fixed[w].any() or self.fixed[w].sum() == self.fixed[v].sum():
                    self.vertices[w] = 0.5 * (self.vertices[v] + self.vertices[w])
            for v, w in (change.into | change.dropped).items():
                self.into[v] = w
            undo.append(Made(change, polygons.apply(change), kept, planes))
        free = np.zeros(len(self.vertices), bool)
        for _, _, near in chosen:
            free[list(near)] = True
        free &= ~self.locked
        touched = sorted({f for _, _, near in chosen for v in near for f in polygons.around[v]})
        part, of = mesh_of(polygons, self.vertices, self.size(), touched)
        self.vertices[of] = settled(part, free[of], self.field, self.lo, self.hi, SWEEPS).vertices
        self.normals[of] = unit(self.field.gradient(self.vertices[of]))
        bad = self._bad(touched)
        seen = [polygons.polygon[f] for f in touched]
        missed = between(self.field, self.vertices, self.normals, self.fixed, seen)
        bad = {f: max(bad[f], float(m)) for f, m in zip(touched, missed, strict=True)}
        kept_count = 0
        for (number, change, near), was, made in zip(chosen, worst_before, undo, strict=True):
            here = {f for v in near for f in polygons.around[v]}
            if max(bad[f] for f in here) <= max(1.0, was):
                kept_count += 1
                self.dirty |= {f for v in change.into.values() for f in polygons.around[v]}.union(made.numbers)
                self.stale |= here
                self.history.append(made)
                continue
            polygons.undo(change, made.numbers, made.old, made.plane)
            for v in change.into | change.dropped:
                self.into[v] = v
            at = list(near)
            self.vertices[at], self.normals[at] = before[at], old_normals[at]
            self.known[number] = [entry for entry in self.known.get(number, []) if entry[2] is not change]
        return kept_count

    def _bad(self, numbers: Iterable[int]) -> dict[int, float]:
        """How bad polygons are, by number."""
        order = sorted(numbers)
        found = badness(self.vertices, self.normals, self.fixed, [self.polygons.polygon[f] for f in order])
        return dict(zip(order, found.tolist(), strict=True))

    def _look(self) -> None:
        """The changes that start from polygons that are new, with how good they would be."""
        polygons = self.polygons
        found: list[tuple[int, Change]] = []
        for number in [f for f in self.known if f not in polygons.polygon]:
            del self.known[number]
        for number in sorted(f for f in self.dirty if f in polygons.polygon):
            self.known[number] = []
            found += [(number, change) for change in changes(polygons, number)]
        self.dirty = set()
        if not found:
            return
        # where vertices would go, as vertices of their own behind the mesh's
        place: list[dict[int, int]] = []
        points: list[Array] = []
        fixed, reach = [], []
        for _, change in found:
            own: dict[int, int] = {}
            for w in sorted(set(change.into.values())):
                of = [v for v, into in change.into.items() if into == w]
                stays = self.fixed[w].any() and self.fixed[w].sum() > max(self.fixed[v].sum() for v in of)
                own[w] = len(self.vertices) + len(points)
                points.append(self.vertices[w] if stays else self.vertices[[*of, w]].mean(axis=0))
                fixed.append(self.fixed[w])
                reach.append(float(np.linalg.norm(self.vertices[of[0]] - self.vertices[w])) + 1e-300)
            place.append(own)
        if points:
            new = onto(self.field, np.array(points), np.array(fixed), np.array(reach), 4)
            vertices = np.concatenate([self.vertices, new])
            normals = np.concatenate([self.normals, unit(self.field.gradient(new))])
            held = np.concatenate([self.fixed, np.array(fixed)])
        else:
            vertices, normals, held = self.vertices, self.normals, self.fixed
        rows: list[Polygon] = []
        owner: list[int] = []
        for i, ((_, change), own) in enumerate(zip(found, place, strict=True)):
            around = {f for w in own for f in polygons.around[w]} - set(change.old)
            for polygon in [*change.new, *(polygons.polygon[f] for f in sorted(around))]:
                rows.append(tuple(own.get(v, v) for v in polygon))
                owner.append(i)
        most = np.zeros(len(found))
        np.maximum.at(most, owner, badness(vertices, normals, held, rows))
        for i in np.flatnonzero(most <= BEFORE):
            number, change = found[i]
            self.known[number].append((float(most[i]) - 0.05 * change.saved, len(self.known[number]), change))
