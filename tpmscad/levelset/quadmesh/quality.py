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
    difference_of,
    dot_as_einsum,
    dot_of,
    norm_of,
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
    points, held, side = _place_middles(vertices, fixed, corners)
    longest = MAX_SAG_FRACTION * side.ravel()
    projected, gradient = project_with_gradients(
        field, points.reshape(-1, 3), held.reshape(-1, 3), longest, NEWTON_STEPS_FROM_MIDPOINTS, 0.0
    )
    projected, gradient = projected.reshape(points.shape), gradient.reshape(points.shape)
    return _measure_interiors(vertices, normals, corners, points, projected, gradient, side)


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
            tilt = max(tilt, max(abs(dot_as_einsum(chord, one)), abs(dot_as_einsum(chord, other))))
    return tilt


@njit_cached
def _place_middles(
    vertices: Array, fixed: BoolArray, corners: IntArray
) -> tuple[Array, BoolArray, Array]:  # pragma: no cover
    """The midpoints of the sides and the centres (Q, 5, 3), the coordinates held on the box, and the lengths (Q, 5) of the sides.

    The length of the longest side stands for the centre.
    """
    count = len(corners)
    points, held, side = np.empty((count, 5, 3)), np.zeros((count, 5, 3), np.bool_), np.empty((count, 5))
    for q in range(len(corners)):
        longest = 0.0
        for k in range(4):
            i, j = corners[q, k], corners[q, (k + 1) % 4]
            side[q, k] = norm_of(difference_of(vertices, j, i))
            longest = max(longest, side[q, k])
            for x in range(3):
                points[q, k, x] = 0.5 * (vertices[i, x] + vertices[j, x])
                held[q, k, x] = fixed[i, x] and fixed[j, x]
        side[q, 4] = longest
        a, b, c, d = corners[q]
        for x in range(3):
            points[q, 4, x] = (vertices[a, x] + vertices[b, x] + vertices[c, x] + vertices[d, x]) / 4
    return points, held, side


@njit_cached
def _measure_interiors(
    vertices: Array,
    normals: Array,
    corners: IntArray,
    points: Array,
    projected: Array,
    gradient: Array,
    side: Array,
) -> Array:  # pragma: no cover
    """The interior distortion (Q,) by the middles (Q, 5, 3), their projections, the gradients there and the sides (Q, 5).

    The last two corners (Q, 4) of a triangle are the same; it has no quarters to measure.
    """
    middle_normal, step = np.empty((5, 3)), np.empty(3)
    quarter, quarter_normal, result = np.empty((4, 3)), np.empty((4, 3)), np.empty(len(corners))
    for q in range(len(corners)):
        sag, cosine, sine = 0.0, np.inf, np.inf
        total = 0.0  # of all measures: not a number if one of them is
        for k in range(5):
            if side[q, k] > 0:
                for x in range(3):
                    step[x] = projected[q, k, x] - points[q, k, x]
                moved = norm_of(step) / max(side[q, k], MIN_DIVISOR)
                sag, total = max(sag, moved), total + moved
            size = max(norm_of(gradient[q, k]), MIN_DIVISOR)
            for x in range(3):
                middle_normal[k, x] = gradient[q, k, x] / size
        for k in range(4):
            i, j = corners[q, k], corners[q, (k + 1) % 4]
            cosine = min(cosine, dot_as_einsum(middle_normal[k], normals[i]))
            cosine = min(cosine, dot_as_einsum(middle_normal[k], normals[j]))
            cosine = min(cosine, dot_as_einsum(middle_normal[4], normals[i]))
            total += cosine
        if corners[q, 2] == corners[q, 3]:
            sine = 1.0
        else:
            for k in range(4):
                before = k - 1 if k else 3
                for x in range(3):
                    quarter[0, x], quarter_normal[0, x] = vertices[corners[q, k], x], normals[corners[q, k], x]
                    quarter[1, x], quarter_normal[1, x] = projected[q, k, x], middle_normal[k, x]
                    quarter[2, x], quarter_normal[2, x] = projected[q, 4, x], middle_normal[4, x]
                    quarter[3, x], quarter_normal[3, x] = projected[q, before, x], middle_normal[before, x]
                sine = min(sine, _min_corner_sine(quarter, quarter_normal))
            total += sine
        worst = max(sag / MAX_SAG_FRACTION, (1 - cosine) / (1 - MIN_MIDPOINT_NORMAL_COSINE))
        worst = max(worst, (1 - sine) / (1 - MIN_QUARTER_SINE))
        result[q] = np.nan if np.isnan(total) else worst
    return result


@njit_cached
def _min_corner_sine(points: Array, normals: Array) -> float:  # pragma: no cover
    """Least signed sine of the corner angles of a quadrilateral (4, 3) with normals (4, 3)."""
    least = np.inf
    previous = difference_of(points, 3, 0)
    previous_size = norm_of(previous)
    for k in range(4):
        chord = difference_of(points, k, (k + 1) % 4)
        size = norm_of(chord)
        least = min(least, triple_product_of(previous, chord, normals[k]) / max(size * previous_size, MIN_DIVISOR))
        previous, previous_size = chord, size
    return least


SIDE_PARAMETERS = np.array([0.25, 0.5, 0.75])
"""Parameters of the points of a cubic at which its distance is measured."""


def measure_side_distances(
    field: Field, vertices: Array, normals: Array, fixed: BoolArray, polygons: IntArray
) -> Array:
    """Largest distance (Q,) from {field = 0}, to first order, of the cubic sides of polygons (Q, 4), triangles padded with -1.

    `vertices`, unit `normals` and coordinates `fixed` on the box are (V, 3). Sides in a face of the box stay in it.
    """
    points, free = _place_points(vertices, normals, fixed, polygons)
    value, gradient = field.value_and_gradient(points)
    return _measure_distances(polygons, value, gradient, free)


@njit_cached
def _place_points(
    vertices: Array, normals: Array, fixed: BoolArray, polygons: IntArray
) -> tuple[Array, BoolArray]:  # pragma: no cover
    """The points (Q, 4, k, 3) on the cubics of the sides, and the coordinates (Q, 4, 3) along which these may move."""
    count = len(polygons)
    points, free = np.empty((count, 4, len(SIDE_PARAMETERS), 3)), np.empty((count, 4, 3), np.bool_)
    first, last, way = np.empty(3), np.empty(3), np.empty(3)
    for q in range(len(polygons)):
        n = 3 if polygons[q, 3] < 0 else 4
        for side in range(4):
            # the fourth side of a triangle is its first once more
            i, j = polygons[q, side % n], polygons[q, (side + 1) % n]
            chord = difference_of(vertices, i, j)
            length = norm_of(chord)
            for end, tangent in ((i, first), (j, last)):
                for x in range(3):
                    free[q, side, x] = not (fixed[i, x] and fixed[j, x])
                    way[x] = normals[end, x] if free[q, side, x] else 0.0
                square = max(dot_of(way, way), MIN_DIVISOR)
                share = dot_of(chord, way) / square
                for x in range(3):
                    tangent[x] = chord[x] - share * way[x]
                stretch = length / max(norm_of(tangent), MIN_DIVISOR)
                for x in range(3):
                    tangent[x] *= stretch
            for k in range(len(SIDE_PARAMETERS)):
                t = SIDE_PARAMETERS[k]
                rest = 1.0 - t
                for x in range(3):
                    points[q, side, k, x] = (
                        (1.0 + 2.0 * t) * rest**2 * vertices[i, x]
                        + t**2 * (3.0 - 2.0 * t) * vertices[j, x]
                        + t * rest * (rest * first[x] - t * last[x])
                    )
    return points, free


@njit_cached
def _measure_distances(polygons: IntArray, value: Array, gradient: Array, free: BoolArray) -> Array:  # pragma: no cover
    """The largest ratio (Q,) of values (Q, 4, k) to the lengths of gradients (Q, 4, k, 3) in the free coordinates."""
    result = np.empty(len(polygons))
    for q in range(len(polygons)):
        largest = 0.0
        for side in range(4):
            for k in range(value.shape[2]):
                square = 0.0
                for x in range(3):
                    if free[q, side, x]:
                        square += gradient[q, side, k, x] ** 2
                largest = max(largest, abs(value[q, side, k]) / max(np.sqrt(square), MIN_DIVISOR))
        result[q] = largest
    return result
