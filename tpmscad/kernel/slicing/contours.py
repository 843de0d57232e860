"""Closed contours of a solid in horizontal planes, straight from its faces, within a chord error.

Segments between the crossings of a triangulation (`level_crossings`) are split at points of the exact contour until the chords
keep the error. The point of the contour near the middle of a segment is found on the face by Newton's method along the gradient
of the height. Its offset from the chord and the slopes at the ends also give the area between chord and contour, as that of a
quartic: areas are those inside the exact contours, not the polygons.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.brep.loops import follow_cycles
from tpmscad.kernel.export.solid_mesh import mesh_parametrically
from tpmscad.kernel.occt.evaluator_tables import SurfaceTable
from tpmscad.kernel.slicing.level_crossings import Crossings, find_crossings
from tpmscad.kernel.slicing.level_refinement import resolve_levels
from tpmscad.kernel.slicing.surface_triangulation import SurfaceTriangulation, triangulation_of
from tpmscad.parallel import split_batches, task_runner

MESH_DEVIATION_FACTOR = 4.0
"""Deviation of the triangulation in chord errors; chords are split afterwards anyway."""

MESH_ANGLE = 0.5
"""Radians between neighbouring facets of the triangulation."""

LEVELS_PER_TASK = 125
"""Levels cut by one task, so that eight tasks share a thousand; patches that reach beyond them are resolved in two."""

MAX_SPLITS = 12
"""Times that a segment is halved at most."""

NEWTON_STEPS = 5
"""Steps towards the level from the middle of a segment; two or three reach round-off where the face is not horizontal."""

CONTOUR_REL_TOL = 1e-10
"""Distance from the level, in sizes of the solid, up to which a point counts as one of the contour."""

MAX_SLOPE = 1.0
"""Slope of a contour against its chord up to which slopes at the ends are taken for its area."""

MIN_MIDDLE_FRACTION = 0.05
"""Fraction of the chord from either end within which a point is of no use as the middle of a segment."""


@dataclass(frozen=True, slots=True, eq=False)
class LayerContours:
    """Contours of all layers, one after the other.

    points: (n, 2). starts: index of the first point of each contour, and n, (c + 1,). layer: of each contour, ascending, (c,).
    areas: inside the exact contours of each layer, (l,). perimeters: of the exact contours of each layer, (l,). unresolved:
    number of chords longer than the error allows, beside points where the face is horizontal.
    """

    points: Array
    starts: IntArray
    layer: IntArray
    areas: Array
    perimeters: Array
    unresolved: int


def split_layers(found: LayerContours, count: int) -> list[list[Array]]:
    """The contours of each of `count` layers."""
    contours = np.split(found.points, found.starts[1:-1]) if len(found.layer) else []
    first = np.searchsorted(found.layer, np.arange(count + 1))
    return [contours[a:b] for a, b in zip(first[:-1].tolist(), first[1:].tolist(), strict=True)]


def triangulate_for_slices(shape: Any, chord_error: float) -> list[SurfaceTriangulation]:
    """A triangulation of each solid of a shape that contours within the chord error start from.

    Raises KernelError if OCCT cannot triangulate the shape.
    """
    meshes = mesh_parametrically(shape, MESH_DEVIATION_FACTOR * chord_error, MESH_ANGLE)
    return [triangulation_of(mesh) for mesh in meshes]


def slice_solids(
    solids: Sequence[SurfaceTriangulation], levels: Array, chord_error: float, executor: Executor | None = None
) -> LayerContours:
    """Contours of solids in planes at ascending heights (l,), outer ones counter-clockwise and holes clockwise.

    Batches of levels are cut by the executor, or by processes of their own where there are many.
    """
    batches = split_batches(np.arange(len(levels)), LEVELS_PER_TASK)
    tasks, batch_of = [], []
    for whole in solids:
        ranges, tol = whole.height_ranges(), CONTOUR_REL_TOL * whole.size
        for batch in batches:
            chosen = np.flatnonzero((ranges[:, 0] <= levels[batch[-1]]) & (ranges[:, 1] >= levels[batch[0]]))
            if len(chosen):
                tasks.append((whole.select(chosen), levels[batch], chord_error, tol))
                batch_of.append(batch)
    with task_runner(executor, tasks[0] if tasks else None) as run_tasks:
        return _join(run_tasks(_slice_part, tasks), batch_of, len(levels))


def _slice_part(mesh: SurfaceTriangulation, levels: Array, chord_error: float, tol: float) -> LayerContours:
    """The contours of a part of one solid that holds all triangles which the levels meet, layers in any order."""
    mesh = resolve_levels(mesh, levels)
    crossings = find_crossings(mesh, levels)
    arcs = _split_chords(crossings, mesh.surfaces, levels, chord_error, tol)
    following = np.empty(len(arcs.point), np.int64)
    following[arcs.tail] = arcs.head
    order, starts = follow_cycles(following)
    points, layer = arcs.point[order], arcs.level[order[starts[:-1]]]
    a, b = arcs.point[arcs.tail], arcs.point[arcs.head]
    origin = points.mean(axis=0) if len(points) else np.zeros(2)
    below = 0.5 * _cross(a - origin, b - origin)
    of_segment = arcs.level[arcs.tail]
    areas = np.bincount(of_segment, below + arcs.beyond, len(levels))
    perimeters = np.bincount(of_segment, arcs.length, len(levels))
    return LayerContours(
        points, starts, layer, np.asarray(areas, float), np.asarray(perimeters, float), arcs.unresolved
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Arcs:
    """Segments after splitting: points (n, 2) with their level (n,), ends (s,), area beyond each chord (s,), length (s,)."""

    point: Array
    level: IntArray
    tail: IntArray
    head: IntArray
    beyond: Array
    length: Array
    unresolved: int


def _split_chords(crossings: Crossings, surfaces: SurfaceTable, levels: Array, chord_error: float, tol: float) -> _Arcs:
    """Split all segments on their faces until their sagitta is within the chord error."""
    points, marks = [crossings.point], [crossings.level]
    tails, heads, beyonds, lengths = [], [], [], []
    count, unresolved = len(crossings.point), 0
    face, tail, head = crossings.face, crossings.tail, crossings.head
    level = crossings.level[tail]
    a, b = crossings.point[tail], crossings.point[head]
    uv_a, uv_b = crossings.tail_uv, crossings.head_uv
    for split in range(MAX_SPLITS + 1):
        middle_uv, middle, found = _find_middles(surfaces, face, uv_a, uv_b, levels[level], tol)
        chord = b - a
        length = np.linalg.norm(chord, axis=1)
        safe = np.where(length > tol, length, 1.0)
        at = ((middle - a) * chord).sum(axis=1) / safe**2
        offset = np.linalg.norm(middle - a - np.clip(at, 0.0, 1.0)[:, None] * chord, axis=1)
        between = found & (np.minimum(at, 1.0 - at) > MIN_MIDDLE_FRACTION) & (length > tol)
        at = np.where(between, at, 0.5)
        sagitta = np.where(between, -_cross(chord, middle - a) / safe / (4.0 * at * (1.0 - at)), 0.0)
        long = (np.abs(sagitta) > chord_error) | (found & (offset > chord_error))
        if split == MAX_SPLITS:
            unresolved += int(long.sum())
            long[:] = False
        kept = np.flatnonzero(~long)
        tails.append(tail[kept])
        heads.append(head[kept])
        slopes = [np.full(len(kept), np.inf), np.full(len(kept), np.inf)]
        smooth = np.flatnonzero(between[kept])
        for slope, uv in zip(slopes, (uv_a, uv_b), strict=True):
            own = kept[smooth]
            slope[smooth] = _slopes(surfaces, face[own], uv[own], chord[own])
        beyonds.append(_areas_beyond(at[kept], sagitta[kept], length[kept], *slopes))
        lengths.append((length + 8.0 / 3.0 * sagitta**2 / safe)[kept])
        if not long.any():
            break
        new = count + np.arange(int(long.sum()))
        count += len(new)
        points.append(middle[long])
        marks.append(level[long])
        tail, head = np.concatenate([tail[long], new]), np.concatenate([new, head[long]])
        a, b = np.concatenate([a[long], middle[long]]), np.concatenate([middle[long], b[long]])
        uv_a, uv_b = (
            np.concatenate([uv_a[long], middle_uv[long]]),
            np.concatenate([middle_uv[long], uv_b[long]]),
        )
        level, face = np.tile(level[long], 2), np.tile(face[long], 2)
    return _Arcs(
        np.concatenate(points),
        np.concatenate(marks),
        np.concatenate(tails),
        np.concatenate(heads),
        np.concatenate(beyonds),
        np.concatenate(lengths),
        unresolved,
    )


def _slopes(surfaces: SurfaceTable, face: IntArray, uv: Array, chord: Array) -> Array:
    """Slopes against chords (n, 2), to their left, of contours at parameters (n, 2); infinite where the face is horizontal."""
    _, xu, xv = surfaces(face, uv)
    tangent = xv[:, 2, None] * xu[:, :2] - xu[:, 2, None] * xv[:, :2]
    along = (tangent * chord).sum(axis=1)
    return np.divide(_cross(chord, tangent), along, out=np.full(len(uv), np.inf), where=along != 0.0)


def _areas_beyond(at: Array, sagitta: Array, length: Array, slope_a: Array, slope_b: Array) -> Array:
    """Areas (n,) between chords and contours to their right, from slopes at both ends and the point above the fraction `at`.

    The contour is x (1 - x) (p + q x + r x^2), in lengths of the chord, and its area p/6 + q/12 + r/20. Where its slope exceeds
    MAX_SLOPE, as where the face is horizontal, it is the parabola of the sagitta.
    """
    bump = 4.0 * sagitta / np.where(length > 0.0, length, 1.0)  # y / (x (1 - x)) at the point
    steep = np.maximum(np.abs(slope_a), np.abs(slope_b)) > MAX_SLOPE
    p = np.where(steep, bump, -slope_a)
    rise = np.where(steep, 0.0, slope_b - p)
    r = (bump - p - rise * at) / (at * (at - 1.0))
    return np.asarray(length**2 * (p / 6.0 + (rise - r) / 12.0 + r / 20.0))


def _find_middles(
    surfaces: SurfaceTable, face: IntArray, uv_a: Array, uv_b: Array, height: Array, tol: float
) -> tuple[Array, Array, BoolArray]:
    """Parameters (n, 2) and point (n, 2) of the contour near the middle of segments, and whether it was found (n,)."""
    uv = 0.5 * (uv_a + uv_b)
    reach = np.linalg.norm(uv_b - uv_a, axis=1)
    for _ in range(NEWTON_STEPS):
        x, xu, xv = surfaces(face, uv)
        off = x[:, 2] - height
        if (np.abs(off) <= tol).all():
            break
        gradient = np.stack([xu[:, 2], xv[:, 2]], axis=1)
        steepness = np.linalg.norm(gradient, axis=1)
        far = np.abs(off) > reach * steepness  # a step over the length of the segment is cut off; it may be infinite
        step = np.where(far, np.copysign(reach, off), off / np.where(far, 1.0, steepness))
        uv = uv - step[:, None] * gradient / np.where(steepness > 0.0, steepness, 1.0)[:, None]
    return uv, x[:, :2], np.abs(off) <= tol


def _cross(a: Array, b: Array) -> Array:
    """z-component of the cross products of vectors (n, 2): (n,)."""
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


def _reorder(points: Array, starts: IntArray, order: IntArray) -> tuple[Array, IntArray]:
    """Contours in another order."""
    sizes = np.diff(starts)[order]
    first = np.concatenate([[0], np.cumsum(sizes)])
    index = np.repeat(starts[:-1][order] - first[:-1], sizes) + np.arange(first[-1])
    return points[index], first.astype(np.int64)


def _join(parts: Sequence[LayerContours], levels_of: Sequence[IntArray], n_levels: int) -> LayerContours:
    """Contours of several parts, layer by layer, without repeated points and contours of fewer than 3 points.

    levels_of: numbers of the levels of each part.
    """
    points = np.concatenate([np.zeros((0, 2)), *(part.points for part in parts)])
    offsets = np.cumsum([0, *(len(part.points) for part in parts)])
    starts = np.concatenate([part.starts[:-1] + at for part, at in zip(parts, offsets, strict=False)] + [offsets[-1:]])
    layer = np.concatenate(
        [np.zeros(0, np.int64), *(own[part.layer] for part, own in zip(parts, levels_of, strict=True))]
    )
    contour = np.repeat(np.arange(len(layer)), np.diff(starts))
    before = np.arange(len(points)) - 1
    before[starts[:-1]] = starts[1:] - 1
    kept = (points != points[before]).any(axis=1) if len(points) else np.zeros(0, bool)
    sizes = np.bincount(contour[kept], minlength=len(layer))
    kept &= (sizes >= 3)[contour]
    sizes = np.where(sizes >= 3, sizes, 0)
    first = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
    points, first = points[kept], np.append(first[:-1][sizes > 0], first[-1])
    layer = layer[sizes > 0]
    points, first = _reorder(points, first, np.argsort(layer, kind="stable"))
    areas, perimeters = np.zeros(n_levels), np.zeros(n_levels)
    for part, own in zip(parts, levels_of, strict=True):
        areas[own] += part.areas
        perimeters[own] += part.perimeters
    return LayerContours(
        points,
        first,
        np.sort(layer, kind="stable"),
        areas,
        perimeters,
        sum(part.unresolved for part in parts),
    )
