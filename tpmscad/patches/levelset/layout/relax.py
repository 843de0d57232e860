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

SWEEPS = 60
"""Sweeps of the relaxation; the worst corner of single-period layouts no longer changes after 40."""

BALANCE = 0.3
"""A vertex in a face of the box keeps the shorter of its two sides there at least this part of the longer: where the surface cuts
off a small corner of the box, the large polygons beside would else pull the vertex out of it."""

NEWTON = 12
CONVERGED = 1e-8
"""A step below this part of the reach is Newton's last: what is left is of the order of its square, below round-off."""

WORST, POWER = 0.1, 2
"""A polygon pulls with 1 / max(least sine of its corners, WORST)^POWER: without that, layouts with necks keep turned corners."""

RINGS = 2
SAME = 1e-10
"""Vertices of two trees are the same if they start this close, in diagonals of the box."""

STEP = 0.25
"""Greatest move of a vertex in one step, in sizes of its cell and in lengths of its shortest side."""


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
        step = -(value / np.maximum(square, 1e-300))[:, None] * slope
        length = np.linalg.norm(step, axis=1)
        shorten = np.minimum(1.0, reach[active] / np.maximum(length, 1e-300))
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
    for _ in range(RINGS):
        near = mesh.corners[(free[mesh.corners] & (mesh.corners >= 0)).any(axis=1)]
        free[near[near >= 0]] = True
    touched = (free[mesh.corners] & (mesh.corners >= 0)).any(axis=1)
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


def settled(mesh: Mesh, free: Mask, field: Field, lo: Array, hi: Array, sweeps: int) -> Mesh:
    on_edge = mesh.fixed.sum(axis=1) == 2
    corners = mesh.corners
    three = corners[:, 3] < 0
    groups = [(corners[~three], 4), (corners[three][:, :3], 3)]

    def onto_inside(old: Array, new: Array, steps: int) -> Array:
        """`new` brought onto the surface; a point that would leave the box is brought there from `old` parallel to the face it
        would leave by, or stays: the surface goes on beyond the box, the layout does not."""
        points = old.copy()
        points[free] = onto(field, new[free], mesh.fixed[free], reach[free], steps)
        out = (points < lo) | (points > hi)
        at = np.flatnonzero(out.any(axis=1))
        if len(at):
            beside_face = onto(field, old[at], mesh.fixed[at] | out[at], reach[at], NEWTON)
            stays = np.asarray(((beside_face < lo) | (beside_face > hi)).any(axis=1))
            points[at] = np.where(stays[:, None], old[at], beside_face)
        return points

    rim, beside = _on_faces(mesh)
    beside, rim = beside[free[rim]], rim[free[rim]]

    def balance(points: Array, neighbours: Ints) -> Array:
        one, other = (np.linalg.norm(points - vertices[neighbours[:, i]], axis=1) for i in (0, 1))
        return np.minimum(one, other) / np.maximum(np.maximum(one, other), 1e-300)

    reach = STEP * mesh.size
    vertices = onto_inside(mesh.vertices, mesh.vertices, 30)
    full = field.gradient(vertices)
    for sweep in range(sweeps):
        full[free] = field.gradient(vertices[free])
        unit = full / np.maximum(np.linalg.norm(full, axis=1, keepdims=True), 1e-300)
        wanted, share = np.zeros_like(vertices), np.zeros(len(vertices))
        for of, n in groups:
            target = _regular(vertices[of], n)
            sines = corner_sines(vertices, of, unit)
            pull = np.repeat(1.0 / np.clip(sines.min(axis=1), WORST, 1.0) ** POWER, n)
            share += np.bincount(of.ravel(), pull, minlength=len(vertices))
            for axis in range(3):
                wanted[:, axis] += np.bincount(of.ravel(), pull * target[..., axis].ravel(), minlength=len(vertices))
        slope = np.where(mesh.fixed, 0.0, full)
        normal = slope / np.maximum(np.linalg.norm(slope, axis=1), 1e-300)[:, None]
        move = np.where(mesh.fixed | (on_edge | ~free)[:, None], 0.0, wanted / share[:, None] - vertices)
        move -= np.einsum("ni,ni->n", move, normal)[:, None] * normal
        room = np.minimum(reach, STEP * _shortest(vertices, mesh.side_ends))
        length = np.linalg.norm(move, axis=1)
        move *= np.minimum(1.0, room / np.maximum(length, 1e-300))[:, None]
        last = sweep + 1 == sweeps
        moved = onto_inside(vertices, vertices + move, NEWTON if last else 2)
        before, after = (balance(x, beside) for x in (vertices[rim], moved[rim]))
        moved[rim] = np.where(((after < BALANCE) & (after < before))[:, None], vertices[rim], moved[rim])
        vertices = moved
    return replace(mesh, vertices=vertices)


def _on_faces(mesh: Mesh) -> tuple[Ints, Ints]:
    """Vertices inside faces of the box, (n,), and their two neighbours in the same face, (n, 2)."""
    ends = mesh.side_ends[mesh.side_plane >= 0]
    start, end = np.concatenate([ends, ends[:, ::-1]]).T
    order = np.argsort(start, kind="stable")
    start, end = start[order], end[order]
    first = np.flatnonzero((start[:-1] == start[1:]) & (mesh.fixed[start[:-1]].sum(axis=1) == 1))
    return start[first], np.stack([end[first], end[first + 1]], axis=1)


def _shortest(vertices: Array, ends: Ints) -> Array:
    """The length of the shortest side at each vertex."""
    length = np.linalg.norm(vertices[ends[:, 0]] - vertices[ends[:, 1]], axis=1)
    shortest = np.full(len(vertices), np.inf)
    np.minimum.at(shortest, ends[:, 0], length)
    np.minimum.at(shortest, ends[:, 1], length)
    return shortest


def _regular(points: Array, n: int) -> Array:
    """The regular n-gons nearest to polygons (Q, n, 3)."""
    centre = points.mean(axis=1, keepdims=True)
    spokes = points - centre
    normal = np.cross(spokes, np.roll(spokes, -1, axis=1)).sum(axis=1)
    normal /= np.maximum(np.linalg.norm(normal, axis=1), 1e-300)[:, None]
    angle = 2 * np.pi / n * np.arange(n)
    cos, sin = np.cos(angle)[:, None], np.sin(angle)[:, None]

    def turned(vectors: Array, way: float) -> Array:
        along = np.einsum("qki,qi->qk", vectors, normal)[..., None] * normal[:, None]
        flat = vectors - along
        return flat * cos + way * sin * np.cross(np.broadcast_to(normal[:, None], flat.shape), flat)

    first = turned(spokes, -1.0).mean(axis=1, keepdims=True)
    return centre + turned(np.repeat(first, n, axis=1), 1.0)


def corner_sines(vertices: Array, corners: Ints, normals: Array) -> Array:
    """Sines of the corner angles of quadrilaterals (Q, 4), negative where a corner is turned over: (Q, 4)."""
    points = vertices[corners]
    ahead = np.roll(points, -1, axis=1) - points
    back = np.roll(points, 1, axis=1) - points
    area = np.einsum("qki,qki->qk", np.cross(ahead, back), normals[corners])
    return area / np.maximum(np.linalg.norm(ahead, axis=2) * np.linalg.norm(back, axis=2), 1e-300)
