"""Closed contours of a boundary representation in horizontal planes: a face that is repeated is cut once.

A lattice has few faces that are not translated copies of others. One face of each class is cut by itself, at every height at
which one of its copies is met; the curves found there, from edge to edge, are moved to the copies. The ends of two curves belong
together where they are the same crossing of an edge with a plane, by number along the edge, so that contours close without a
search.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.array_table import ArrayTable
from tpmscad.brep.boundary_representation import Brep, select_faces
from tpmscad.brep.extents import true_bounds
from tpmscad.brep.face_classes import group_translated_faces
from tpmscad.brep.loops import follow_paths
from tpmscad.errors import KernelError
from tpmscad.index_ranges import expand_ranges
from tpmscad.kernel.build.solids import build_faces
from tpmscad.kernel.export.solid_mesh import EdgeSegments, mesh_faces
from tpmscad.kernel.occt.geometry_evaluators import pack_curves, pack_surfaces
from tpmscad.kernel.slicing.chord_splitting import split_chords
from tpmscad.kernel.slicing.contours import (
    CONTOUR_REL_TOL,
    LEAST_MESH_DEVIATION,
    MESH_ANGLE,
    MESH_DEVIATION_FACTOR,
    LayerContours,
    join_contours,
)
from tpmscad.kernel.slicing.level_crossings import NODE_REL_TOL, Crossings, LevelSets, find_crossings
from tpmscad.kernel.slicing.level_refinement import resolve_levels
from tpmscad.kernel.slicing.surface_triangulation import SurfaceTriangulation, triangulation_of
from tpmscad.parallel import split_batches, task_runner

CLASS_REL_RESOLUTION = 1e-11
"""In sizes of the solid: rounding of faces before they are compared."""

LEVEL_REL_RESOLUTION = 1e-10
"""In sizes of the solid: two copies of a face that are cut at heights which differ by less are cut once."""

FACES_PER_TASK = 64
"""Different faces cut by one task."""


MAX_REL_GAP = 1e-6
"""In sizes of the solid: distance of the ends of two curves at an edge up to which they are one point."""

CLOSED, LOOSE = -1, -2
"""Numbers that stand for the ends of a closed curve, and for an end that is on no edge."""


@dataclass(frozen=True, slots=True, eq=False)
class FaceCurves:
    """Curves in which faces are cut, sorted by their levels; each lies in one face at one level.

    points: curve after curve, (n, 2). starts: where each begins, and n, (c + 1,). level: (c,). edge: on which each begins and
    ends, or CLOSED or LOOSE, (c, 2). order: number of its ends among the crossings of that edge and level along the curve of the
    edge, of which there are `count`, (c, 2). area: integral of x dy along each exact curve, which is the area within closed ones,
    (c,). rise: y of its end less that of its beginning, (c,). length: (c,). unresolved: number of its chords that are too long,
    (c,).
    """

    points: Array
    starts: IntArray
    level: IntArray
    edge: IntArray
    order: IntArray
    count: IntArray
    area: Array
    rise: Array
    length: Array
    unresolved: IntArray


@dataclass(frozen=True, slots=True, eq=False)
class CopiedCurves(ArrayTable):
    """Copies of curves: the curve of each, the face that it is on, and the level of the plane that it is in, (p,) each."""

    curve: IntArray
    face: IntArray
    level: IntArray


class RepeatedFaces:
    """The faces of a boundary representation as translated copies of a few, which are triangulated.

    Raises KernelError if OCCT cannot triangulate a face.
    """

    def __init__(self, brep: Brep, chord_error: float) -> None:
        self.chord_error = chord_error
        self.size = float(np.ptp(np.array(true_bounds(brep)), axis=0).max())
        classes = group_translated_faces(brep, CLASS_REL_RESOLUTION * self.size)
        first, translation = classes.first, brep.faces.motion.translation
        self.class_of_face = classes.label
        self.moved = translation - translation[first][classes.label]
        faces = build_faces(select_faces(brep, first))
        deviation = max(MESH_DEVIATION_FACTOR * chord_error, LEAST_MESH_DEVIATION * self.size)
        meshes = mesh_faces(faces, deviation, MESH_ANGLE)
        self.meshes = [triangulation_of(mesh) for mesh in meshes]
        ranges = [mesh.height_ranges() for mesh in self.meshes]
        self.ranges = np.array([(each[:, 0].min(), each[:, 1].max()) for each in ranges])

        self.uses = brep.uses
        self.ordered_uses = classes.use_order
        self.first_use = brep.faces.use_start[brep.faces.loop_start]
        place = np.empty(len(brep.uses), np.int64)  # of a use among those of its face, in the order common to the class
        place[self.ordered_uses] = np.arange(len(brep.uses)) - self.first_use[brep.face_of_use]
        own = [np.arange(self.first_use[f], self.first_use[f + 1]) for f in first.tolist()]
        self.first_edge = np.cumsum([0, *map(len, own)])  # an edge of a mesh is a use of the first face of its class
        self.use_of_edge = np.concatenate(own)
        self.place_of_edge = place[self.use_of_edge]

    def cut(
        self, levels: Array, executor: Executor | None, cut_whole: Callable[[Array], LayerContours]
    ) -> LayerContours:
        """Contours in planes at ascending heights (l,); see `slice_solids`.

        Where two copies of an edge touch a plane in different numbers of points, by round-off, contours do not close: at such
        levels `cut_whole` cuts the solid.
        """
        curves, copies = self._cut_copies(levels, executor)
        tail, head = (self._number_ends(curves, copies, k, len(levels)) for k in (0, 1))
        failed = np.unique(copies.level[_find_unmatched(tail, head)])
        if len(failed):
            kept = ~np.isin(copies.level, failed)
            copies, tail, head = copies[kept], tail[kept], head[kept]
        parts, levels_of = [self._join_copies(curves, copies, tail, head, len(levels))], [np.arange(len(levels))]
        if len(failed):
            parts.append(cut_whole(levels[failed]))
            levels_of.append(failed)
        return join_contours(parts, levels_of, len(levels))

    def measure_areas(self, levels: Array, executor: Executor | None) -> Array:
        """Areas within the exact contours in planes at ascending heights (l,): (l,)."""
        curves, copies = self._cut_copies(levels, executor)
        return self._add_areas(curves, copies, len(levels))

    def _add_areas(self, curves: FaceCurves, copies: CopiedCurves, n_levels: int) -> Array:
        moved = self.moved[copies.face, 0]
        areas = curves.area[copies.curve] + moved * curves.rise[copies.curve]
        return np.bincount(copies.level, areas, n_levels).astype(float)

    def _cut_copies(self, levels: Array, executor: Executor | None) -> tuple[FaceCurves, CopiedCurves]:
        """The curves of one face of each class, and the copies of them that all faces are cut in."""
        klass, shift = self.class_of_face, self.moved[:, 2]
        low, high = self.ranges[klass].T
        face, level = expand_ranges(
            np.searchsorted(levels, low + shift), np.searchsorted(levels, high + shift, side="right")
        )
        own = levels[level] - shift[face]
        keys = np.rint(own / (LEVEL_REL_RESOLUTION * self.size)).astype(np.int64)
        order = np.lexsort((keys, klass[face]))
        new = np.ones(len(order), bool)
        new[1:] = (np.diff(keys[order]) != 0) | (np.diff(klass[face[order]]) != 0)
        number = np.empty(len(order), np.int64)
        number[order] = np.cumsum(new) - 1
        first = order[new]
        starts = np.searchsorted(klass[face[first]], np.arange(len(self.meshes) + 1))
        curves = self._cut_classes(own[first], starts, executor)
        begins = np.searchsorted(curves.level, np.arange(len(first) + 1))
        copy, curve = expand_ranges(begins[number], begins[number + 1])
        return curves, CopiedCurves(curve, face[copy], level[copy])

    def _cut_classes(self, heights: Array, starts: IntArray, executor: Executor | None) -> FaceCurves:
        """The curves of the first face of each class c at heights[starts[c] : starts[c + 1]]."""
        tasks, level_from, edge_from = [], [], []
        for batch in split_batches(np.arange(len(self.meshes)), FACES_PER_TASK):
            first, last = int(batch[0]), int(batch[-1]) + 1
            own = starts[first : last + 1]
            sets = LevelSets(heights[own[0] : own[-1]], own - own[0], np.arange(last - first), NODE_REL_TOL * self.size)
            mesh = _join_meshes(self.meshes[first:last])
            tasks.append((mesh, sets, self.chord_error, CONTOUR_REL_TOL * self.size))
            level_from.append(int(own[0]))
            edge_from.append(int(self.first_edge[first]))
        with task_runner(executor, tasks[0] if tasks else None) as run_tasks:
            return _join_curves(run_tasks(_cut_faces, tasks), level_from, edge_from)

    def _join_copies(
        self, curves: FaceCurves, copies: CopiedCurves, tail: IntArray, head: IntArray, n_levels: int
    ) -> LayerContours:
        """The contours that copies of curves close to, by the numbers of their ends."""
        following = np.arange(len(copies))  # a closed curve follows itself
        leaving, arriving = (np.flatnonzero(at != CLOSED) for at in (tail, head))
        following[arriving[np.argsort(head[arriving])]] = leaving[np.argsort(tail[leaving])]
        moved = self.moved[copies.face, :2]
        first, last = curves.starts[:-1][copies.curve], curves.starts[1:][copies.curve]
        gaps = np.linalg.norm(curves.points[last - 1] + moved - (curves.points[first] + moved)[following], axis=1)
        apart = gaps[(gaps > MAX_REL_GAP * self.size) & (tail != CLOSED)]
        if len(apart):
            raise KernelError("slice", f"curves of neighbouring faces end {apart.max():.2g} apart")
        order, starts = follow_paths(following)
        by_level = np.argsort(copies.level[order[starts[:-1]]], kind="stable")
        contour, index = expand_ranges(starts[:-1][by_level], starts[1:][by_level])
        order, starts = order[index], np.searchsorted(contour, np.arange(len(by_level) + 1))
        end = last[order] - (tail[order] != CLOSED)  # the last point of an open curve is the first of the following one
        curve, index = expand_ranges(first[order], end)
        first_point = np.append(0, np.cumsum(end - first[order]))
        return LayerContours(
            curves.points[index] + moved[order][curve],
            first_point[starts],
            copies.level[order[starts[:-1]]],
            self._add_areas(curves, copies, n_levels),
            np.bincount(copies.level, curves.length[copies.curve], n_levels).astype(float),
            int(curves.unresolved[copies.curve].sum()),
        )

    def _number_ends(self, curves: FaceCurves, copies: CopiedCurves, which: int, n_levels: int) -> IntArray:
        """A number for the first or last end of each copy that is the same for both faces of the edge there: (p,)."""
        edge = curves.edge[copies.curve, which]
        number, some = edge.copy(), np.flatnonzero(edge >= 0)
        edge, own = edge[some], copies.curve[some]
        order, count = curves.order[own, which], curves.count[own, which]
        use = self.ordered_uses[self.first_use[copies.face[some]] + self.place_of_edge[edge]]
        turned = self.uses.sense[use] != self.uses.sense[self.use_of_edge[edge]]
        order = np.where(turned, count - 1 - order, order)
        most = int(curves.count.max(initial=0)) + 1
        number[some] = (self.uses.edge[use] * n_levels + copies.level[some]) * most + order
        return number


def _find_unmatched(tail: IntArray, head: IntArray) -> IntArray:
    """The curves with an end at which not exactly one curve begins and one ends."""
    begins, ends = (np.sort(at[at != CLOSED]) for at in (tail, head))
    if np.array_equal(begins, ends) and (np.diff(begins) > 0).all() and LOOSE not in begins[:1]:
        return np.zeros(0, np.int64)
    (begins, n_begins), (ends, n_ends) = (np.unique(at, return_counts=True) for at in (begins, ends))
    wrong = np.concatenate([np.setxor1d(begins, ends), begins[n_begins > 1], ends[n_ends > 1], [LOOSE]])
    return np.flatnonzero(np.isin(tail, wrong) | np.isin(head, wrong))


def _join_meshes(meshes: Sequence[SurfaceTriangulation]) -> SurfaceTriangulation:
    """The meshes of several faces side by side."""
    nodes, edges, segments = (
        np.cumsum([0, *sizes])
        for sizes in (
            [len(mesh.points) for mesh in meshes],
            [len(mesh.curves.evaluators) for mesh in meshes],
            [len(mesh.segments.edge) for mesh in meshes],
        )
    )
    parts = list(zip(meshes, nodes.tolist(), edges.tolist(), segments.tolist(), strict=False))
    triangles = np.concatenate([mesh.triangles + node for mesh, node, _, _ in parts])
    return SurfaceTriangulation(
        points=np.concatenate([mesh.points for mesh in meshes]),
        triangles=triangles,
        face=np.repeat(np.arange(len(meshes)), [len(mesh.triangles) for mesh in meshes]),
        nodes=triangles,
        uv=np.concatenate([mesh.uv for mesh in meshes]),
        segment=np.concatenate([np.where(mesh.segment >= 0, mesh.segment + first, -1) for mesh, _, _, first in parts]),
        segments=EdgeSegments(
            np.concatenate([mesh.segments.edge + edge for mesh, _, edge, _ in parts]),
            np.concatenate([mesh.segments.nodes + node for mesh, node, _, _ in parts]),
            np.concatenate([mesh.segments.parameters for mesh in meshes]),
        ),
        surfaces=pack_surfaces([each for mesh in meshes for each in mesh.surfaces.evaluators]),
        curves=pack_curves([each for mesh in meshes for each in mesh.curves.evaluators]),
    )


def _cut_faces(mesh: SurfaceTriangulation, sets: LevelSets, chord_error: float, tol: float) -> FaceCurves:
    """The curves in which faces are cut, each by itself; levels and edges are numbered as the mesh has them."""
    mesh = resolve_levels(mesh, sets)
    crossings = find_crossings(mesh, sets)
    arcs = split_chords(crossings, mesh.surfaces, sets.heights, chord_error, tol)
    n = len(arcs.point)
    following = np.full(n, -1)
    following[arcs.tail] = arcs.head
    order, starts = follow_paths(following)
    by_level = np.argsort(arcs.level[order[starts[:-1]]], kind="stable")
    path, index = expand_ranges(starts[:-1][by_level], starts[1:][by_level])
    order, starts = order[index], np.searchsorted(path, np.arange(len(by_level) + 1))
    ends = np.stack([order[starts[:-1]], order[starts[1:] - 1]], axis=1)
    closed = following[ends[:, 1]] >= 0

    along, count = _count_along_edges(crossings, len(sets.heights))
    edge = np.where(ends < len(crossings.edge), crossings.edge[np.minimum(ends, len(crossings.edge) - 1)], -1)
    edge = np.where(closed[:, None], CLOSED, np.where(edge >= 0, edge, LOOSE))
    at = np.where(edge >= 0, ends, 0)
    a, b = arcs.point[arcs.tail], arcs.point[arcs.head]
    own = np.empty(n, np.int64)  # the curve of each point
    own[order] = path
    areas = 0.5 * (a[:, 0] + b[:, 0]) * (b[:, 1] - a[:, 1]) + arcs.beyond
    area, length = (np.bincount(own[arcs.tail], each, len(by_level)).astype(float) for each in (areas, arcs.length))
    return FaceCurves(
        points=arcs.point[order],
        starts=starts,
        level=arcs.level[ends[:, 0]],
        edge=edge,
        order=along[at],
        count=count[at],
        area=area,
        rise=np.where(closed, 0.0, arcs.point[ends[:, 1], 1] - arcs.point[ends[:, 0], 1]),
        length=length,
        unresolved=np.bincount(own[arcs.unresolved], minlength=len(by_level)),
    )


def _count_along_edges(crossings: Crossings, n_levels: int) -> tuple[IntArray, IntArray]:
    """The number of each crossing among those of its edge and level, along the curve, and how many these are: (n,), (n,)."""
    along, count = np.zeros(len(crossings.edge) + 1, np.int64), np.zeros(len(crossings.edge) + 1, np.int64)
    some = np.flatnonzero(crossings.edge >= 0)
    key = crossings.edge[some] * n_levels + crossings.level[some]
    order = np.lexsort((crossings.parameter[some], key))
    _, first, inverse, counts = np.unique(key[order], return_index=True, return_inverse=True, return_counts=True)
    along[some[order]] = np.arange(len(order)) - first[inverse]
    count[some[order]] = counts[inverse]
    return along, count


def _join_curves(parts: Sequence[FaceCurves], level_from: Sequence[int], edge_from: Sequence[int]) -> FaceCurves:
    """The curves of several batches of faces, whose levels and edges are numbered from a first one on."""

    def join(name: str) -> Any:
        return np.concatenate([getattr(part, name) for part in parts])

    sizes = np.concatenate([np.diff(part.starts) for part in parts])
    return FaceCurves(
        join("points"),
        np.append(0, np.cumsum(sizes)),
        np.concatenate([part.level + first for part, first in zip(parts, level_from, strict=True)]),
        np.concatenate(
            [
                np.where(part.edge >= 0, part.edge + first, part.edge)
                for part, first in zip(parts, edge_from, strict=True)
            ]
        ),
        *map(join, ("order", "count", "area", "rise", "length", "unresolved")),
    )
