"""Points and normals of Bezier patches on grids of parameters, what is measured there, and, compiled, foot points.

A foot point is the orthogonal projection of a point onto a patch, by a Gauss-Newton iteration from a given parameter, kept inside
the patch: a parameter that would leave it stays, and the other takes its own best step.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from tpmscad._compiled_loops import njit_cached
from tpmscad._typing import Array, IntArray
from tpmscad.levelset.quadmesh.vectors import MIN_DIVISOR

BasisAndSlopes = tuple[Array, Array]
"""Values and derivatives (m, degree + 1) of the basis functions in one parameter."""


def evaluate_points_and_normals(poles: Array, u: BasisAndSlopes, v: BasisAndSlopes) -> tuple[Array, Array]:
    """Points and normals (n, k l, 3), not of unit length, of patches (n, p + 1, q + 1, 3) on a grid (k, l), u first."""
    (bu, du), (bv, dv) = u, v
    nets = poles.reshape(len(poles), -1, 3).swapaxes(0, 1).reshape(-1, 3 * len(poles))
    # one product of matrices for all patches: a product for each axis would have only three columns
    points, along_u, along_v = (
        np.ascontiguousarray((np.kron(*bases) @ nets).reshape(-1, len(poles), 3).swapaxes(0, 1))
        for bases in ((bu, bv), (du, bv), (bu, dv))
    )
    return points, np.cross(along_u, along_v)


def measure_samples(
    points: Array, normals: Array, value: Array, gradient: Array, lo: Array, hi: Array
) -> tuple[Array, Array, Array]:
    """Largest and mean square distance (n,) of patches from a level set, and their least cosine (n,) with the gradient.

    `points`, `normals` and `gradient` are (n, m, 3), `value` is (n, m). The distance is |value| / |gradient|, and what a point
    is beyond the box [lo, hi] is added to it. Measurements that are not finite make the result so.
    """
    along, normal_square, square = (
        np.einsum("nmi,nmi->nm", a, b) for a, b in ((normals, gradient), (normals, normals), (gradient, gradient))
    )
    slope = np.sqrt(square)
    beyond = np.maximum(np.maximum(lo - points, points - hi).max(axis=2), 0.0)
    with np.errstate(over="ignore"):
        distance = np.abs(value) / np.maximum(slope, MIN_DIVISOR) + beyond
        mean_square = (distance**2).mean(axis=1)
    cosine = along / np.maximum(np.sqrt(normal_square) * slope, MIN_DIVISOR)
    return distance.max(axis=1), mean_square, cosine.min(axis=1)


FOOT_POINT_STEPS = 6
"""Largest number of Gauss-Newton steps of a projection."""

REST_STEP = 1e-7
"""A projection ends with a step of the parameters below this: the distance is then off by about its square."""

RETRY_FRACTION = 0.5
"""Points farther from the patches than this fraction of the tolerance are tried again with more starts."""


def least_foot_distances(
    count: int,
    tol: float,
    starts: Sequence[int],
    nearest: Callable[[IntArray, int], IntArray],
    measure: Callable[[IntArray, IntArray], Array],
) -> Array:
    """Distances (count,) of points from the patches near them, exact where they are below half of `tol`.

    `starts`: from how many samples of the patches a foot point is sought, first try and retry. `nearest(points, k)` numbers the k
    samples (n, k) that are nearest to points of these numbers (n,), and `measure(points, samples)` gives the distances (n,) to
    the foot points that are found from one sample for each point.
    """
    best = np.full(count, np.inf)
    for number in starts:
        chosen = np.flatnonzero(best > RETRY_FRACTION * tol)
        if not len(chosen):
            break
        for samples in nearest(chosen, number).T:
            best[chosen] = np.minimum(best[chosen], measure(chosen, samples))
    return best


def foot_point_distances(poles: Array, patch: IntArray, points: Array, u: Array, v: Array) -> Array:
    """Distances (n,) from points (n, 3) to their foot points on patches (n,), from starting parameters u, v (n,).

    `poles` (m, p + 1, q + 1, 3) are those of all patches.
    """
    arrays = (np.ascontiguousarray(each) for each in (poles, patch.astype(np.int64), points))
    return _project(*arrays, u.astype(float), v.astype(float))


@njit_cached
def _bernstein(degree: int, t: float, values: Array, slopes: Array) -> None:  # pragma: no cover
    """Bernstein polynomials at t and their derivatives, by the recursion over the degree."""
    values[0] = 1.0
    for d in range(1, degree + 1):
        if d == degree:
            slopes[0] = -degree * values[0]
            for i in range(1, degree):
                slopes[i] = degree * (values[i - 1] - values[i])
            slopes[degree] = degree * values[degree - 1]
        values[d] = t * values[d - 1]
        for i in range(d - 1, 0, -1):
            values[i] = (1.0 - t) * values[i] + t * values[i - 1]
        values[0] *= 1.0 - t


@njit_cached
def _project(poles: Array, patch: IntArray, points: Array, u: Array, v: Array) -> Array:  # pragma: no cover
    """The distances (n,); the parameters become those of the foot points."""
    distances, p, q = np.empty(len(points)), poles.shape[1] - 1, poles.shape[2] - 1
    bu, du, bv, dv = np.empty(p + 1), np.empty(p + 1), np.empty(q + 1), np.empty(q + 1)
    residual, xu, xv = np.empty(3), np.empty(3), np.empty(3)
    for n in range(len(points)):
        net = poles[patch[n]]
        for step in range(FOOT_POINT_STEPS + 1):
            _bernstein(p, u[n], bu, du)
            _bernstein(q, v[n], bv, dv)
            for x in range(3):
                at, along, across = 0.0, 0.0, 0.0
                for i in range(p + 1):
                    row, turned = 0.0, 0.0
                    for j in range(q + 1):
                        row += net[i, j, x] * bv[j]
                        turned += net[i, j, x] * dv[j]
                    at += bu[i] * row
                    along += du[i] * row
                    across += bu[i] * turned
                residual[x], xu[x], xv[x] = points[n, x] - at, along, across
            if step == FOOT_POINT_STEPS:
                break
            a, b, c, ru, rv = 0.0, 0.0, 0.0, 0.0, 0.0
            for x in range(3):
                a += xu[x] * xu[x]
                b += xu[x] * xv[x]
                c += xv[x] * xv[x]
                ru += xu[x] * residual[x]
                rv += xv[x] * residual[x]
            a, c = max(a, MIN_DIVISOR), max(c, MIN_DIVISOR)
            determinant = max(a * c - b * b, MIN_DIVISOR)
            step_u, step_v = (c * ru - b * rv) / determinant, (a * rv - b * ru) / determinant
            stuck_u = not 0.0 <= u[n] + step_u <= 1.0
            stuck_v = not 0.0 <= v[n] + step_v <= 1.0
            new_u = u[n] + (ru / a if stuck_v else step_u)
            new_v = v[n] + (rv / c if stuck_u else step_v)
            new_u, new_v = min(max(new_u, 0.0), 1.0), min(max(new_v, 0.0), 1.0)
            moved = max(abs(new_u - u[n]), abs(new_v - v[n]))
            u[n], v[n] = new_u, new_v
            if moved <= REST_STEP:
                break
        distances[n] = np.sqrt(residual[0] ** 2 + residual[1] ** 2 + residual[2] ** 2)
    return distances
