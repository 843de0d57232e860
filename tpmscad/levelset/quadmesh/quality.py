"""Shape measures of polygons on a level set, relative to limits within which a patch can be fitted.

`corner_distortion` measures a polygon by its corners: the sines of its angles, the tilt of its sides and diagonals against the
surface and the turning of the normals. `interior_distortion` measures the surface between the corners. Both are above 1 beyond
the limits.

`measure_side_distances` foretells whether patches reach the tolerance, by sides as cubic curves. Between two vertices the cubic
with their chord as its derivative at both ends, turned into the tangent planes there, leaves the level set where this bends
unevenly, as beside the rounded edge of a wall. The fit has the same end points and tangents, and a higher degree: of 1655
polygons of a blended sheet with all sides within six tolerances none failed, of 422 others one in 26.
"""

from __future__ import annotations

import numpy as np

from tpmscad._compiled_loops import njit_cached
from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.fields.field import Field
from tpmscad.levelset.quadmesh.smoothing import project_with_gradients
from tpmscad.levelset.quadmesh.vectors import (
    MIN_DIVISOR,
    close_triangles,
    difference_of,
    dot,
    dot_of,
    gather,
    length,
    norm_of,
    roll_next,
    roll_previous,
    sines_between_sides,
    triple_product_of,
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
"""Newton steps from middles of polygons, which start within the sag of a side: two leave a thousandth of it."""


def corner_distortion(vertices: Array, normals: Array, fixed: BoolArray, corners: IntArray) -> Array:
    """Distortion (Q,) of polygons (Q, 4), triangles padded with -1, by their corners; above 1 beyond the limits.

    `vertices`, unit `normals` and coordinates `fixed` on the box are (V, 3).
    """
    return _measure_polygons(*(np.ascontiguousarray(each) for each in (vertices, normals, fixed, corners)))


def interior_distortion(field: Field, vertices: Array, normals: Array, fixed: BoolArray, polygons: IntArray) -> Array:
    """Distortion (Q,) of polygons (Q, 4) by the surface between their corners; above 1 beyond the limits.

    The midpoints of the sides and the centre are projected onto the level set. Measured are how far they move, how far the
    normals turn from the corners to there, and the corner angles of the four quarters into which these points divide a
    quadrilateral.
    """
    corners = np.where(polygons < 0, polygons[:, 2:3], polygons)
    at, up, held = gather(vertices, corners), gather(normals, corners), gather(fixed, corners)
    side = length(roll_next(at) - at)
    side = np.column_stack([side, side.max(axis=1)])
    centre = (at[..., 0] + at[..., 1] + at[..., 2] + at[..., 3]) / 4
    middles = np.concatenate([0.5 * (at + roll_next(at)), centre[..., None]], axis=-1)
    held = np.concatenate([held & roll_next(held), np.zeros((*held.shape[:2], 1), bool)], axis=-1)
    found = project_with_gradients(
        field,
        middles.reshape(3, -1).T,
        held.reshape(3, -1).T,
        MAX_SAG_FRACTION * side.ravel(),
        NEWTON_STEPS_FROM_MIDPOINTS,
        0.0,
    )
    projected, gradient = (each.T.reshape(middles.shape) for each in found)
    normal = gradient / np.maximum(length(gradient), MIN_DIVISOR)
    sag = np.where(side > 0, length(projected - middles) / np.maximum(side, MIN_DIVISOR), 0.0).max(axis=1)
    pairs = ((normal[..., :4], up), (normal[..., :4], roll_next(up)), (normal[..., 4:], up))
    cosine = np.concatenate([dot(*pair) for pair in pairs], axis=1).min(axis=1)
    quarter = _list_quarters(at, projected)
    edge = roll_next(quarter) - quarter
    sine = sines_between_sides(edge, length(edge), _list_quarters(up, normal)).min(axis=(1, 2))
    sine = np.where(corners[:, 2] == corners[:, 3], 1.0, sine)  # a triangle has no quarters to measure
    worst = np.maximum(sag / MAX_SAG_FRACTION, (1 - cosine) / (1 - MIN_MIDPOINT_NORMAL_COSINE))
    return np.maximum(worst, (1 - sine) / (1 - MIN_QUARTER_SINE))


def _list_quarters(at: Array, middles: Array) -> Array:
    """The corners (3, Q, 4, 4) of the quarters between the corners (3, Q, 4), the midpoints and the centre (3, Q, 5)."""
    on_sides, centre = middles[..., :4], np.broadcast_to(middles[..., 4:], at.shape)
    return np.stack([at, on_sides, centre, roll_previous(on_sides)], axis=-1)


@njit_cached
def _measure_polygons(
    vertices: Array, normals: Array, fixed: BoolArray, polygons: IntArray
) -> Array:  # pragma: no cover
    """The distortion (Q,) of each polygon (Q, 4)."""
    result = np.empty(len(polygons))
    for q in range(len(polygons)):
        result[q] = measure_polygon(vertices, normals, fixed, polygons[q])
    return result


@njit_cached
def measure_polygon(vertices: Array, normals: Array, fixed: BoolArray, corners: IntArray) -> float:  # pragma: no cover
    """The distortion of one polygon (4,), for compiled loops; as `corner_distortion`."""
    n = 3 if corners[3] < 0 else 4
    before = corners[n - 1]
    previous = difference_of(vertices, before, corners[0])
    previous_size = norm_of(previous)
    longest, shortest = previous_size, previous_size
    sine, cosine, tilt, boxed = np.inf, 1.0, 0.0, 0
    total = 0.0  # of all sines: not a number if one of them is
    for k in range(n):
        i, j = corners[k], corners[(k + 1) % n]
        chord = difference_of(vertices, i, j)
        size = norm_of(chord)
        longest, shortest = max(longest, size), min(shortest, size)
        corner_sine = triple_product_of(previous, chord, normals[i]) / max(size * previous_size, MIN_DIVISOR)
        sine, total = min(sine, corner_sine), total + corner_sine
        cosine = min(cosine, dot_of(normals[i], normals[j]))
        tilt = max(tilt, max(abs(dot_of(chord, normals[i])), abs(dot_of(chord, normals[j]))) / max(size, MIN_DIVISOR))
        boxed += fixed[i, 0] | fixed[i, 1] | fixed[i, 2]
        previous, previous_size = chord, size
    if n == 4:
        for k in range(2):
            i, j = corners[k], corners[k + 2]
            chord = difference_of(vertices, i, j)
            size = max(norm_of(chord), MIN_DIVISOR)
            cosine = min(cosine, dot_of(normals[i], normals[j]))
            tilt = max(tilt, max(abs(dot_of(chord, normals[i])), abs(dot_of(chord, normals[j]))) / size)
    if boxed > 1:
        tilt = max(tilt, _max_box_section_tilt(vertices, normals, fixed, corners, n))
        if _has_smooth_box_corner(fixed, corners, n):
            sine = -1.0
    worst = max(MIN_SIDE_RATIO * longest / max(shortest, MIN_DIVISOR), (1 - sine) / (1 - MIN_CORNER_SINE))
    worst = max(worst, max(tilt / MAX_TILT_SINE, (1 - cosine) / (1 - MIN_NORMAL_COSINE)))
    return np.nan if np.isnan(total) else worst


@njit_cached
def _has_smooth_box_corner(fixed: BoolArray, corners: IntArray, n: int) -> bool:  # pragma: no cover
    """Whether two consecutive sides of a polygon lie in one face of the box.

    The surface's section with the face runs smoothly through the corner between them, so that the patch has no angle there,
    however sharply the chords turn.
    """
    for k in range(n):
        i, j, h = corners[k], corners[(k + 1) % n], corners[k - 1 if k else n - 1]
        for x in range(3):
            if fixed[i, x] and fixed[j, x] and fixed[h, x]:
                return True
    return False


@njit_cached
def _max_box_section_tilt(
    vertices: Array, normals: Array, fixed: BoolArray, corners: IntArray, n: int
) -> float:  # pragma: no cover
    """Largest sine of the angles between a polygon's sides in a face of the box and the surface's section, at their ends."""
    chord, one, other = np.empty(3), np.empty(3), np.empty(3)
    tilt = 0.0
    for k in range(n):
        i, j = corners[k], corners[(k + 1) % n]
        shared = False
        for x in range(3):
            common = fixed[i, x] and fixed[j, x]
            shared |= common
            chord[x] = 0.0 if common else vertices[j, x] - vertices[i, x]
            one[x] = 0.0 if common else normals[i, x]
            other[x] = 0.0 if common else normals[j, x]
        if shared:
            for vector in (chord, one, other):
                size = max(norm_of(vector), MIN_DIVISOR)
                for x in range(3):
                    vector[x] /= size
            tilt = max(tilt, max(abs(dot_of(chord, one)), abs(dot_of(chord, other))))
    return tilt


SIDE_PARAMETERS = np.array([0.25, 0.5, 0.75])
"""Parameters of the points of a cubic at which its distance is measured."""


def measure_side_distances(
    field: Field, vertices: Array, normals: Array, fixed: BoolArray, polygons: IntArray
) -> Array:
    """Largest distance (Q,) from {field = 0}, to first order, of the cubic sides of polygons (Q, 4), triangles padded with -1.

    `vertices`, unit `normals` and coordinates `fixed` on the box are (V, 3). Sides in a face of the box stay in it.
    """
    corners = close_triangles(polygons)
    after = np.where(polygons < 0, polygons[:, 1:2], roll_next(corners))  # a triangle's first side once more
    start, end = gather(vertices, corners), gather(vertices, after)
    free = ~(gather(fixed, corners) & gather(fixed, after))
    chord = end - start
    tangents = []
    for ends in (corners, after):
        way = np.where(free, gather(normals, ends), 0.0)
        tangent = chord - dot(chord, way) / np.maximum(dot(way, way), MIN_DIVISOR) * way
        tangents.append((tangent * (length(chord) / np.maximum(length(tangent), MIN_DIVISOR)))[..., None])
    t, rest = SIDE_PARAMETERS, 1.0 - SIDE_PARAMETERS
    points = (1.0 + 2.0 * t) * rest**2 * start[..., None] + t**2 * (3.0 - 2.0 * t) * end[..., None]
    points += t * rest * (rest * tangents[0] - t * tangents[1])
    value, gradient = field.value_and_gradient(np.moveaxis(points, 0, -1))
    slope = length(np.where(free[..., None], np.moveaxis(gradient, -1, 0), 0.0))
    ratio = np.abs(value) / np.maximum(slope, MIN_DIVISOR)
    return np.asarray(np.fmax.reduce(ratio, axis=(1, 2), initial=0.0))
