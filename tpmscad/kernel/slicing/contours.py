"""Closed contours of a solid in horizontal planes, straight from its faces, within a chord error.

Segments between the crossings of a triangulation (`level_crossings`) are split at points of the exact contour until the chords
keep the error (`chord_splitting`). Areas are those inside the exact contours, not the polygons.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.brep.loops import follow_paths
from tpmscad.index_ranges import expand_ranges, list_preceding
from tpmscad.kernel.export.solid_mesh import mesh_parametrically
from tpmscad.kernel.occt.bounding_boxes import box_diagonal
from tpmscad.kernel.occt.exploration import unwrap
from tpmscad.kernel.slicing.chord_splitting import cross, split_chords
from tpmscad.kernel.slicing.level_crossings import LevelSets, find_crossings
from tpmscad.kernel.slicing.level_refinement import resolve_levels
from tpmscad.kernel.slicing.surface_triangulation import SurfaceTriangulation, triangulation_of
from tpmscad.parallel import split_batches, task_runner

MESH_DEVIATION_FACTOR, LEAST_MESH_DEVIATION = 2.0, 1e-5
"""Deviation of the triangulation in chord errors, and the least one in sizes of the solid; chords are split afterwards anyway."""

MESH_ANGLE = 0.5
"""Radians between neighbouring facets of the triangulation."""

LEVELS_PER_TASK = 125
"""Levels cut by one task, so that eight tasks share a thousand; patches that reach beyond them are resolved in two."""

CONTOUR_REL_TOL = 1e-10
"""Distance from the level, in sizes of the solid, up to which a point counts as one of the contour."""


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
    least = LEAST_MESH_DEVIATION * box_diagonal(unwrap(shape))
    meshes = mesh_parametrically(shape, max(MESH_DEVIATION_FACTOR * chord_error, least), MESH_ANGLE)
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
        return join_contours(run_tasks(_slice_part, tasks), batch_of, len(levels))


def _slice_part(mesh: SurfaceTriangulation, levels: Array, chord_error: float, tol: float) -> LayerContours:
    """The contours of a part of one solid that holds all triangles which the levels meet, layers in any order."""
    sets = LevelSets.of_solid(levels, mesh)
    mesh = resolve_levels(mesh, sets)
    crossings = find_crossings(mesh, sets)
    arcs = split_chords(crossings, mesh.surfaces, levels, chord_error, tol)
    following = np.empty(len(arcs.point), np.int64)
    following[arcs.tail] = arcs.head
    order, starts = follow_paths(following)
    points, layer = arcs.point[order], arcs.level[order[starts[:-1]]]
    a, b = arcs.point[arcs.tail], arcs.point[arcs.head]
    origin = points.mean(axis=0) if len(points) else np.zeros(2)
    below = 0.5 * cross(a - origin, b - origin)
    of_segment = arcs.level[arcs.tail]
    areas = np.bincount(of_segment, below + arcs.beyond, len(levels))
    perimeters = np.bincount(of_segment, arcs.length, len(levels))
    return LayerContours(
        points, starts, layer, np.asarray(areas, float), np.asarray(perimeters, float), len(arcs.unresolved)
    )


def _reorder(points: Array, starts: IntArray, order: IntArray) -> tuple[Array, IntArray]:
    """Contours in another order."""
    _, index = expand_ranges(starts[:-1][order], starts[1:][order])
    return points[index], np.append(0, np.cumsum(np.diff(starts)[order]))


def join_contours(parts: Sequence[LayerContours], levels_of: Sequence[IntArray], n_levels: int) -> LayerContours:
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
    kept = (points != points[list_preceding(starts)]).any(axis=1) if len(points) else np.zeros(0, bool)
    sizes = np.bincount(contour[kept], minlength=len(layer))
    kept &= (sizes >= 3)[contour]
    sizes = np.where(sizes >= 3, sizes, 0)
    first = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
    points, first = points[kept], np.append(first[:-1][sizes > 0], first[-1])
    layer = layer[sizes > 0]
    if (np.diff(layer) < 0).any():
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
