"""Layouts with fewer patches: polygons merged for as long as what is left is shaped well enough to be fitted.

A layout's patches are given by where its octree had to be fine: near necks, in 2:1 transitions, and in triangles, which count
three. Merging takes vertices into others (`collapse`): along a diagonal of a quadrilateral, along a side of a triangle, or along
a strip of quadrilaterals from one triangle to another, which leaves neither. In every round the changes that leave the best
polygons are made wherever they are out of each other's way, the vertices near them are relaxed on the surface, and those after
which a polygon is worse than the limits, and worse than before, are taken back.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from tpmscad.fields.field import Field
from tpmscad.patches.layout.collapse import Change, Polygon, Polygons, mesh_of
from tpmscad.patches.layout.dual import Mesh
from tpmscad.patches.layout.octree import Array, Ints, Mask
from tpmscad.patches.layout.relax import corner_sines, onto, settled

SINE, TILT, TURN = 0.42, 0.8, -0.3
"""Polygons are wanted with corners of at least this sine, sides and diagonals that leave the surface by at most this sine, and
normals at the corners with at least this cosine. Of 12,000 patches of nine uniform layouts of blends with a least sine above 0.4
and a turning below 90 degrees 98 % were fitted within tol at degree 5; of those with a sine of 0.1 to 0.2, 80 %."""

BEFORE = 1.25
"""Changes are tried that are worse than the limits by this before vertices are relaxed."""

SWEEPS, LAST, ROUNDS, BETWEEN = 10, 60, 10, 4
STRIP = 8
"""Quadrilaterals of the longest strips that are collapsed."""


@dataclass(frozen=True, slots=True, eq=False)
class Simplified:
    """A mesh, and which of its vertices each of the original's went into (V,)."""

    mesh: Mesh
    into: Ints


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
    small, of = mesh_of(polygons, work.vertices, work.size(), sorted(polygons.polygon))
    into = work.into
    while (into != into[into]).any():
        into = into[into]
    into = np.searchsorted(of, into)
    free = np.ones(len(of), bool)
    free[into[work.locked]] = False
    last = settled(small, free, field, lo, hi, LAST)
    return Simplified(last if _worst(last, field) <= max(1.0, _worst(small, field)) else small, into)


class _Work:
    """A mesh in the course of its simplification."""

    def __init__(self, mesh: Mesh, field: Field, lo: Array, hi: Array, locked: Mask) -> None:
        self.field, self.lo, self.hi, self.locked = field, lo, hi, locked
        self.polygons = Polygons(mesh, locked)
        self.vertices, self.fixed = mesh.vertices.copy(), mesh.fixed
        self.leaf = mesh.size.copy()
        self.normals = _unit(field.gradient(self.vertices))
        self.into = np.arange(len(mesh.vertices))
        self.known: dict[int, list[tuple[float, int, Change]]] = {}
        self.dirty = set(self.polygons.polygon)
        self.stale: set[int] = set()

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
            undo.append((polygons.apply(change), kept, planes))
        free = np.zeros(len(self.vertices), bool)
        for _, _, near in chosen:
            free[list(near)] = True
        free &= ~self.locked
        touched = sorted({f for _, _, near in chosen for v in near for f in polygons.around[v]})
        part, of = mesh_of(polygons, self.vertices, self.size(), touched)
        self.vertices[of] = settled(part, free[of], self.field, self.lo, self.hi, SWEEPS).vertices
        self.normals[of] = _unit(self.field.gradient(self.vertices[of]))
        bad = self._bad(touched)
        kept_count = 0
        for (number, change, near), was, (numbers, old, planes) in zip(chosen, worst_before, undo, strict=True):
            here = {f for v in near for f in polygons.around[v]}
            if max(bad[f] for f in here) <= max(1.0, was):
                kept_count += 1
                self.dirty |= {f for v in change.into.values() for f in polygons.around[v]}.union(numbers)
                self.stale |= here
                continue
            polygons.undo(change, numbers, old, planes)
            for v in change.into | change.dropped:
                self.into[v] = v
            at = list(near)
            self.vertices[at], self.normals[at] = before[at], old_normals[at]
            self.known[number] = [entry for entry in self.known.get(number, []) if entry[2] is not change]
        return kept_count

    def _bad(self, numbers: Iterable[int]) -> dict[int, float]:
        """How bad polygons are, by number."""
        order = sorted(numbers)
        found = badness(self.vertices, self.normals, [self.polygons.polygon[f] for f in order])
        return dict(zip(order, found.tolist(), strict=True))

    def _look(self) -> None:
        """The changes that start from polygons that are new, with how good they would be."""
        polygons = self.polygons
        found: list[tuple[int, Change]] = []
        for number in [f for f in self.known if f not in polygons.polygon]:
            del self.known[number]
        for number in sorted(f for f in self.dirty if f in polygons.polygon):
            self.known[number] = []
            found += [(number, change) for change in self._changes(number)]
        self.dirty = set()
        if not found:
            return
        # where vertices would go, as vertices of their own behind the mesh's
        place: list[dict[int, int]] = []
        points, fixed, reach = [], [], []
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
            normals = np.concatenate([self.normals, _unit(self.field.gradient(new))])
        else:
            vertices, normals = self.vertices, self.normals
        rows: list[Polygon] = []
        owner: list[int] = []
        for i, ((_, change), own) in enumerate(zip(found, place, strict=True)):
            around = {f for w in own for f in polygons.around[w]} - set(change.old)
            for polygon in [*change.new, *(polygons.polygon[f] for f in sorted(around))]:
                rows.append(tuple(own.get(v, v) for v in polygon))
                owner.append(i)
        worst = np.zeros(len(found))
        np.maximum.at(worst, owner, badness(vertices, normals, rows))
        for i in np.flatnonzero(worst <= BEFORE):
            number, change = found[i]
            self.known[number].append((float(worst[i]) - 0.05 * change.saved, len(self.known[number]), change))

    def _changes(self, number: int) -> list[Change]:
        """The changes that start from a polygon."""
        polygons, polygon = self.polygons, self.polygons.polygon[number]
        found: list[Change | None] = []
        if len(polygon) == 4:
            for a, c in ((polygon[0], polygon[2]), (polygon[1], polygon[3])):
                into = self._merging(a, c, False)
                if into is not None:
                    found.append(polygons.collapsed(into, [number]))
        else:
            for i, v in enumerate(polygon):
                u = polygon[i - 1]
                other = polygons.beside.get((v, u), -1)
                if other >= 0 and len(polygons.polygon[other]) == 3:
                    found.append(polygons.joined(number, other, u, v))
                found += self._strips(number, u, v)
        return [change for change in found if change is not None]

    def _strips(self, number: int, u: int, v: int) -> list[Change | None]:
        """Collapses of the side u to v of a triangle and of those opposite, one after another, up to a triangle or the box."""
        polygons = self.polygons
        found: list[Change | None] = []
        into: dict[int, int] = {}
        used: set[int] = set()
        gone = [number]
        for _ in range(STRIP):
            step = self._merging(u, v, (min(u, v), max(u, v)) in polygons.plane)
            if step is None or used & {u, v}:
                break
            used |= {u, v}
            into.update(step)
            other = polygons.beside.get((v, u), -1)
            if other < 0 or other in gone:
                if other < 0:
                    found.append(polygons.collapsed(dict(into), gone))
                break
            corners = polygons.polygon[other]
            if len(corners) == 3:
                found.append(polygons.collapsed(dict(into), [*gone, other]))
                break
            if len(gone) == 1:
                found.append(polygons.collapsed(dict(into), gone))
            gone.append(other)
            i = corners.index(v)
            v, u = corners[i - 1], corners[(i + 2) % 4]
        return found

    def _merging(self, a: int, b: int, on_box: bool) -> dict[int, int] | None:
        """Which of two vertices goes into the other: towards the box and its edges, and along the box only."""
        if self.locked[a] or self.locked[b]:
            return None
        one, other = int(self.fixed[a].sum()), int(self.fixed[b].sum())
        if one and other and (not on_box or one + other == 4):
            return None
        return {a: b} if (other, b) > (one, a) else {b: a}


def _worst(mesh: Mesh, field: Field) -> float:
    rows = [tuple(row if row[3] >= 0 else row[:3]) for row in mesh.corners.tolist()]
    return float(badness(mesh.vertices, _unit(field.gradient(mesh.vertices)), rows).max(initial=0.0))


def badness(vertices: Array, normals: Array, polygons: Sequence[Polygon]) -> Array:
    """How near polygons are to the limits of their shape, (Q,): above 1 beyond them."""
    result = np.zeros(len(polygons))
    count = np.array([len(p) for p in polygons])
    for n in (3, 4):
        at = np.flatnonzero(count == n)
        if not len(at):
            continue
        corners = np.array([polygons[i] for i in at])
        each, points = normals[corners], vertices[corners]
        sine = corner_sines(vertices, corners, normals).min(axis=1)
        turn = (each @ np.swapaxes(each, 1, 2)).min(axis=(1, 2))
        chord = points[:, :, None] - points[:, None]
        length = np.linalg.norm(chord, axis=3)
        tilt = np.abs(np.einsum("qijx,qix->qij", chord, each)) / np.maximum(length, 1e-300)
        result[at] = np.maximum.reduce([(1 - sine) / (1 - SINE), tilt.max(axis=(1, 2)) / TILT, (1 - turn) / (1 - TURN)])
    return result


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-300))
