"""Closed contours of solids in horizontal planes, straight from their faces, within a chord error.

Faces that are translated copies of another one are not cut: one face of each class is, at every height at which one of them is
met, and the curves found there, from edge to edge, are moved to the others. The ends of two curves belong together where
they lie on the same chord of an edge in the same plane, so that contours close without a search. Segments between the crossings
of a triangulation (`level_crossings`) are split at points of the exact contour until the chords keep the error
(`chord_splitting`). Areas are those inside the exact contours, not the polygons.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.array_table import ArrayTable
from tpmscad.brep.extents import true_bounds
from tpmscad.brep.loops import follow_paths
from tpmscad.brep.sections.layer_contours import LayerContours
from tpmscad.brep.triangles.measured_deviation import FaceTriangles, pair_sides
from tpmscad.errors import KernelError
from tpmscad.index_ranges import expand_ranges, list_preceding
from tpmscad.kernel.build.solids import BrepSolids
from tpmscad.kernel.export.edge_division import FaceOutlines, explore_faces, outline_built_solids
from tpmscad.kernel.export.solid_mesh import FaceTriangulation, triangulate_outlines
from tpmscad.kernel.occt.bounding_boxes import box_diagonal
from tpmscad.kernel.occt.construction import make_compound
from tpmscad.kernel.occt.exploration import faces_of, solids_of, unwrap
from tpmscad.kernel.slicing.face_curves import FaceCurves, cut_faces, join_curves
from tpmscad.kernel.slicing.level_crossings import NODE_REL_TOL, Chords, LevelSets, OutlinedFaces
from tpmscad.kernel.slicing.level_refinement import HEIGHT_MARGIN, bound_heights
from tpmscad.parallel import split_batches, task_runner

MESH_DEVIATION_FACTOR, LEAST_MESH_DEVIATION = 2.0, 1e-5
"""Deviation of the triangulation in chord errors, and the least one in sizes of the solid; chords are split afterwards anyway."""

MESH_ANGLE = 0.5
"""Radians between neighbouring facets of the triangulation."""

CLASS_REL_RESOLUTION = 1e-11
"""In sizes of the solid: rounding of faces before they are compared."""

LEVEL_REL_RESOLUTION = 1e-10
"""In sizes of the solid: two copies of a face that are cut at heights which differ by less are cut once."""

FACES_PER_TASK, LEVELS_PER_FACE = 64, 125
"""Different faces cut by one task; of a face that is cut at more levels, each part of them counts as one."""

MAX_REL_GAP = 1e-6
"""In sizes of the solid: distance of the ends of two curves on a chord of an edge up to which they are one point."""


@dataclass(frozen=True, slots=True, eq=False)
class _CopiedCurves(ArrayTable):
    """Copies of curves: the curve of each, the side of a face that it is on, and the level of its plane, (p,) each."""

    curve: IntArray
    side: IntArray
    level: IntArray


@dataclass(frozen=True, slots=True, eq=False)
class SlicedFaces:
    """The faces of solids as translated copies of a few, which are triangulated.

    solid, face, turned: the solid, the number and the sense of each side of a face that bounds a solid, (s,). ranges: heights
    between which each representative lies, (r, 2). chords: of the edges of the representatives, named by their numbers, those of
    representative i from chord_start[i] on; chord_use, chord_place: use of an edge within its face, and place along it, (k,).
    size: of the solids.
    """

    outlines: FaceOutlines
    found: FaceTriangulation
    solid: IntArray
    face: IntArray
    turned: BoolArray
    ranges: Array
    chords: Chords
    chord_start: IntArray
    chord_use: IntArray
    chord_place: IntArray
    size: float
    chord_error: float

    def cut(self, levels: Array, executor: Executor | None = None) -> LayerContours:
        """Contours in planes at ascending heights (l,), outer ones counter-clockwise and holes clockwise.

        Batches of faces and levels are cut by the executor, or by processes of their own where there are many. KernelError if
        the curves of faces do not close.
        """
        curves, copies = self._cut_copies(levels, executor)
        return self._join_copies(curves, copies, len(levels))

    def measure_areas(self, levels: Array, executor: Executor | None = None) -> Array:
        """Areas within the exact contours in planes at ascending heights (l,): (l,)."""
        return self._add_areas(*self._cut_copies(levels, executor), len(levels))

    @property
    def jumps(self) -> Array:
        """Heights (n,) of horizontal faces, at which areas may jump, in any order."""
        thickness = np.ptp(self.ranges, axis=1) - 2.0 * HEIGHT_MARGIN * self.size
        source = self.outlines.of_face[self.face]
        heights = self.ranges.mean(axis=1)[source] + self._translations[:, 2]
        return np.asarray(heights[(thickness < NODE_REL_TOL * self.size)[source]])

    @property
    def _translations(self) -> Array:
        """Translations (s, 3) of the sides from their representatives."""
        motion = self.outlines.motion
        return np.zeros((len(self.face), 3)) if motion is None else motion.translation[self.face]

    def _add_areas(self, curves: FaceCurves, copies: _CopiedCurves, n_levels: int) -> Array:
        areas = curves.area[copies.curve] + self._translations[copies.side, 0] * curves.rise[copies.curve]
        return np.bincount(copies.level, areas, n_levels).astype(float)

    def _cut_copies(self, levels: Array, executor: Executor | None) -> tuple[FaceCurves, _CopiedCurves]:
        """The curves of one face of each class, and the copies of them that all faces are cut in."""
        source, shift = self.outlines.of_face[self.face], self._translations[:, 2]
        low, high = self.ranges[source].T
        side, level = expand_ranges(
            np.searchsorted(levels, low + shift), np.searchsorted(levels, high + shift, side="right")
        )
        own, klass = levels[level] - shift[side], (2 * source + self.turned)[side]
        keys = np.rint(own / (LEVEL_REL_RESOLUTION * self.size)).astype(np.int64)
        order = np.lexsort((keys, klass))
        new = np.append(True, (np.diff(keys[order]) != 0) | (np.diff(klass[order]) != 0))[: len(order)]
        number = np.empty(len(order), np.int64)
        number[order] = np.cumsum(new) - 1
        first = order[new]
        curves = self._cut_classes(own[first], klass[first], executor)
        begins = np.searchsorted(curves.level, np.arange(len(first) + 1))
        copy, curve = expand_ranges(begins[number], begins[number + 1])
        return curves, _CopiedCurves(curve, side[copy], level[copy])

    def _cut_classes(self, heights: Array, klass: IntArray, executor: Executor | None) -> FaceCurves:
        """The curves of one face of each class (h,), which are ascending, at heights (h,), ascending in each."""
        place = np.arange(len(klass)) - np.searchsorted(klass, klass)
        starts = np.append(np.flatnonzero(place % LEVELS_PER_FACE == 0), len(klass))
        tasks, level_from = [], []
        for batch in split_batches(np.arange(len(starts) - 1), FACES_PER_TASK):
            own = starts[batch[0] : batch[-1] + 2]
            sets = LevelSets(heights[own[0] : own[-1]], own - own[0], self.size)
            tasks.append((self._join_faces(klass[own[:-1]]), sets, self.chord_error))
            level_from.append(int(own[0]))
        with task_runner(executor, (self.found.surfaces, self.outlines.curves)) as run_tasks:
            return join_curves(run_tasks(cut_faces, tasks), level_from)

    def _join_faces(self, klass: IntArray) -> OutlinedFaces:
        """The triangles of faces of some classes (f,), in the sense in which they bound their solids."""
        mesh, begin, source = self.found.mesh, self.found.begin, klass // 2
        rows = np.searchsorted(mesh.face, [source, source + 1])
        face, row = expand_ranges(*rows)
        _, node = expand_ranges(begin[source], begin[source + 1])
        of_chord, chord = expand_ranges(self.chord_start[source], self.chord_start[source + 1])
        count = begin[source + 1] - begin[source]
        moved = np.cumsum(count) - count - begin[source]
        triangles = mesh.triangles[row] + moved[face, None]
        triangles = np.where((klass % 2 == 1)[face, None], triangles[:, ::-1], triangles)
        chords = self.chords[chord]
        curve, own_curve = np.unique(chords.curve, return_inverse=True)
        return OutlinedFaces(
            FaceTriangles(mesh.points[node], mesh.uv[node], triangles, face, pair_sides(triangles, len(node))),
            self.found.surfaces.select(source),
            Chords(chords.nodes + moved[of_chord, None], chords.parameters, own_curve.ravel(), chords.name),
            self.outlines.curves.select(curve),
        )

    def _join_copies(self, curves: FaceCurves, copies: _CopiedCurves, n_levels: int) -> LayerContours:
        """The contours that copies of curves close to."""
        moved = self._translations[copies.side, :2]
        first, last = curves.starts[:-1][copies.curve], curves.starts[1:][copies.curve]
        closed = curves.closed[copies.curve]
        following = np.where(closed, np.arange(len(copies)), -1)
        begin, end = curves.points[first] + moved, curves.points[last - 1] + moved
        tail, head = (self._name_ends(curves, copies, which, n_levels) for which in (0, 1))
        _, arriving, leaving = np.intersect1d(head, tail, return_indices=True)
        gaps = np.linalg.norm(end[arriving] - begin[leaving], axis=1)
        if (gaps > MAX_REL_GAP * self.size).any():
            raise KernelError("slice", f"curves of neighbouring faces end {gaps.max():.2g} apart")
        following[arriving] = leaving
        self._close_others(following, copies.level, begin, end)
        order, starts = follow_paths(following)
        by_level = np.argsort(copies.level[order[starts[:-1]]], kind="stable")
        contour, index = expand_ranges(starts[:-1][by_level], starts[1:][by_level])
        order, starts = order[index], np.searchsorted(contour, np.arange(len(by_level) + 1))
        layer = copies.level[order[starts[:-1]]]
        stop = last[order] - ~closed[order]  # the last point of an open curve is the first of the following one
        curve, index = expand_ranges(first[order], stop)
        first_point = np.append(0, np.cumsum(stop - first[order]))
        points, starts, kept = _drop_repeated(curves.points[index] + moved[order][curve], first_point[starts])
        return LayerContours(
            points,
            starts,
            layer[kept],
            self._add_areas(curves, copies, n_levels),
            np.bincount(copies.level, curves.length[copies.curve], n_levels).astype(float),
            int(curves.unresolved[copies.curve].sum()),
        )

    def _name_ends(self, curves: FaceCurves, copies: _CopiedCurves, which: int, n_levels: int) -> IntArray:
        """A number for the first or last end of each copy that is the same for both faces of the edge there: (p,).

        It is negative where the curve ends on no edge, and another one for the other end.
        """
        chord = curves.ends[copies.curve, which]
        use = self.outlines.use_start[self.face[copies.side]] + self.chord_use[chord]
        edge, place = self.outlines.uses[use], self.chord_place[chord]
        count = self.found.division.chords
        place = np.where(self.outlines.turned[use], count[edge] - 1 - place, place)
        of_edge = self.solid[copies.side] * int(count.sum()) + (np.cumsum(count) - count)[edge]
        return np.where(chord < 0, -1 - which, (of_edge + place) * n_levels + copies.level)

    def _close_others(self, following: IntArray, level: IntArray, begin: Array, end: Array) -> None:
        """Let curves that end on no chord of another one be followed by the nearest one that begins so, within the chord error.

        Two copies of an edge may touch a plane in different numbers of points, by round-off, and OCCT makes one node of those
        that it cannot tell apart.
        """
        preceded = np.zeros(len(following), bool)
        preceded[following[following >= 0]] = True
        arriving, leaving = np.flatnonzero(following < 0), np.flatnonzero(~preceded)
        for at in np.unique(level[arriving]).tolist():
            ends, begins = arriving[level[arriving] == at], leaving[level[leaving] == at]
            gaps = np.linalg.norm(end[ends, None] - begin[begins], axis=2)
            row, column = linear_sum_assignment(gaps)
            if (gaps[row, column] > self.chord_error).any():
                raise KernelError("slice", f"curves of neighbouring faces end {gaps[row, column].max():.2g} apart")
            following[ends[row]] = begins[column]


def triangulate_for_slices(source: BrepSolids | Sequence[Any], chord_error: float) -> SlicedFaces:
    """The faces of solids that were built from arrays, or of those of several shapes, for contours within the chord error.

    Raises KernelError if OCCT cannot triangulate a face, or a solid is open.
    """
    if isinstance(source, BrepSolids):
        size = float(np.ptp(np.array(true_bounds(source.brep)), axis=0).max())
        outlines = outline_built_solids([source], CLASS_REL_RESOLUTION * size, upright=True)
    else:
        shapes = [unwrap(shape) for shape in source]
        size = box_diagonal(make_compound(shapes))
        outlines = explore_faces([faces_of(solid) for shape in shapes for solid in solids_of(shape)])
    deviation = max(MESH_DEVIATION_FACTOR * chord_error, LEAST_MESH_DEVIATION * size)
    found = triangulate_outlines(outlines, deviation, MESH_ANGLE, extremum_tol=NODE_REL_TOL * size)
    solid = np.repeat(np.arange(len(outlines.solids)), [len(faces) for faces, _ in outlines.solids])
    face, turned = (np.concatenate(column) for column in zip(*outlines.solids, strict=True))
    side, use = expand_ranges(outlines.use_start[face], outlines.use_start[face + 1])
    uses = np.unique(solid[side] * len(outlines.ends) + outlines.uses[use], return_counts=True)[1]
    if (uses % 2).any():
        raise KernelError("slice", f"a solid is open along {int((uses % 2).sum())} of its edges: close it first")
    chords, of, chord_use, chord_place = _list_chords(outlines, found)
    start = np.searchsorted(of, np.arange(len(outlines.sources) + 1))
    ranges = bound_heights(found.mesh, found.surfaces, size)
    return SlicedFaces(
        outlines, found, solid, face, turned, ranges, chords, start, chord_use, chord_place, size, chord_error
    )


def _list_chords(outlines: FaceOutlines, found: FaceTriangulation) -> tuple[Chords, IntArray, IntArray, IntArray]:
    """The chords of the edges of representatives, of each its representative, the use of an edge there, and its place."""
    nodes, parameters, places = [], [], []
    owner = []  # representative, use and edge of each line
    for r, lines in enumerate(found.lines):
        for use, (line, edge) in enumerate(zip(lines, outlines.uses_of(r).tolist(), strict=True)):
            t = found.division.placed[edge][0]
            nodes.append(np.stack([line[:-1], line[1:]], axis=1))
            parameters.append(np.stack([t[:-1], t[1:]], axis=1))
            places.append(np.arange(len(line) - 1))
            owner.append((r, use, edge))
    of, uses, edges = np.repeat(np.array(owner), [len(each) for each in places], axis=0).T
    curve = np.searchsorted(outlines.own_edges, edges)
    chords = Chords(np.concatenate(nodes), np.concatenate(parameters), curve, np.arange(len(curve)))
    return chords, of, uses, np.concatenate(places)


def _drop_repeated(points: Array, starts: IntArray) -> tuple[Array, IntArray, BoolArray]:
    """Contours without repeated points and those of fewer than 3 points, and which contours were kept."""
    contour = np.repeat(np.arange(len(starts) - 1), np.diff(starts))
    kept = (points != points[list_preceding(starts)]).any(axis=1) if len(points) else np.zeros(0, bool)
    sizes = np.bincount(contour[kept], minlength=len(starts) - 1)
    kept &= (sizes >= 3)[contour]
    return points[kept], np.append(0, np.cumsum(sizes[sizes >= 3])), sizes >= 3
