"""Shape measures of polygons on a level set, relative to limits within which a patch can be fitted.

`corner_distortion` measures a polygon by its corners: the sines of its angles, the tilt of its sides and diagonals against the
surface and the turning of the normals. `interior_distortion` measures the surface between the corners. Both are above 1 beyond
the limits.
"""

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

MIN_CORNER_SINE = 0.42
"""Least signed sine of a corner angle: of well-shaped polygons nearly all patches were fitted, of thin ones one in five was
not."""

MAX_TILT_SINE = 0.8
"""Largest sine of the angle between a side or diagonal and the surface at its ends."""

MIN_NORMAL_COSINE = -0.3
"""Least cosine of the angle between the normals at two corners."""

MIN_SIDE_RATIO = 0.01
"""Least ratio of a polygon's shortest to its longest side: at a side of zero length the angles are arbitrary."""

MAX_SAG_FRACTION = 0.35
"""Largest distance of the surface from the midpoint of a side, or from a polygon's centre, as a fraction of the side's length."""

MIN_MIDPOINT_NORMAL_COSINE = 0.05
"""Least cosine of the angle between the normal at such a midpoint and those at the corners."""

MIN_QUARTER_SINE = 0.1
"""Least signed corner sine of the four quarters of a quadrilateral, which detects thin polygons whose sides bend into each
other."""

NEWTON_STEPS_FROM_MIDPOINTS = 2


def corner_distortion(vertices: Array, normals: Array, fixed: BoolArray, corners: IntArray) -> Array:
    """Distortion (Q,) of polygons (Q, 4), triangles padded with -1, by their corners; above 1 beyond the limits.

    `vertices`, unit `normals` and coordinates `fixed` on the box are (V, 3).
    """
    result = np.zeros(len(corners))
    triangular, on_box = corners[:, 3] < 0, np.asarray(fixed.any(axis=1))
    for rows, n in ((np.flatnonzero(~triangular), 4), (np.flatnonzero(triangular), 3)):
        if not len(rows):
            continue
        polygons = corners[rows, :n]
        points, normal = gather(vertices, polygons), gather(normals, polygons)
        chord, next_normal = roll_next(points) - points, roll_next(normal)
        size = length(chord)
        sine = sines_between_sides(chord, size, normal).min(axis=1)
        cosine = dot(normal, next_normal).min(axis=1)
        tilt = _max_tilt_sines(chord, size, normal, next_normal)
        if n == 4:
            diagonal = points[:, :, 2:] - points[:, :, :2]
            one, other = normal[:, :, :2], normal[:, :, 2:]
            cosine = np.minimum(cosine, dot(one, other).min(axis=1))
            tilt = np.maximum(tilt, _max_tilt_sines(diagonal, length(diagonal), one, other))
        boxed = np.flatnonzero(on_box[polygons].sum(axis=1) > 1)
        if len(boxed):
            row = polygons[boxed]
            tilt[boxed] = np.maximum(tilt[boxed], _max_box_section_tilt(vertices[row], normals[row], fixed[row]))
            sine[boxed[_has_smooth_box_corner(fixed[row])]] = -1.0
        result[rows] = np.maximum.reduce(
            [
                MIN_SIDE_RATIO * size.max(axis=1) / np.maximum(size.min(axis=1), MIN_DIVISOR),
                (1 - sine) / (1 - MIN_CORNER_SINE),
                tilt / MAX_TILT_SINE,
                (1 - np.minimum(cosine, 1.0)) / (1 - MIN_NORMAL_COSINE),
            ]
        )
    return result


def interior_distortion(field: Field, vertices: Array, normals: Array, fixed: BoolArray, polygons: IntArray) -> Array:
    """Distortion (Q,) of polygons (Q, 4) by the surface between their corners; above 1 beyond the limits.

    The midpoints of the sides and the centre are projected onto the level set. Measured are how far they move, how far the
    normals turn from the corners to there, and the corner angles of the four quarters into which these points divide a
    quadrilateral.
    """
    triangular = polygons[:, 3] < 0
    corners = polygons.copy()
    corners[triangular, 3] = corners[triangular, 2]
    next_corners = np.roll(corners, -1, axis=1)
    held = np.concatenate([fixed[corners] & fixed[next_corners], np.zeros((len(corners), 1, 3), bool)], axis=1)
    points = np.concatenate(
        [0.5 * (vertices[corners] + vertices[next_corners]), vertices[corners].mean(axis=1)[:, None]], 1
    )
    side = np.linalg.norm(vertices[corners] - vertices[next_corners], axis=2)
    side = np.concatenate([side, side.max(axis=1, keepdims=True)], axis=1)
    projected = points
    for _ in range(NEWTON_STEPS_FROM_MIDPOINTS):
        value, gradient = field.value_and_gradient(projected)
        free = np.where(held, 0.0, gradient)
        step = -(value / np.maximum(np.einsum("qix,qix->qi", free, free), MIN_DIVISOR))[..., None] * free
        shorten = MAX_SAG_FRACTION * side / np.maximum(np.linalg.norm(step, axis=2), MIN_DIVISOR)
        projected = projected + np.minimum(1.0, shorten)[..., None] * step
    sag = np.linalg.norm(projected - points, axis=2) / np.maximum(side, MIN_DIVISOR)
    sag[side <= 0] = 0.0
    normal, at_corners = normalize(gradient), normals[corners]
    cosine = np.minimum(
        np.einsum("qix,qix->qi", normal[:, :4], at_corners),
        np.einsum("qix,qix->qi", normal[:, :4], normals[next_corners]),
    )
    cosine = np.minimum(cosine, np.einsum("qx,qix->qi", normal[:, 4], at_corners)).min(axis=1)
    sine = corner_sines(
        _quarters(vertices[corners], projected).reshape(-1, 3),
        np.arange(16 * len(corners)).reshape(-1, 4),
        _quarters(at_corners, normal).reshape(-1, 3),
    )
    sine = sine.min(axis=1).reshape(-1, 4).min(axis=1)
    sine[triangular] = 1.0
    return np.maximum.reduce(
        [
            sag.max(axis=1) / MAX_SAG_FRACTION,
            (1 - cosine) / (1 - MIN_MIDPOINT_NORMAL_COSINE),
            (1 - sine) / (1 - MIN_QUARTER_SINE),
        ]
    )


def max_corner_distortion(mesh: QuadMesh, field: Field) -> float:
    """Largest corner distortion of the mesh's polygons."""
    normals = normalize(field.gradient(mesh.vertices))
    return float(corner_distortion(mesh.vertices, normals, mesh.fixed, mesh.corners).max(initial=0.0))


def _max_tilt_sines(chord: Array, size: Array, one: Array, other: Array) -> Array:
    """Largest sine (Q,) of the angles between chords (3, Q, n), of lengths (Q, n), and the surface at their ends."""
    return np.asarray(
        (np.maximum(np.abs(dot(chord, one)), np.abs(dot(chord, other))) / np.maximum(size, MIN_DIVISOR)).max(1)
    )


def _quarters(at_corners: Array, at_middles: Array) -> Array:
    """Values (Q, 4, 4, 3) at the corners of the quarters: corner, midpoint behind it, centre, midpoint before it.

    `at_corners` is (Q, 4, 3), `at_middles` (Q, 5, 3) with the centre last.
    """
    middle, centre = at_middles[:, :4], np.repeat(at_middles[:, 4:], 4, axis=1)
    return np.stack([at_corners, middle, centre, np.roll(middle, 1, axis=1)], axis=2)


def _has_smooth_box_corner(fixed: BoolArray) -> BoolArray:
    """Polygons (Q,) with two consecutive sides in one face of the box, by `fixed` (Q, n, 3) of their corners.

    The surface's section with the face runs smoothly through the corner between them, so that the patch has no angle there,
    however sharply the chords turn.
    """
    three = fixed & np.roll(fixed, -1, axis=1) & np.roll(fixed, 1, axis=1)
    return np.asarray(three.any(axis=(1, 2)))


def _max_box_section_tilt(points: Array, normals: Array, fixed: BoolArray) -> Array:
    """Largest sine (Q,) of the angles between sides in a face of the box and the surface's section, at their ends."""
    common = fixed & np.roll(fixed, -1, axis=1)
    chord = normalize(np.where(common, 0.0, np.roll(points, -1, axis=1) - points))
    ends = (normals, np.roll(normals, -1, axis=1))
    tilt = [np.abs(np.einsum("qix,qix->qi", chord, normalize(np.where(common, 0.0, n)))) for n in ends]
    return np.asarray(np.where(common.any(axis=2), np.maximum(*tilt), 0.0).max(axis=1))
