"""Vertices of a layout moved along the level set until the polygons are near regular.

Each polygon pulls its corners towards the regular polygon that fits it best, the harder the worse it is; each vertex goes to the
mean of what its polygons ask for, less what leaves the surface, and is brought back onto it by Newton's method. Vertices on the
box slide in its faces; those on its edges stay where the field vanishes.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from tpmscad.fields.field import Field
from tpmscad.patches.levelset.layout.dual import Mesh
from tpmscad.patches.levelset.layout.octree import Array, Ints, Mask
from tpmscad.patches.levelset.layout.pull import asked
from tpmscad.patches.levelset.layout.vectors import TINY, corner_sines, filled, unit

__all__ = ["corner_sines", "onto", "relaxed", "settled"]

SWEEPS = 60
"""Sweeps of the relaxation; the worst corner of single-period layouts no longer changes after 40."""

BALANCE = 0.3
"""A vertex in a face of the box keeps the shorter of its two sides there at least this part of the longer: where the surface cuts
off a small corner of the box, the large polygons beside would else pull the vertex out of it."""

NEWTON, LONG = 12, 30
CONVERGED = 1e-8
"""A step below this part of the reach is Newton's last: what is left is of the order of its square, below round-off."""

RINGS = 2
SAME = 1e-10
"""Vertices of two trees are the same if they start this close, in diagonals of the box."""

STEP = 0.25
"""Greatest move of a vertex in one step, in sizes of its cell and in lengths of its shortest side."""

PAUSE, STILL = 5, 0.03
"""Sweeps after which vertices rest that the last has moved by less than this part of the greatest step."""


def onto(field: Field, points: Array, fixed: Mask, reach: Array, iterations: int = NEWTON) -> Array:
    """Points (n, 3) brought onto {field = 0} by Newton's method along the gradient of their free coordinates.

    `reach` (n,) bounds the length of a single step.
    """
    points = points.copy()
    active = np.arange(len(points))
    for _ in range(iterations):
        value, slope = field.value_and_gradient(points[active])
        slope = np.where(fixed[active], 0.0, slope)
        square = np.einsum("ni,ni->n", slope, slope)
        step = -(value / np.maximum(square, TINY))[:, None] * slope
        length = np.linalg.norm(step, axis=1)
        shorten = np.minimum(1.0, reach[active] / np.maximum(length, TINY))
        points[active] += shorten[:, None] * step
        active = active[length > CONVERGED * reach[active]]
        if len(active) == 0:
            break
    return points


def relaxed(mesh: Mesh, field: Field, lo: Array, hi: Array, sweeps: int = SWEEPS, before: Mesh | None = None) -> Mesh:
    """The mesh with its vertices on the level set in the box, polygons as regular as the sweeps make them.

    `before`: a relaxed mesh of a coarser tree. Vertices that started where one of its vertices did go on from there, and stay
    there, bit for bit, but for those within RINGS polygons of one that is new.
    """
    if before is None:
        return settled(mesh, np.ones(len(mesh.vertices), bool), field, lo, hi, sweeps)
    distance, same = cKDTree(before.start).query(mesh.start)
    old = distance <= SAME * np.linalg.norm(hi - lo)
    mesh = replace(mesh, vertices=np.where(old[:, None], before.vertices[same], mesh.start))
    free = ~old
    if free.all():
        return settled(mesh, free, field, lo, hi, sweeps)
    free = with_neighbours(mesh, free, RINGS)
    touched = np.asarray((free[mesh.corners] & (mesh.corners >= 0)).any(axis=1))
    part, of = _part(mesh, touched)
    vertices = mesh.vertices.copy()
    vertices[of] = settled(part, free[of], field, lo, hi, sweeps).vertices
    return replace(mesh, vertices=vertices)


def _part(mesh: Mesh, polygons: Mask) -> tuple[Mesh, Ints]:
    """The mesh of the chosen polygons, and which of the mesh's vertices it has."""
    corners, sides = mesh.corners[polygons], mesh.sides[polygons]
    of, place = np.unique(corners[corners >= 0], return_inverse=True)
    used, side_place = np.unique(sides[sides >= 0], return_inverse=True)
    small_corners, small_sides = np.full(corners.shape, -1), np.full(sides.shape, -1)
    small_corners[corners >= 0], small_sides[sides >= 0] = place.ravel(), side_place.ravel()
    part = Mesh(
        mesh.vertices[of], mesh.start[of], mesh.fixed[of], mesh.cell[of], mesh.size[of], small_corners, small_sides,
        np.searchsorted(of, mesh.side_ends[used]), mesh.side_plane[used],
    )  # fmt: skip
    return part, of


def settled(
    mesh: Mesh, free: Mask, field: Field, lo: Array, hi: Array, sweeps: int, normals: Array | None = None
) -> Mesh:
    """The mesh with its `free` (V,) vertices relaxed and on the level set; the others stay where they are, bit for bit.

    Vertices slide along the surface and are taken back towards it in one step, with what the field is where they come from; the
    last sweep ends with all of Newton's. Every PAUSE sweeps those rest that, with all round them, have moved less than STILL.
    `normals` (V, 3): of the surface, if known, at the vertices that stay.
    """
    reach = STEP * mesh.size
    at = np.flatnonzero(free)
    vertices = mesh.vertices.copy()
    vertices[at] = _inside(field, vertices[at], vertices[at], mesh.fixed[at], reach[at], lo, hi)
    normals = unit(field.gradient(vertices)) if normals is None else normals.copy()
    moving = free & (mesh.fixed.sum(axis=1) < 2)
    for done in range(0, sweeps, PAUSE):
        at = np.flatnonzero(moving)
        if not len(at):
            break
        pulls = _pulls(mesh, moving)
        rim, beside = _on_faces(mesh, moving)
        fixed, far = mesh.fixed[at], reach[at]
        for _ in range(min(PAUSE, sweeps - done)):
            here = vertices[at]
            value, slope = field.value_and_gradient(here)
            normals[at] = unit(slope)
            wanted, shortest = asked(vertices, normals, pulls)
            slope = np.where(fixed, 0.0, slope)
            normal = unit(slope)
            move = np.where(fixed, 0.0, wanted[at] - here)
            move -= np.einsum("ni,ni->n", move, normal)[:, None] * normal
            move *= _shortened(move, np.minimum(far, STEP * shortest[at]))
            step = -(value / np.maximum(np.einsum("ni,ni->n", slope, slope), TINY))[:, None] * slope
            there = here + move + _shortened(step, far) * step
            out = np.flatnonzero(((there < lo) | (there > hi)).any(axis=1))
            if len(out):
                there[out] = _parallel(field, here[out], there[out], fixed[out], far[out], lo, hi)
            before = _balance(vertices, rim, beside)
            vertices[at] = there
            after = _balance(vertices, rim, beside)
            back = rim[(after < BALANCE) & (after < before)]
            vertices[back] = here[np.searchsorted(at, back)]
        moved = np.zeros(len(vertices), bool)
        moved[at] = np.linalg.norm(vertices[at] - here, axis=1) > STILL * far
        moving &= with_neighbours(mesh, moved)
    at = np.flatnonzero(free)
    vertices[at] = _inside(field, vertices[at], vertices[at], mesh.fixed[at], reach[at], lo, hi)
    return replace(mesh, vertices=vertices)


def _shortened(steps: Array, most: Array) -> Array:
    """What steps (n, 3) are multiplied with to be at most so long, (n, 1)."""
    return np.minimum(1.0, most / np.maximum(np.linalg.norm(steps, axis=1), TINY))[:, None]


def _inside(field: Field, old: Array, new: Array, fixed: Mask, reach: Array, lo: Array, hi: Array) -> Array:
    """Points (n, 3) brought onto the surface in the box."""
    points = onto(field, new, fixed, reach, LONG)
    out = np.flatnonzero(((points < lo) | (points > hi)).any(axis=1))
    if len(out):
        points[out] = _parallel(field, old[out], points[out], fixed[out], reach[out], lo, hi)
    return points


def _parallel(field: Field, old: Array, new: Array, fixed: Mask, reach: Array, lo: Array, hi: Array) -> Array:
    """Points that would leave the box for `new` (n, 3), brought onto the surface from `old` parallel to the faces they would
    leave by, or left there: the surface goes on beyond the box, the layout does not."""
    points = onto(field, old, fixed | (new < lo) | (new > hi), reach)
    stays = np.asarray(((points < lo) | (points > hi)).any(axis=1))
    return np.where(stays[:, None], old, points)


def _balance(vertices: Array, rim: Ints, beside: Ints) -> Array:
    """The shorter of the two sides in a face of the box at each vertex of the rim, as a part of the longer."""
    one, other = (np.linalg.norm(vertices[rim] - vertices[beside[:, i]], axis=1) for i in (0, 1))
    return np.asarray(np.minimum(one, other) / np.maximum(np.maximum(one, other), TINY))


def with_neighbours(mesh: Mesh, vertices: Mask, rings: int = 1) -> Mask:
    """The vertices (V,) and those within so many polygons of them."""
    corners, result = filled(mesh.corners), vertices.copy()
    for _ in range(rings):
        result[corners[result[corners].any(axis=1)]] = True
    return result


def _pulls(mesh: Mesh, moving: Mask) -> list[Ints]:
    """The quadrilaterals (Q, 4) and triangles (T, 3) at vertices that move."""
    three = mesh.corners[:, 3] < 0
    groups = (mesh.corners[~three], mesh.corners[three][:, :3])
    return [corners[moving[corners].any(axis=1)] for corners in groups]


def _on_faces(mesh: Mesh, moving: Mask) -> tuple[Ints, Ints]:
    """Vertices that move inside faces of the box, (n,), and their two neighbours in the same face, (n, 2)."""
    ends = mesh.side_ends[mesh.side_plane >= 0]
    start, end = np.concatenate([ends, ends[:, ::-1]]).T
    order = np.argsort(start, kind="stable")
    start, end = start[order], end[order]
    first = np.flatnonzero((start[:-1] == start[1:]) & (mesh.fixed[start[:-1]].sum(axis=1) == 1) & moving[start[:-1]])
    return start[first], np.stack([end[first], end[first + 1]], axis=1)
