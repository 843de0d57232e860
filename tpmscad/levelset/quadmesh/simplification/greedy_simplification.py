"""Greedy simplification of a quad mesh: collapses, best first, while all polygons stay well shaped.

The octree has small leaves near necks and in 2:1 transitions, and a triangle becomes three patches, so the dual mesh has more
patches than the surface needs. In every round

1. the polygons whose surroundings changed are rated again for candidate collapses,
2. a maximal set of non-overlapping candidates is selected, best score first,
3. these are applied and the vertices near them smoothed on the level set,
4. an edit is undone if a polygon near it is beyond the limits of `quality` and worse than the worst one before.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.fields.field import Field
from tpmscad.levelset.quadmesh.dual_mesh import QuadMesh
from tpmscad.levelset.quadmesh.quality import corner_distortion, interior_distortion, measure_side_distances
from tpmscad.levelset.quadmesh.simplification.collapse_candidates import Candidates, rank_candidates
from tpmscad.levelset.quadmesh.simplification.collapses import plan_edit
from tpmscad.levelset.quadmesh.simplification.edit_history import EditHistory, RecordedEdit
from tpmscad.levelset.quadmesh.simplification.polygon_mesh import AppliedEdit, MeshEdit, PolygonMesh, extract_mesh
from tpmscad.levelset.quadmesh.simplification.vertex_stars import (
    SurfaceVertices,
    VertexStars,
    build_vertex_stars,
    segment_max,
)
from tpmscad.levelset.quadmesh.smoothing import smooth_vertices
from tpmscad.levelset.quadmesh.vectors import next_corner, normalize

MAX_RATIO_BEFORE_SMOOTHING = 1.25
"""Distortion that a candidate may leave, over the limit: smoothing brings it below in many cases."""

MAX_INTERIOR_DISTORTION = 1.1
"""Greatest distortion by the surface between the corners, which tells more than the corners whether a patch will fold."""

SWEEPS_PER_ROUND = 5
"""Smoothing sweeps near the edits of a round."""

MAX_ROUNDS_PER_QUEUE = 4
MAX_REQUEUES = 10
"""Rounds before the polygons whose surroundings moved are rated again, and how often that is done."""


def simplify_mesh(
    mesh: QuadMesh,
    field: Field,
    lo: Array,
    hi: Array,
    max_distortion: float = 1.0,
    max_side_distance: float = math.inf,
) -> EditHistory:
    """The edits that merge polygons of a mesh of {field = 0} in the box [lo, hi], whose mesh is the simplified one.

    The distortion of merged polygons is at most `max_distortion`, and their cubic sides are at most `max_side_distance` from the
    level set (`measure_side_distances`).
    """
    state = _Simplification(mesh, field, lo, hi, max_distortion, max_side_distance)
    for _ in range(MAX_REQUEUES):
        for _ in range(MAX_ROUNDS_PER_QUEUE):
            if not state.run_round():
                break
        if not state.requeue_stale():
            break
    polygons = state.polygons
    sizes = state.vertex_sizes(polygons.rows)
    return EditHistory(mesh, polygons, state.vertices, sizes, state.history, field, lo, hi)


@dataclass(frozen=True, slots=True, eq=False)
class _SelectedEdit:
    """An edit, the index of its candidate, and the vertices that are smoothed after it."""

    candidate: int
    edit: MeshEdit
    neighbourhood: set[int]


@dataclass(frozen=True, slots=True, eq=False)
class _NearbyPolygons:
    """Polygons in the neighbourhoods of n edits: numbers (m,), corners (m, 4), and incidences (k,) of polygons and edits."""

    numbers: IntArray
    rows: IntArray
    polygon: IntArray
    edit: IntArray

    def max_of_edits(self, distortion: Array, count: int) -> Array:
        """The largest of the distortions (m,) near each edit, (count,)."""
        return segment_max(distortion[self.polygon], self.edit, count)


class _Simplification:
    """The state of a simplification: mesh, vertex positions, candidates and the polygons to be rated again."""

    def __init__(
        self, mesh: QuadMesh, field: Field, lo: Array, hi: Array, max_distortion: float, max_side_distance: float
    ) -> None:
        self.field, self.lo, self.hi = field, lo, hi
        self.max_distortion, self.max_side_distance = max_distortion, max_side_distance
        self.polygons = PolygonMesh(mesh)
        self.vertices, self.fixed = mesh.vertices.copy(), mesh.fixed
        self.leaf_size = mesh.size.copy()
        self.normals = normalize(field.gradient(self.vertices))
        self.candidates = Candidates.empty()
        self.queue = set(self.polygons.corners_of)
        self.stale: set[int] = set()
        self.history: list[RecordedEdit] = []

    def requeue_stale(self) -> bool:
        """Re-queue polygons whose neighbourhood moved; whether the queue is not empty."""
        self.queue |= self.stale
        self.stale = set()
        return bool(self.queue)

    def run_round(self) -> int:
        """Rate the queue, apply the best candidates and keep what passes; the number of edits that were tried."""
        rows = self.polygons.rows
        queue = np.array(sorted(self.queue.intersection(self.polygons.corners_of)), np.int64)
        self.queue = set()
        stars = build_vertex_stars(rows, len(self.vertices))
        surface = SurfaceVertices(self.field, self.vertices, self.normals, self.fixed)
        ranked = rank_candidates(stars, surface, queue, MAX_RATIO_BEFORE_SMOOTHING * self.max_distortion)
        self.candidates = Candidates.concatenate([self.candidates.drop_stale(rows[:, 0] >= 0, queue), ranked])
        selected, infeasible = self._select_independent(stars)
        if not selected:
            return 0
        kept = self._apply_and_verify(selected)
        failed = [each.candidate for each, passes in zip(selected, kept, strict=True) if not passes]
        self.candidates = self.candidates.drop_indices(infeasible + failed)
        return len(selected)

    def vertex_sizes(self, rows: IntArray) -> Array:
        """Length scale (V,) of each vertex: its leaf's, or its shortest side in polygons `rows` (Q, 4) if that is longer."""
        start, end = rows[rows >= 0], next_corner(rows)[rows >= 0]
        side = np.linalg.norm(self.vertices[start] - self.vertices[end], axis=1)
        shortest = np.full(len(self.vertices), np.inf)
        np.minimum.at(shortest, np.concatenate([start, end]), np.concatenate([side, side]))
        return np.maximum(self.leaf_size, np.where(np.isfinite(shortest), shortest, 0.0))

    def _select_independent(self, stars: VertexStars) -> tuple[list[_SelectedEdit], list[int]]:
        """Greedy maximal set of non-overlapping candidates, best score first, and the indices of infeasible ones."""
        known, is_taken = self.candidates, np.zeros(len(self.vertices), bool)
        selected: list[_SelectedEdit] = []
        infeasible: list[int] = []
        order, place = known.ranking(), -1
        while (place := known.find_next_free(order, place + 1, stars, is_taken)) < len(order):
            k = int(order[place])
            edit = plan_edit(self.polygons, known.seeds.seed(k))
            if edit is None:
                infeasible.append(k)
                continue
            neighbourhood = self._smoothed_neighbourhood(edit)
            vertices = np.fromiter(neighbourhood, np.int64, len(neighbourhood))
            if not is_taken[vertices].any():
                is_taken[vertices] = True
                selected.append(_SelectedEdit(k, edit, neighbourhood))
        return selected, infeasible

    def _smoothed_neighbourhood(self, edit: MeshEdit) -> set[int]:
        """Vertices that are smoothed after an edit: its own, and the one-rings of the vertices that others merge into."""
        vertices = edit.vertices
        for v in set(edit.merges.values()):
            for f in self.polygons.polygons_at_vertex[v]:
                vertices.update(self.polygons.corners_of[f])
        return vertices

    def _apply_and_verify(self, selected: Sequence[_SelectedEdit]) -> BoolArray:
        """Apply the edits, smooth round them, and undo those that leave a polygon of too poor shape; which (n,) are kept."""
        vertices_before, normals_before = self.vertices.copy(), self.normals.copy()
        owner = np.full(len(self.vertices), -1)
        for i, each in enumerate(selected):
            owner[list(each.neighbourhood)] = i
        count, near = len(selected), self._polygons_near(owner)
        before = near.max_of_edits(self._distortion(near.rows), count)
        applied = [self._apply(each.edit) for each in selected]
        near = self._polygons_near(owner)
        self._smooth(near, owner)
        passes = self._passes(near, before)
        for kept, each, chosen in zip(passes, applied, selected, strict=True):
            if kept:
                merged = each.edit.merges.values()
                self.queue.update(f for v in merged for f in self.polygons.polygons_at_vertex[v])
                self.queue.update(each.new_numbers)
                moved = np.array(sorted(chosen.edit.vertices), np.int64)
                self.history.append(RecordedEdit(each, moved, vertices_before[moved]))
            else:
                self.polygons.undo(each)
        undone = np.flatnonzero(~passes[owner] & (owner >= 0))
        self.vertices[undone], self.normals[undone] = vertices_before[undone], normals_before[undone]
        self.stale.update(near.numbers[near.polygon[passes[near.edit]]].tolist())
        return passes

    def _apply(self, edit: MeshEdit) -> AppliedEdit:
        """Apply an edit and move each pair of merged vertices with equally many fixed coordinates to its midpoint."""
        applied = self.polygons.apply(edit)
        for v, w in edit.merges.items():
            if self.polygons.n_fixed[v] == self.polygons.n_fixed[w]:
                self.vertices[w] = 0.5 * (self.vertices[v] + self.vertices[w])
        return applied

    def _smooth(self, near: _NearbyPolygons, owner: IntArray) -> None:
        """Smooth the vertices that have an owner."""
        part, ids = extract_mesh(self.polygons, self.vertices, self.vertex_sizes(near.rows), near.numbers)
        free = owner[ids] >= 0
        smoothed = smooth_vertices(part, free, self.field, self.lo, self.hi, SWEEPS_PER_ROUND, self.normals[ids])
        self.vertices[ids] = smoothed.vertices
        self.normals[ids[free]] = normalize(self.field.gradient(smoothed.vertices[free]))

    def _passes(self, near: _NearbyPolygons, before: Array) -> BoolArray:
        """Whether all polygons near each edit (n,), and the surface in them, are within the limits or no worse than `before`."""
        passes = near.max_of_edits(self._distortion(near.rows), len(before)) <= np.maximum(self.max_distortion, before)
        polygon, edit = near.polygon[passes[near.edit]], near.edit[passes[near.edit]]
        measured, index = np.unique(polygon, return_inverse=True)
        surface = self.field, self.vertices, self.normals, self.fixed
        inside = interior_distortion(*surface, near.rows[measured])
        was_bad = before > self.max_distortion
        limit = np.where(was_bad, before, MAX_INTERIOR_DISTORTION)
        passes &= segment_max(inside[index.ravel()], edit, len(before)) <= limit
        if not math.isfinite(self.max_side_distance):
            return passes
        distance = measure_side_distances(*surface, near.rows[measured])
        return passes & (was_bad | (segment_max(distance[index.ravel()], edit, len(before)) <= self.max_side_distance))

    def _polygons_near(self, owner: IntArray) -> _NearbyPolygons:
        """The polygons with a corner that has an owner (V,), the number of an edit or -1."""
        numbers = np.flatnonzero(self.polygons.rows[:, 0] >= 0)
        rows = self.polygons.rows[numbers]
        edit = np.where(rows >= 0, owner[rows], -1)
        touched = (edit >= 0).any(axis=1)
        numbers, rows, edit = numbers[touched], rows[touched], edit[touched]
        polygon, slot = np.nonzero(edit >= 0)
        return _NearbyPolygons(numbers, rows, polygon, edit[polygon, slot])

    def _distortion(self, rows: IntArray) -> Array:
        return corner_distortion(self.vertices, self.normals, self.fixed, rows)
