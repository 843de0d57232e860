"""Points and normals of Bezier patches on grids of parameters, and what is measured there, compiled."""

from __future__ import annotations

import numpy as np

from tpmscad._compiled_loops import njit_cached
from tpmscad._typing import Array
from tpmscad.levelset.fit.equality_constraints import add_row_sum
from tpmscad.levelset.quadmesh.vectors import MIN_DIVISOR

BasisAndSlopes = tuple[Array, Array]
"""Values and derivatives (m, degree + 1) of the basis functions in one parameter."""


def evaluate_points_and_normals(poles: Array, u: BasisAndSlopes, v: BasisAndSlopes) -> tuple[Array, Array]:
    """Points and normals (n, k l, 3), not of unit length, of patches (n, p + 1, q + 1, 3) on a grid (k, l), u first."""
    return _evaluate(np.ascontiguousarray(poles), *u, *v)


@njit_cached
def _evaluate(poles: Array, bu: Array, du: Array, bv: Array, dv: Array) -> tuple[Array, Array]:  # pragma: no cover
    n, p, q, _ = poles.shape
    k, l = len(bu), len(bv)  # noqa: E741
    points, normals = np.empty((n, k * l, 3)), np.empty((n, k * l, 3))
    rows = poles.reshape(n, p, 3 * q)
    at, along = np.empty(3 * q), np.empty(3 * q)
    xu, xv = np.empty(3), np.empty(3)
    for each in range(n):
        for a in range(k):
            at[:] = 0.0
            add_row_sum(at, 1.0, bu[a], rows[each], p, 0, 3 * q)
            along[:] = 0.0
            add_row_sum(along, 1.0, du[a], rows[each], p, 0, 3 * q)
            for b in range(l):
                point, normal = points[each, a * l + b], normals[each, a * l + b]
                for x in range(3):
                    place, xu[x], xv[x] = 0.0, 0.0, 0.0
                    for j in range(q):
                        place += bv[b, j] * at[3 * j + x]
                        xu[x] += bv[b, j] * along[3 * j + x]
                        xv[x] += dv[b, j] * at[3 * j + x]
                    point[x] = place
                for x in range(3):
                    y, z = (x + 1) % 3, (x + 2) % 3
                    normal[x] = xu[y] * xv[z] - xu[z] * xv[y]
    return points, normals


@njit_cached
def measure_samples(
    points: Array, normals: Array, value: Array, gradient: Array, lo: Array, hi: Array
) -> tuple[Array, Array, Array]:  # pragma: no cover
    """Largest and mean square distance (n,) of patches from a level set, and their least cosine (n,) with the gradient.

    `points`, `normals` and `gradient` are (n, m, 3), `value` is (n, m). The distance is |value| / |gradient|, and what a point
    is beyond the box [lo, hi] is added to it. Measurements that are not finite make the result so.
    """
    distances, mean_squares, cosines = np.empty(len(points)), np.empty(len(points)), np.empty(len(points))
    for each in range(len(points)):
        worst, squares, least = 0.0, 0.0, np.inf
        for k in range(points.shape[1]):
            along, normal_square, gradient_square, beyond = 0.0, 0.0, 0.0, 0.0
            for x in range(3):
                along += normals[each, k, x] * gradient[each, k, x]
                normal_square += normals[each, k, x] ** 2
                gradient_square += gradient[each, k, x] ** 2
                beyond = max(beyond, lo[x] - points[each, k, x], points[each, k, x] - hi[x])
            gradient_norm = np.sqrt(gradient_square)
            distance = abs(value[each, k]) / max(gradient_norm, MIN_DIVISOR) + beyond
            cosine = along / max(np.sqrt(normal_square) * gradient_norm, MIN_DIVISOR)
            squares += distance**2
            # a comparison with nan is false: once it occurs it stays
            if not (distance <= worst or np.isnan(worst)):
                worst = distance
            if not (cosine >= least or np.isnan(least)):
                least = cosine
        distances[each], mean_squares[each], cosines[each] = worst, squares / points.shape[1], least
    return distances, mean_squares, cosines
