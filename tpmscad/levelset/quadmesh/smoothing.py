"""What the polygons of a layout ask of their corners: to go where they are in the regular polygon nearest to each.

The nearest regular n-gon has the same centre, and its corners turned back by 2 pi k / n have the same mean.

Vertices of a layout moved along the level set until the polygons are near regular.

Each polygon pulls its corners towards the regular polygon that fits it best, the harder the worse it is; each vertex goes to the
mean of what its polygons ask for, less what leaves the surface, and is brought back onto it by Newton's method. Vertices on the
box slide in its faces; those on its edges stay where the field vanishes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.fields.field import Field
from tpmscad.levelset.quadmesh.dual_mesh import QuadMesh
from tpmscad.levelset.quadmesh.vectors import (
    MIN_DIVISOR,
    close_triangles,
    corner_sines,
    cross,
    dot,
    gather,
    length,
    normalize,
    roll_next,
    roll_previous,
    sines_between_sides,
)

MIN_WEIGHTED_SINE, WEIGHT_POWER = 0.1, 2
"""A polygon pulls with 1 / max(least sine of its corners, WORST)^POWER: without that, layouts with necks keep turned corners."""


def average_target_positions(vertices: Array, normals: Array, polygons: Sequence[IntArray]) -> tuple[Array, Array]:
    """The mean of what polygons, given by their number of corners (Q, n), ask of each vertex, (V, 3), and the shortest of their
    sides there, (V,); nothing and infinity for vertices of none of them."""
    count = len(vertices)
    wanted, share, shortest = np.zeros((3, count)), np.zeros(count), np.full(count, np.inf)
    for corners in polygons:
        points, at = gather(vertices, corners), corners.ravel()
        side = roll_next(points) - points
        size = length(side)
        sine = sines_between_sides(side, size, gather(normals, corners)).min(axis=1)
        pull = 1.0 / np.clip(sine, MIN_WEIGHTED_SINE, 1.0) ** WEIGHT_POWER
        target = pull[:, None] * fit_regular_polygons(points)
        share += np.bincount(at, np.repeat(pull, corners.shape[1]), minlength=count)
        for axis in range(3):
            wanted[axis] += np.bincount(at, target[axis].ravel(), minlength=count)
        np.minimum.at(shortest, at, np.minimum(size, roll_previous(size)).ravel())
    return (wanted / np.maximum(share, MIN_DIVISOR)).T, shortest


def fit_regular_polygons(points: Array) -> Array:
    """The regular n-gons nearest to polygons (3, Q, n)."""
    n = points.shape[2]
    centre = points.mean(axis=2, keepdims=True)
    spokes = points - centre
    normal = cross(spokes, roll_next(spokes)).sum(axis=2)
    normal /= np.maximum(length(normal), MIN_DIVISOR)
    first = spokes[:, :, 0] - dot(spokes[:, :, 0], normal) * normal
    first /= np.maximum(length(first), MIN_DIVISOR)
    second = cross(normal, first)
    along, across = dot(spokes, first[:, :, None]), dot(spokes, second[:, :, None])
    cos, sin = np.cos(2 * np.pi / n * np.arange(n)), np.sin(2 * np.pi / n * np.arange(n))
    x, y = (along @ cos + across @ sin) / n, (across @ cos - along @ sin) / n
    return np.asarray(
        centre
        + first[:, :, None] * (x[:, None] * cos - y[:, None] * sin)
        + second[:, :, None] * (x[:, None] * sin + y[:, None] * cos)
    )


__all__ = ["corner_sines", "project_to_level_set", "smooth_mesh", "smooth_vertices"]

SMOOTHING_SWEEPS = 60
"""Sweeps of the relaxation; the worst corner of single-period layouts no longer changes after 40."""

MIN_BOX_SIDE_RATIO = 0.3
"""A vertex in a face of the box keeps the shorter of its two sides there at least this part of the longer: where the surface cuts
off a small corner of the box, the large polygons beside would else pull the vertex out of it."""

MAX_NEWTON_STEPS, MAX_NEWTON_STEPS_FROM_AFAR = 12, 30
NEWTON_TOL_OF_REACH = 1e-8
"""A step below this part of the reach is Newton's last: what is left is of the order of its square, below round-off."""

RINGS_AROUND_NEW_VERTICES = 2
SAME_START_TOL = 1e-10
"""Vertices of two trees are the same if they start this close, in diagonals of the box."""

MAX_MOVE_FRACTION = 0.25
"""Greatest move of a vertex in one step, in sizes of its cell and in lengths of its shortest side."""

SWEEPS_PER_BLOCK, REST_MOVE_FRACTION = 5, 0.03
"""Sweeps after which vertices rest that the last has moved by less than this part of the greatest step."""


def project_to_level_set(
    field: Field, points: Array, fixed: BoolArray, reach: Array, iterations: int = MAX_NEWTON_STEPS
) -> Array:
    """Points (n, 3) brought onto {field = 0} by Newton's method along the gradient of their free coordinates.

    `reach` (n,) bounds the length of a single step.
    """
    points = points.copy()
    active = np.arange(len(points))
    for _ in range(iterations):
        value, slope = field.value_and_gradient(points[active])
        slope = np.where(fixed[active], 0.0, slope)
        square = np.einsum("ni,ni->n", slope, slope)
        step = -(value / np.maximum(square, MIN_DIVISOR))[:, None] * slope
        length = np.linalg.norm(step, axis=1)
        shorten = np.minimum(1.0, reach[active] / np.maximum(length, MIN_DIVISOR))
        points[active] += shorten[:, None] * step
        active = active[length > NEWTON_TOL_OF_REACH * reach[active]]
        if len(active) == 0:
            break
    return points


def smooth_mesh(
    mesh: QuadMesh, field: Field, lo: Array, hi: Array, sweeps: int = SMOOTHING_SWEEPS, before: QuadMesh | None = None
) -> QuadMesh:
    """The mesh with its vertices on the level set in the box, polygons as regular as the sweeps make them.

    `before`: a relaxed mesh of a coarser tree. Vertices that started where one of its vertices did go on from there, and stay
    there, bit for bit, but for those within RINGS polygons of one that is new.
    """
    if before is None:
        return smooth_vertices(mesh, np.ones(len(mesh.vertices), bool), field, lo, hi, sweeps)
    distance, same = cKDTree(before.start).query(mesh.start)
    old = distance <= SAME_START_TOL * np.linalg.norm(hi - lo)
    mesh = replace(mesh, vertices=np.where(old[:, None], before.vertices[same], mesh.start))
    free = ~old
    if free.all():
        return smooth_vertices(mesh, free, field, lo, hi, sweeps)
    free = dilate_vertices(mesh, free, RINGS_AROUND_NEW_VERTICES)
    touched = np.asarray((free[mesh.corners] & (mesh.corners >= 0)).any(axis=1))
    part, of = _extract_submesh(mesh, touched)
    vertices = mesh.vertices.copy()
    vertices[of] = smooth_vertices(part, free[of], field, lo, hi, sweeps).vertices
    return replace(mesh, vertices=vertices)


def _extract_submesh(mesh: QuadMesh, polygons: BoolArray) -> tuple[QuadMesh, IntArray]:
    """The mesh of the chosen polygons, and which of the mesh's vertices it has."""
    corners, sides = mesh.corners[polygons], mesh.sides[polygons]
    of, place = np.unique(corners[corners >= 0], return_inverse=True)
    used, side_place = np.unique(sides[sides >= 0], return_inverse=True)
    small_corners, small_sides = np.full(corners.shape, -1), np.full(sides.shape, -1)
    small_corners[corners >= 0], small_sides[sides >= 0] = place.ravel(), side_place.ravel()
    part = QuadMesh(
        mesh.vertices[of], mesh.start[of], mesh.fixed[of], mesh.cell[of], mesh.size[of], small_corners, small_sides,
        np.searchsorted(of, mesh.side_ends[used]), mesh.side_plane[used],
    )  # fmt: skip
    return part, of


def smooth_vertices(
    mesh: QuadMesh, free: BoolArray, field: Field, lo: Array, hi: Array, sweeps: int, normals: Array | None = None
) -> QuadMesh:
    """The mesh with its `free` (V,) vertices relaxed and on the level set; the others stay where they are, bit for bit.

    Vertices slide along the surface and are taken back towards it in one step, with what the field is where they come from; the
    last sweep ends with all of Newton's. Every PAUSE sweeps those rest that, with all round them, have moved less than STILL.
    `normals` (V, 3): of the surface, if known, at the vertices that stay.
    """
    reach = MAX_MOVE_FRACTION * mesh.size
    at = np.flatnonzero(free)
    vertices = mesh.vertices.copy()
    vertices[at] = _project_within_box(field, vertices[at], vertices[at], mesh.fixed[at], reach[at], lo, hi)
    normals = normalize(field.gradient(vertices)) if normals is None else normals.copy()
    moving = free & (mesh.fixed.sum(axis=1) < 2)
    for done in range(0, sweeps, SWEEPS_PER_BLOCK):
        at = np.flatnonzero(moving)
        if not len(at):
            break
        pulls = _moving_polygons(mesh, moving)
        rim, beside = _box_face_neighbours(mesh, moving)
        fixed, far = mesh.fixed[at], reach[at]
        for _ in range(min(SWEEPS_PER_BLOCK, sweeps - done)):
            here = vertices[at]
            value, slope = field.value_and_gradient(here)
            normals[at] = normalize(slope)
            wanted, shortest = average_target_positions(vertices, normals, pulls)
            slope = np.where(fixed, 0.0, slope)
            normal = normalize(slope)
            move = np.where(fixed, 0.0, wanted[at] - here)
            move -= np.einsum("ni,ni->n", move, normal)[:, None] * normal
            move *= _limit_step_factors(move, np.minimum(far, MAX_MOVE_FRACTION * shortest[at]))
            step = -(value / np.maximum(np.einsum("ni,ni->n", slope, slope), MIN_DIVISOR))[:, None] * slope
            there = here + move + _limit_step_factors(step, far) * step
            out = np.flatnonzero(((there < lo) | (there > hi)).any(axis=1))
            if len(out):
                there[out] = _project_along_box_faces(field, here[out], there[out], fixed[out], far[out], lo, hi)
            before = _side_length_ratio(vertices, rim, beside)
            vertices[at] = there
            after = _side_length_ratio(vertices, rim, beside)
            back = rim[(after < MIN_BOX_SIDE_RATIO) & (after < before)]
            vertices[back] = here[np.searchsorted(at, back)]
        moved = np.zeros(len(vertices), bool)
        moved[at] = np.linalg.norm(vertices[at] - here, axis=1) > REST_MOVE_FRACTION * far
        moving &= dilate_vertices(mesh, moved)
    at = np.flatnonzero(free)
    vertices[at] = _project_within_box(field, vertices[at], vertices[at], mesh.fixed[at], reach[at], lo, hi)
    return replace(mesh, vertices=vertices)


def _limit_step_factors(steps: Array, most: Array) -> Array:
    """What steps (n, 3) are multiplied with to be at most so long, (n, 1)."""
    return np.minimum(1.0, most / np.maximum(np.linalg.norm(steps, axis=1), MIN_DIVISOR))[:, None]


def _project_within_box(
    field: Field, old: Array, new: Array, fixed: BoolArray, reach: Array, lo: Array, hi: Array
) -> Array:
    """Points (n, 3) brought onto the surface in the box."""
    points = project_to_level_set(field, new, fixed, reach, MAX_NEWTON_STEPS_FROM_AFAR)
    out = np.flatnonzero(((points < lo) | (points > hi)).any(axis=1))
    if len(out):
        points[out] = _project_along_box_faces(field, old[out], points[out], fixed[out], reach[out], lo, hi)
    return points


def _project_along_box_faces(
    field: Field, old: Array, new: Array, fixed: BoolArray, reach: Array, lo: Array, hi: Array
) -> Array:
    """Points that would leave the box for `new` (n, 3), brought onto the surface from `old` parallel to the faces they would
    leave by, or left there: the surface goes on beyond the box, the layout does not."""
    points = project_to_level_set(field, old, fixed | (new < lo) | (new > hi), reach)
    stays = np.asarray(((points < lo) | (points > hi)).any(axis=1))
    return np.where(stays[:, None], old, points)


def _side_length_ratio(vertices: Array, rim: IntArray, beside: IntArray) -> Array:
    """The shorter of the two sides in a face of the box at each vertex of the rim, as a part of the longer."""
    one, other = (np.linalg.norm(vertices[rim] - vertices[beside[:, i]], axis=1) for i in (0, 1))
    return np.asarray(np.minimum(one, other) / np.maximum(np.maximum(one, other), MIN_DIVISOR))


def dilate_vertices(mesh: QuadMesh, vertices: BoolArray, rings: int = 1) -> BoolArray:
    """The vertices (V,) and those within so many polygons of them."""
    corners, result = close_triangles(mesh.corners), vertices.copy()
    for _ in range(rings):
        result[corners[result[corners].any(axis=1)]] = True
    return result


def _moving_polygons(mesh: QuadMesh, moving: BoolArray) -> list[IntArray]:
    """The quadrilaterals (Q, 4) and triangles (T, 3) at vertices that move."""
    three = mesh.corners[:, 3] < 0
    groups = (mesh.corners[~three], mesh.corners[three][:, :3])
    return [corners[moving[corners].any(axis=1)] for corners in groups]


def _box_face_neighbours(mesh: QuadMesh, moving: BoolArray) -> tuple[IntArray, IntArray]:
    """Vertices that move inside faces of the box, (n,), and their two neighbours in the same face, (n, 2)."""
    ends = mesh.side_ends[mesh.side_plane >= 0]
    start, end = np.concatenate([ends, ends[:, ::-1]]).T
    order = np.argsort(start, kind="stable")
    start, end = start[order], end[order]
    first = np.flatnonzero((start[:-1] == start[1:]) & (mesh.fixed[start[:-1]].sum(axis=1) == 1) & moving[start[:-1]])
    return start[first], np.stack([end[first], end[first + 1]], axis=1)
