"""Layouts with fewer patches: polygons merged for as long as what is left is shaped well enough to be fitted.

A layout's patches are given by where its octree had to be fine: near necks, in 2:1 transitions, and in triangles, which count
three. Merging takes vertices into others (`changes`): along a diagonal of a quadrilateral, along a side of a triangle, or along
a strip of quadrilaterals between triangles or sides on the box. In every round the changes that leave the best polygons are made
wherever they are out of each other's way, the vertices near them are relaxed on the surface, and those after which a polygon is
worse than the limits, and worse than before, are taken back.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.fields.field import Field
from tpmscad.levelset.quadmesh.dual_mesh import QuadMesh
from tpmscad.levelset.quadmesh.quality import corner_distortion, interior_distortion, max_corner_distortion
from tpmscad.levelset.quadmesh.simplification.collapse_candidates import Candidates, rank_candidates
from tpmscad.levelset.quadmesh.simplification.polygon_mesh import AppliedEdit, MeshEdit, PolygonMesh, extract_mesh
from tpmscad.levelset.quadmesh.simplification.strip_collapses import CollapseSeed, plan_edit
from tpmscad.levelset.quadmesh.simplification.vertex_stars import SurfaceVertices, segment_max
from tpmscad.levelset.quadmesh.smoothing import smooth_vertices
from tpmscad.levelset.quadmesh.vectors import next_corner, normalize

SWEEPS_PER_ROUND, FINAL_SWEEPS = 5, 60
"""Sweeps of the relaxation after a round, and of all vertices in the end. Ten in a round left as many patches."""

MAX_REQUEUES, MAX_ROUNDS_PER_QUEUE = 10, 4
"""Times that polygons are looked at again whose surroundings have moved, and rounds from one to the next."""


@dataclass(frozen=True, slots=True, eq=False)
class SimplifiedMesh:
    """A mesh, and how it came about.

    `of` (V',): which of the original's vertices the mesh's are, and `numbers` (Q,) which of the `polygons`. `history`: the
    changes made, in order; polygons numbered below the original's count are the original's, row by row.
    """

    mesh: QuadMesh
    of: IntArray
    numbers: IntArray
    polygons: PolygonMesh
    history: tuple[AppliedEdit, ...]


def simplify_mesh(mesh: QuadMesh, field: Field, lo: Array, hi: Array) -> SimplifiedMesh:
    """The mesh with polygons merged."""
    work = _Simplification(mesh, field, lo, hi)
    for _ in range(MAX_REQUEUES):
        for _ in range(MAX_ROUNDS_PER_QUEUE):
            if not work.round():
                break
        if not work.refreshed():
            break
    polygons = work.polygons
    numbers = sorted(polygons.polygon)
    small, of = extract_mesh(polygons, work.vertices, work.size(polygons.rows[numbers]), numbers)
    last = smooth_vertices(small, np.ones(len(of), bool), field, lo, hi, FINAL_SWEEPS)
    best = last if max_corner_distortion(last, field) <= max(1.0, max_corner_distortion(small, field)) else small
    return SimplifiedMesh(best, of, np.array(numbers, np.int64), polygons, tuple(work.history))


EditNeighbourhood = tuple[MeshEdit, set[int]]
"""A change with the vertices that are relaxed with it."""


class _Simplification:
    """A mesh in the course of its simplification."""

    def __init__(self, mesh: QuadMesh, field: Field, lo: Array, hi: Array) -> None:
        self.field, self.lo, self.hi = field, lo, hi
        self.polygons = PolygonMesh(mesh)
        self.vertices, self.fixed = mesh.vertices.copy(), mesh.fixed
        self.leaf = mesh.size.copy()
        self.normals = normalize(field.gradient(self.vertices))
        self.known = Candidates.none()
        self.dirty = set(self.polygons.polygon)
        self.stale: set[int] = set()
        self.history: list[AppliedEdit] = []

    def refreshed(self) -> bool:
        """Polygons whose surroundings have moved are looked at once more; whether there are any."""
        self.dirty |= self.stale
        self.stale = set()
        return bool(self.dirty)

    def round(self) -> int:
        """One round of changes; how many were tried."""
        alive = np.flatnonzero(self.polygons.rows[:, 0] >= 0)
        dirty = np.array(sorted(self.dirty.intersection(self.polygons.polygon)), np.int64)
        self.dirty = set()
        surface = SurfaceVertices(self.field, self.vertices, self.normals, self.fixed)
        self.known = self.known.drop_stale(alive, dirty).combine(rank_candidates(self.polygons, surface, dirty))
        places, chosen, impossible = self._chosen()
        if not chosen:
            return 0
        kept = self._tried(chosen)
        self.known = self.known.drop_indices(impossible + [k for k, fine in zip(places, kept, strict=True) if not fine])
        return len(chosen)

    def _chosen(self) -> tuple[list[int], list[EditNeighbourhood], list[int]]:
        """The best of the known changes that are out of each other's way: their places, and they with the vertices near them;
        and the places of those that have turned out impossible."""
        polygons, known = self.polygons, self.known
        taken: set[int] = set()
        places: list[int] = []
        chosen: list[EditNeighbourhood] = []
        impossible: list[int] = []
        goes, stays, number = known.goes.tolist(), known.stays.tolist(), known.number.tolist()
        for k in known.order().tolist():
            v, w = goes[k], stays[k]
            if v in taken or w in taken or not taken.isdisjoint(polygons.polygon[number[k]]):
                continue
            start = known.start[k] or CollapseSeed(((v, w),), (number[k],))
            ends = {v for pair in start.into for v in pair}
            beside = {f for v in ends for f in polygons.around[v]}.union(start.removed)
            if any(not taken.isdisjoint(polygons.polygon.get(f, ())) for f in beside):
                continue
            change = plan_edit(polygons, start)
            if change is None:
                impossible.append(k)
                continue
            free = self._near(change)
            if not taken.isdisjoint(free):
                continue
            taken |= free
            places.append(k)
            chosen.append((change, free))
        return places, chosen, impossible

    def _near(self, change: MeshEdit) -> set[int]:
        """The vertices that are relaxed with a change: its own, and those round what its vertices go into."""
        free = change.vertices
        for v in set(change.into.values()):
            for f in self.polygons.around[v]:
                free.update(self.polygons.polygon[f])
        return free

    def _tried(self, chosen: Sequence[EditNeighbourhood]) -> BoolArray:
        """Make these changes, and take back those that leave polygons too bad; which of them (n,) are kept."""
        polygons, before = self.polygons, self.vertices.copy()
        old_normals = self.normals.copy()
        owner = np.full(len(before), -1)
        for i, (_, near) in enumerate(chosen):
            owner[list(near)] = i
        count = len(chosen)
        numbers, rows, which = self._touched(owner)
        was = segment_max(self._bad(rows)[which[0]], which[1], count)
        done: list[AppliedEdit] = []
        for change, _ in chosen:
            kept = {f: polygons.polygon[f] for f in change.old}
            planes = polygons.box_sides(change.old)
            for v, w in change.into.items():
                if polygons.fixed[v] == polygons.fixed[w]:
                    self.vertices[w] = 0.5 * (self.vertices[v] + self.vertices[w])
            done.append(AppliedEdit(change, polygons.apply(change), kept, planes))
        numbers, rows, which = self._touched(owner)
        part, of = extract_mesh(polygons, self.vertices, self.size(rows), numbers)
        free = owner[of] >= 0
        relaxed = smooth_vertices(part, free, self.field, self.lo, self.hi, SWEEPS_PER_ROUND, self.normals[of])
        self.vertices[of] = relaxed.vertices
        self.normals[of[free]] = normalize(self.field.gradient(relaxed.vertices[free]))
        fine = segment_max(self._bad(rows)[which[0]], which[1], count) <= np.maximum(1.0, was)
        polygon, by = which[0][fine[which[1]]], which[1][fine[which[1]]]
        seen, place = np.unique(polygon, return_inverse=True)
        missed = interior_distortion(self.field, self.vertices, self.normals, self.fixed, rows[seen])
        fine &= segment_max(missed[place.ravel()], by, count) <= np.maximum(1.0, was)
        for i, undo in enumerate(done):
            change = undo.change
            if fine[i]:
                self.dirty.update(f for v in change.into.values() for f in polygons.around[v])
                self.dirty.update(undo.numbers)
                self.history.append(undo)
                continue
            polygons.undo(change, undo.numbers, undo.old, undo.plane)
        undone = np.flatnonzero(~fine[owner] & (owner >= 0))
        self.vertices[undone], self.normals[undone] = before[undone], old_normals[undone]
        self.stale.update(numbers[which[0][fine[which[1]]]].tolist())
        return fine

    def _touched(self, owner: IntArray) -> tuple[IntArray, IntArray, tuple[IntArray, IntArray]]:
        """Polygons with a corner that has an owner: their numbers, their corners, and which of them belong to which owner."""
        numbers = np.flatnonzero(self.polygons.rows[:, 0] >= 0)
        rows = self.polygons.rows[numbers]
        by = np.where(rows >= 0, owner[rows], -1)
        touched = (by >= 0).any(axis=1)
        numbers, rows, by = numbers[touched], rows[touched], by[touched]
        q, i = np.nonzero(by >= 0)
        return numbers, rows, (q, by[q, i])

    def size(self, rows: IntArray) -> Array:
        """A length for each vertex: of its leaf, or of its shortest side in these polygons where that has become longer."""
        start, end = rows[rows >= 0], next_corner(rows)[rows >= 0]
        long = np.linalg.norm(self.vertices[start] - self.vertices[end], axis=1)
        shortest = np.full(len(self.vertices), np.inf)
        np.minimum.at(shortest, np.concatenate([start, end]), np.concatenate([long, long]))
        return np.maximum(self.leaf, np.where(np.isfinite(shortest), shortest, 0.0))

    def _bad(self, rows: IntArray) -> Array:
        return corner_distortion(self.vertices, self.normals, self.fixed, rows)
