"""How well polygons of a layout are shaped to be fitted: corners, sides that leave the surface, and normals that turn."""

from __future__ import annotations

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.fields.field import Field
from tpmscad.levelset.quadmesh.dual_mesh import QuadMesh
from tpmscad.levelset.quadmesh.vectors import (
    MIN_DIVISOR,
    corner_sines,
    dot,
    gather,
    length,
    normalize,
    roll_next,
    sines_between_sides,
)

MIN_CORNER_SINE, MAX_TILT_SINE, MIN_NORMAL_COSINE = 0.42, 0.8, -0.3
"""Polygons are wanted with corners of at least this sine, sides and diagonals that leave the surface by at most this sine, and
normals at the corners with at least this cosine. Of 12,000 patches of nine uniform layouts of blends with a least sine above 0.4
and a turning below 90 degrees 98 % were fitted within tol at degree 5; of those with a sine of 0.1 to 0.2, 80 %."""

MIN_SIDE_RATIO = 0.01
"""Polygons have no side shorter than this part of their longest: corners without a side between them have any sine."""

MAX_SAG_FRACTION, MIN_MIDPOINT_NORMAL_COSINE, MIN_QUARTER_SINE = 0.35, 0.05, 0.1
"""The middle of a side, or of a polygon, lies at most this part of a side off the surface, the normal there makes at least this
cosine with those at the corners, and the quarters of a polygon have corners of at least this sine. Corners alone do not tell of
thin polygons whose sides bend into each other, nor of a dimple between them."""


def corner_distortion(vertices: Array, normals: Array, fixed: BoolArray, corners: IntArray) -> Array:
    """How near polygons (Q, 4), triangles with a last -1, are to the limits of their shape, (Q,): above 1 beyond them."""
    result = np.zeros(len(corners))
    three, box = corners[:, 3] < 0, np.asarray(fixed.any(axis=1))
    for at, n in ((np.flatnonzero(~three), 4), (np.flatnonzero(three), 3)):
        if not len(at):
            continue
        of = corners[at, :n]
        points, each = gather(vertices, of), gather(normals, of)
        chord, after = roll_next(points) - points, roll_next(each)
        size = length(chord)
        sine = sines_between_sides(chord, size, each).min(axis=1)
        turn = dot(each, after).min(axis=1)
        tilt = _max_tilt_sines(chord, size, each, after)
        if n == 4:
            diagonal = points[:, :, 2:] - points[:, :, :2]
            near, far = each[:, :, :2], each[:, :, 2:]
            turn = np.minimum(turn, dot(near, far).min(axis=1))
            tilt = np.maximum(tilt, _max_tilt_sines(diagonal, length(diagonal), near, far))
        on_box = np.flatnonzero(box[of].sum(axis=1) > 1)
        if len(on_box):
            row = of[on_box]
            tilt[on_box] = np.maximum(tilt[on_box], _max_box_section_tilt(vertices[row], normals[row], fixed[row]))
        result[at] = np.maximum.reduce(
            [
                MIN_SIDE_RATIO * size.max(axis=1) / np.maximum(size.min(axis=1), MIN_DIVISOR),
                (1 - sine) / (1 - MIN_CORNER_SINE),
                tilt / MAX_TILT_SINE,
                (1 - np.minimum(turn, 1.0)) / (1 - MIN_NORMAL_COSINE),
            ]
        )
    return result


def _max_tilt_sines(chord: Array, size: Array, one: Array, other: Array) -> Array:
    """The greatest sine (Q,) by which chords (3, Q, n) leave the surface with these normals at their ends."""
    return np.asarray(
        (np.maximum(np.abs(dot(chord, one)), np.abs(dot(chord, other))) / np.maximum(size, MIN_DIVISOR)).max(1)
    )


def interior_distortion(field: Field, vertices: Array, normals: Array, fixed: BoolArray, polygons: IntArray) -> Array:
    """How much of the surface's shape polygons (Q, 4), triangles with a last -1, miss, (Q,), relative to the limits.

    That is how far the surface is from the middles of their sides and their centres, how far its normals turn to there, and
    the corners of the four that a polygon is cut in by these points brought onto the surface.
    """
    three = polygons[:, 3] < 0
    corners = polygons.copy()
    corners[three, 3] = corners[three, 2]
    following = np.roll(corners, -1, axis=1)
    held = np.concatenate([fixed[corners] & fixed[following], np.zeros((len(corners), 1, 3), bool)], axis=1)
    points = np.concatenate(
        [0.5 * (vertices[corners] + vertices[following]), vertices[corners].mean(axis=1)[:, None]], 1
    )
    long = np.linalg.norm(vertices[corners] - vertices[following], axis=2)
    long = np.concatenate([long, long.max(axis=1, keepdims=True)], axis=1)
    moved = points
    for _ in range(2):
        value, slope = field.value_and_gradient(moved)
        along = np.where(held, 0.0, slope)
        step = -(value / np.maximum(np.einsum("qix,qix->qi", along, along), MIN_DIVISOR))[..., None] * along
        reach = MAX_SAG_FRACTION * long / np.maximum(np.linalg.norm(step, axis=2), MIN_DIVISOR)
        moved = moved + np.minimum(1.0, reach)[..., None] * step
    sag = np.linalg.norm(moved - points, axis=2) / np.maximum(long, MIN_DIVISOR)
    sag[long <= 0] = 0.0
    normal = normalize(slope)
    each = normals[corners]
    turn = np.minimum(
        np.einsum("qix,qix->qi", normal[:, :4], each), np.einsum("qix,qix->qi", normal[:, :4], normals[following])
    )
    turn = np.minimum(turn, np.einsum("qx,qix->qi", normal[:, 4], each)).min(axis=1)
    middle, centre = moved[:, :4], np.repeat(moved[:, 4:], 4, axis=1)
    part = np.stack([vertices[corners], middle, centre, np.roll(middle, 1, axis=1)], axis=2).reshape(-1, 3)
    of = np.arange(len(part)).reshape(-1, 4)
    up = np.stack([each, normal[:, :4], np.repeat(normal[:, 4:], 4, 1), np.roll(normal[:, :4], 1, axis=1)], axis=2)
    sine = corner_sines(part, of, up.reshape(-1, 3)).min(axis=1).reshape(-1, 4).min(axis=1)
    sine[three] = 1.0
    return np.maximum.reduce(
        [
            sag.max(axis=1) / MAX_SAG_FRACTION,
            (1 - turn) / (1 - MIN_MIDPOINT_NORMAL_COSINE),
            (1 - sine) / (1 - MIN_QUARTER_SINE),
        ]
    )


def _max_box_section_tilt(points: Array, normals: Array, fixed: BoolArray) -> Array:
    """The greatest sine (Q,) by which sides in a face of the box leave the surface's section with it, at their ends."""
    common = fixed & np.roll(fixed, -1, axis=1)
    chord = normalize(np.where(common, 0.0, np.roll(points, -1, axis=1) - points))
    ends = (normals, np.roll(normals, -1, axis=1))
    tilt = [np.abs(np.einsum("qix,qix->qi", chord, normalize(np.where(common, 0.0, n)))) for n in ends]
    return np.asarray(np.where(common.any(axis=2), np.maximum(*tilt), 0.0).max(axis=1))


def max_corner_distortion(mesh: QuadMesh, field: Field) -> float:
    """The badness of a mesh's worst polygon."""
    normals = normalize(field.gradient(mesh.vertices))
    return float(corner_distortion(mesh.vertices, normals, mesh.fixed, mesh.corners).max(initial=0.0))
