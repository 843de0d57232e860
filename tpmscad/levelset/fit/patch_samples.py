"""Points and normals of Bezier patches on grids of parameters, what is measured there, and distances by foot points."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.brep.orthogonal_projection import project_to_surface
from tpmscad.levelset.quadmesh.vectors import MIN_DIVISOR
from tpmscad.splines.basis import bernstein_basis

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


REST_STEP = 1e-7
"""A projection ends with a step of the parameters below this: the distance is then off by about its square."""

POINTS_AT_ONCE = 4096
"""Points whose foot points are sought together, whose nets stay in a cache: on patches of degree 7 4.1 us each; 6.6 of 40,000."""

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
    result = np.empty(len(points))
    for first in range(0, len(points), POINTS_AT_ONCE):
        some = slice(first, first + POINTS_AT_ONCE)
        result[some] = _foot_point_distances(poles, patch[some], points[some], u[some], v[some])
    return result


def _foot_point_distances(poles: Array, patch: IntArray, points: Array, u: Array, v: Array) -> Array:
    """As `foot_point_distances`, of all points at once."""
    p, q = poles.shape[1] - 1, poles.shape[2] - 1

    def jet(s: Array, t: Array, rows: IntArray) -> tuple[Array, Array, Array]:
        nets = poles[patch[rows]].reshape(len(rows), p + 1, 3 * (q + 1))
        (bu, du), (bv, dv) = ([bernstein_basis(d, x, k)[:, None] for k in (0, 1)] for d, x in ((p, s), (q, t)))
        along_v, slope = ((rows_u @ nets).reshape(len(s), q + 1, 3) for rows_u in (bu, du))
        return (bv @ along_v)[:, 0], (bv @ slope)[:, 0], (dv @ along_v)[:, 0]

    u, v = project_to_surface(jet, points, u, v, ((0.0, 1.0), (0.0, 1.0)), REST_STEP)
    return np.asarray(np.linalg.norm(points - jet(u, v, np.arange(len(points)))[0], axis=1))
