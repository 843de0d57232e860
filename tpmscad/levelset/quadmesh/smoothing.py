"""Smoothing of a quad mesh on a level set: vertices slide along it until the polygons are nearly regular.

Each polygon proposes for its corners the positions they have in the regular polygon nearest to it, as in the projections of shape
constraints by Bouaziz et al., "Shape-Up", 2012. A vertex moves to the weighted mean of the proposals, where polygons of poor
shape have larger weights, less the component normal to the level set, and one Newton step returns it to the level set. Vertices
in a face of the box slide in that face; those on an edge of the box stay where the field vanishes.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.fields.field import Field
from tpmscad.levelset.quadmesh.dual_mesh import QuadMesh
from tpmscad.levelset.quadmesh.regular_polygons import average_target_positions
from tpmscad.levelset.quadmesh.vectors import MIN_DIVISOR, close_triangles, normalize

SMOOTHING_SWEEPS = 60
"""Sweeps over the mesh of an octree."""

SWEEPS_PER_BLOCK = 5
"""Sweeps between two updates of the set of moving vertices."""

REST_MOVE_FRACTION = 0.03
"""A vertex rests once the last sweep of a block moved it, and all its neighbours, by less than this fraction of the largest
step."""

MAX_NEWTON_STEPS = 12
MAX_NEWTON_STEPS_FROM_AFAR = 30
NEWTON_TOL_OF_MAX_STEP = 1e-8
"""Newton's method ends with a step below this fraction of the largest one: the remaining error, its square, is below
round-off."""

RINGS_AROUND_NEW_VERTICES = 2
"""Rings of polygons round new vertices that are smoothed again after a refinement."""

RINGS_AROUND_FOLDED_POLYGONS = 4
"""Rings of polygons round a folded one whose vertices are put back to where they started: vertices that slid far on a coarser
mesh leave no room for new ones between them."""

ROUNDING_FRACTION = 2.0**-32
"""Positions are rounded to multiples of this fraction of the box in every sweep. A mesh with a symmetry can be in an unstable
equilibrium: round-off then grows by twelve orders of magnitude in sixty sweeps, and decides on the shape of the polygons."""

SAME_START_TOL = 1e-10
"""Distance, in diagonals of the box, within which start positions on two octrees are the same vertex."""


def project_to_level_set(
    field: Field, points: Array, fixed: BoolArray, max_step: Array, iterations: int = MAX_NEWTON_STEPS
) -> Array:
    """Points (n, 3) projected onto {field = 0} by Newton's method along the gradient in their free coordinates.

    `fixed` (n, 3) marks coordinates that stay; `max_step` (n,) bounds the length of a single step.
    """
    return project_with_gradients(field, points, fixed, max_step, iterations, NEWTON_TOL_OF_MAX_STEP)[0]


def project_with_gradients(
    field: Field, points: Array, fixed: BoolArray, max_step: Array, iterations: int, tol_of_max_step: float
) -> tuple[Array, Array]:
    """The points projected with steps down to a fraction of the largest one, and gradients (n, 3) where the last steps began."""
    points = np.array(points, order="C")
    gradients, active = np.empty(points.shape), np.arange(len(points))
    for _ in range(iterations):
        value, gradient = field.value_and_gradient(points[active] if len(active) < len(points) else points)
        gradients[active] = gradient
        free = np.where(fixed[active], 0.0, gradient)
        square = np.einsum("ni,ni->n", free, free)
        factor, longest = -value / np.maximum(square, MIN_DIVISOR), max_step[active]
        size = np.abs(factor) * np.sqrt(square)
        points[active] += (np.minimum(1.0, longest / np.maximum(size, MIN_DIVISOR)) * factor)[:, None] * free
        active = active[size > tol_of_max_step * longest]
        if len(active) == 0:
            break
    return points, gradients


def smooth_mesh(
    mesh: QuadMesh, field: Field, lo: Array, hi: Array, sweeps: int = SMOOTHING_SWEEPS, coarser: QuadMesh | None = None
) -> QuadMesh:
    """The mesh with its vertices on the level set in the box and its polygons smoothed.

    `coarser` is the smoothed mesh of a coarser octree. Its vertices with the same start position are reused bit for bit, except
    those within RINGS_AROUND_NEW_VERTICES rings of a new vertex, which are smoothed again from there.
    """
    if coarser is None:
        return smooth_vertices(mesh, np.ones(len(mesh.vertices), bool), field, lo, hi, sweeps)
    distance, same = cKDTree(coarser.start_positions).query(mesh.start_positions)
    old = distance <= SAME_START_TOL * np.linalg.norm(hi - lo)
    mesh = replace(mesh, vertices=np.where(old[:, None], coarser.vertices[same], mesh.start_positions))
    free = ~old
    if free.all():
        return smooth_vertices(mesh, free, field, lo, hi, sweeps)
    return _smooth_part(mesh, dilate_vertices(mesh, free, RINGS_AROUND_NEW_VERTICES), field, lo, hi, sweeps)


def smooth_from_start(
    mesh: QuadMesh, folded: BoolArray, field: Field, lo: Array, hi: Array, sweeps: int = SMOOTHING_SWEEPS
) -> QuadMesh:
    """The mesh with the vertices round `folded` polygons (Q,) put back to their start positions and smoothed from there."""
    reset = np.zeros(len(mesh.vertices), bool)
    reset[close_triangles(mesh.corners[folded])] = True
    reset = dilate_vertices(mesh, reset, RINGS_AROUND_FOLDED_POLYGONS)
    mesh = replace(mesh, vertices=np.where(reset[:, None], mesh.start_positions, mesh.vertices))
    return _smooth_part(mesh, dilate_vertices(mesh, reset, RINGS_AROUND_NEW_VERTICES), field, lo, hi, sweeps)


def _smooth_part(mesh: QuadMesh, free: BoolArray, field: Field, lo: Array, hi: Array, sweeps: int) -> QuadMesh:
    """As `smooth_vertices`, on the polygons at the free vertices only."""
    touched = np.asarray((free[mesh.corners] & (mesh.corners >= 0)).any(axis=1))
    part, ids = extract_submesh(mesh, touched)
    vertices = mesh.vertices.copy()
    vertices[ids] = smooth_vertices(part, free[ids], field, lo, hi, sweeps).vertices
    return replace(mesh, vertices=vertices)


def smooth_vertices(
    mesh: QuadMesh, free: BoolArray, field: Field, lo: Array, hi: Array, sweeps: int, normals: Array | None = None
) -> QuadMesh:
    """The mesh with its `free` vertices (V,) smoothed on the level set; the others stay, bit for bit.

    During the sweeps a vertex takes one Newton step at a time, with the field evaluated at its old position, and free coordinates
    are rounded; in the end it is projected to convergence. `normals` (V, 3), if given, are the unit normals at the vertices that
    stay.
    """
    max_step = MAX_MOVE_FRACTION * mesh.size
    free_ids = np.flatnonzero(free)
    vertices = mesh.vertices.copy()
    vertices[free_ids] = _project_within_box(
        field, vertices[free_ids], mesh.fixed[free_ids], max_step[free_ids], lo, hi
    )
    normals = normalize(field.gradient(vertices)) if normals is None else normals.copy()
    moving = free & (mesh.fixed.sum(axis=1) < 2)
    grid = ROUNDING_FRACTION * (hi - lo)
    for done in range(0, sweeps, SWEEPS_PER_BLOCK):
        ids = np.flatnonzero(moving)
        if not len(ids):
            break
        polygons = _polygons_at(mesh, moving)
        on_face, neighbours = _box_face_neighbours(mesh, moving)
        fixed, longest = mesh.fixed[ids], max_step[ids]
        for _ in range(min(SWEEPS_PER_BLOCK, sweeps - done)):
            old = vertices[ids]
            value, gradient = field.value_and_gradient(old)
            normals[ids] = normalize(gradient)
            target, shortest = average_target_positions(vertices, normals, polygons)
            new = step_along_surface(old, target[ids], shortest[ids], value, gradient, fixed, longest)
            out = np.flatnonzero(((new < lo) | (new > hi)).any(axis=1))
            if len(out):
                new[out] = _project_along_box_faces(field, old[out], new[out], fixed[out], longest[out], lo, hi)
            place_vertices(
                vertices, ids, np.where(fixed, new, lo + grid * np.rint((new - lo) / grid)), on_face, neighbours
            )
        moved = np.zeros(len(vertices), bool)
        moved[ids] = np.linalg.norm(vertices[ids] - old, axis=1) > REST_MOVE_FRACTION * longest
        moving &= dilate_vertices(mesh, moved)
    vertices[free_ids] = _project_within_box(
        field, vertices[free_ids], mesh.fixed[free_ids], max_step[free_ids], lo, hi
    )
    return replace(mesh, vertices=vertices)


def dilate_vertices(mesh: QuadMesh, vertices: BoolArray, rings: int = 1) -> BoolArray:
    """The vertices (V,) and all others within `rings` rings of polygons round them."""
    corners, result = close_triangles(mesh.corners), vertices.copy()
    for _ in range(rings):
        result[corners[result[corners].any(axis=1)]] = True
    return result


def _project_within_box(field: Field, old: Array, fixed: BoolArray, max_step: Array, lo: Array, hi: Array) -> Array:
    """Points (n, 3) projected onto the level set inside the box."""
    points = project_to_level_set(field, old, fixed, max_step, MAX_NEWTON_STEPS_FROM_AFAR)
    out = np.flatnonzero(((points < lo) | (points > hi)).any(axis=1))
    if len(out):
        points[out] = _project_along_box_faces(field, old[out], points[out], fixed[out], max_step[out], lo, hi)
    return points


def _project_along_box_faces(
    field: Field, old: Array, new: Array, fixed: BoolArray, max_step: Array, lo: Array, hi: Array
) -> Array:
    """Projections of `old` (n, 3) parallel to the faces of the box that `new` lies beyond; `old` where these leave it, too."""
    points = project_to_level_set(field, old, fixed | (new < lo) | (new > hi), max_step)
    stays = np.asarray(((points < lo) | (points > hi)).any(axis=1))
    return np.where(stays[:, None], old, points)


def _polygons_at(mesh: QuadMesh, chosen: BoolArray) -> list[IntArray]:
    """The quadrilaterals (Q, 4) and triangles (T, 3) with a corner among the chosen vertices (V,)."""
    triangular = mesh.corners[:, 3] < 0
    groups = (mesh.corners[~triangular], mesh.corners[triangular][:, :3])
    return [corners[chosen[corners].any(axis=1)] for corners in groups]


def _box_face_neighbours(mesh: QuadMesh, moving: BoolArray) -> tuple[IntArray, IntArray]:
    """Moving vertices (n,) inside faces of the box, and their two neighbours (n, 2) in the same face."""
    ends = mesh.side_ends[mesh.side_plane >= 0]
    start, end = np.concatenate([ends, ends[:, ::-1]]).T
    order = np.argsort(start, kind="stable")
    start, end = start[order], end[order]
    first = np.flatnonzero((start[:-1] == start[1:]) & (mesh.fixed[start[:-1]].sum(axis=1) == 1) & moving[start[:-1]])
    return start[first], np.stack([end[first], end[first + 1]], axis=1)


def extract_submesh(mesh: QuadMesh, polygons: BoolArray) -> tuple[QuadMesh, IntArray]:
    """The mesh of the chosen polygons (Q,), and the numbers (V',) of its vertices in the whole mesh."""
    corners, sides = mesh.corners[polygons], mesh.sides[polygons]
    ids, renumbered = np.unique(corners[corners >= 0], return_inverse=True)
    side_ids, renumbered_sides = np.unique(sides[sides >= 0], return_inverse=True)
    small_corners, small_sides = np.full(corners.shape, -1), np.full(sides.shape, -1)
    small_corners[corners >= 0], small_sides[sides >= 0] = renumbered.ravel(), renumbered_sides.ravel()
    part = QuadMesh(
        mesh.vertices[ids], mesh.start_positions[ids], mesh.fixed[ids], mesh.leaf[ids], mesh.size[ids],
        small_corners, small_sides, np.searchsorted(ids, mesh.side_ends[side_ids]), mesh.side_plane[side_ids],
    )  # fmt: skip
    return part, ids


MAX_MOVE_FRACTION = 0.25
"""Largest step of a vertex, as a fraction of its leaf and of its shortest side."""

MIN_BOX_SIDE_RATIO = 0.3
"""Least ratio of the two sides in a face of the box at a vertex. Where the level set cuts off a small corner of the box, the
large polygons beside it would otherwise pull the vertex out of the box."""


def step_along_surface(
    old: Array, target: Array, shortest: Array, value: Array, gradient: Array, fixed: BoolArray, max_step: Array
) -> Array:
    """New positions (n, 3): a tangential step towards the target and one Newton step towards the level set.

    Vertices move from `old` (n, 3), with the field's value and gradient there, in the coordinates that are not fixed. `shortest`
    (n,) are the lengths of their shortest sides.
    """
    free = np.where(fixed, 0.0, gradient)
    normal, move = normalize(free), np.where(fixed, 0.0, target - old)
    move -= (move * normal).sum(axis=1, keepdims=True) * normal
    newton = -(value / np.maximum((free * free).sum(axis=1), MIN_DIVISOR))[:, None] * free
    return old + _shorten(move, np.minimum(max_step, MAX_MOVE_FRACTION * shortest)) + _shorten(newton, max_step)


def _shorten(steps: Array, longest: Array) -> Array:
    """Steps (n, 3) of at most the lengths (n,)."""
    size = np.linalg.norm(steps, axis=1)
    return np.asarray(np.minimum(1.0, longest / np.maximum(size, MIN_DIVISOR))[:, None] * steps)


def place_vertices(vertices: Array, ids: IntArray, new: Array, on_face: IntArray, neighbours: IntArray) -> None:
    """Move vertices `ids` (n,) to the positions `new` (n, 3).

    Vertices `on_face` (m,) of the box stay where the move would leave their sides to `neighbours` (m, 2) too unequal.
    """
    before, ratio_before = vertices[on_face], _side_length_ratios(vertices, on_face, neighbours)
    vertices[ids] = new
    ratio = _side_length_ratios(vertices, on_face, neighbours)
    stays = (ratio < MIN_BOX_SIDE_RATIO) & (ratio < ratio_before)
    vertices[on_face[stays]] = before[stays]


def _side_length_ratios(vertices: Array, ids: IntArray, neighbours: IntArray) -> Array:
    """Ratios (n,), at most 1, of the distances from vertices (n,) to their two neighbours (n, 2)."""
    sides = np.linalg.norm(vertices[neighbours] - vertices[ids][:, None], axis=2)
    return np.asarray(sides.min(axis=1) / np.maximum(sides.max(axis=1), MIN_DIVISOR))
