"""Three-dimensional weights w = sum B_i(x) B_j(y) B_k(z) C_ijk over the box of the regions (porous blending, eq. 13).

A coefficient is fixed where its support meets a region outside the blending region: at 0 for the first region, at 1 for the
second (eqs 14 and 16); all others are free. A support that meets both makes the knots be refined there.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import BSpline, NdBSpline
from scipy.sparse import csr_array

from tpmscad._typing import Array, BoolArray
from tpmscad.splines.tensor_product import evaluate_tensor_product

IntTriple = tuple[int, int, int]
Knots = tuple[Array, Array, Array]


@dataclass(frozen=True, slots=True, eq=False)
class VolumeWeight:
    """A weight of x, y, z: coefficients (nu, nv, nw), knots and degree of each axis, and which coefficients are free.

    Called with points (..., 3) it returns w (...), in [0, 1] if its coefficients are; `gradient` is exact. Constant along each
    axis beyond the box.
    """

    coefficients: Array
    knots: Knots
    degree: IntTriple
    free: BoolArray
    low: float | Array = 0.0
    high: float | Array = 1.0
    """Bounds of the free coefficients, within [0, 1]."""

    def __call__(self, points: ArrayLike) -> Array:
        points = np.asarray(points, float)
        spline = NdBSpline(self.knots, self.coefficients, self.degree)
        return np.clip(spline(self._inside(points).reshape(-1, 3)).reshape(points.shape[:-1]), 0.0, 1.0)

    def gradient(self, points: ArrayLike) -> Array:
        return self.value_and_gradient(points)[1]

    def value_and_gradient(self, points: ArrayLike) -> tuple[Array, Array]:
        """Both at once, in a third of the time."""
        points = np.asarray(points, float)
        near = self._inside(points)
        value, slope = evaluate_tensor_product(self.coefficients, self.knots, self.degree, near.reshape(-1, 3))
        value = np.clip(value, 0.0, 1.0).reshape(points.shape[:-1])
        return value, np.where(points == near, slope.reshape(points.shape), 0.0)

    def on_grid(self, x: Array, y: Array, z: Array) -> Array:
        """The weight on the grid of all x with all y with all z."""
        rows = [self._rows(axis, t) for axis, t in enumerate((x, y, z))]
        return np.clip(apply_along_axes(self.coefficients, rows), 0.0, 1.0)

    def adjoint(self, x: Array, y: Array, z: Array, values: Array) -> Array:
        """sum over that grid of values (nx, ny, nz) times each basis function: (nu, nv, nw)."""
        rows = [csr_array(self._rows(axis, t).T) for axis, t in enumerate((x, y, z))]
        return apply_along_axes(values, rows)

    def design(self, points: Array) -> csr_array:
        """Values of every basis function at points (m, 3): sparse (m, nu * nv * nw)."""
        rows = NdBSpline.design_matrix(self._inside(points), self.knots, self.degree)
        # SciPy 1.17 makes the matrix only as wide as the last coefficient it uses.
        return csr_array((rows.data, rows.indices, rows.indptr), shape=(len(points), self.coefficients.size))

    def moved(self, coefficients: Array) -> VolumeWeight:
        return replace(self, coefficients=coefficients)

    def _inside(self, points: Array) -> Array:
        low = np.array([t[p] for t, p in zip(self.knots, self.degree, strict=True)])
        high = np.array([t[-p - 1] for t, p in zip(self.knots, self.degree, strict=True)])
        return np.clip(points, low, high)

    def _rows(self, axis: int, t: Array) -> csr_array:
        knots, degree = self.knots[axis], self.degree[axis]
        return csr_array(BSpline.design_matrix(np.clip(t, knots[degree], knots[-degree - 1]), knots, degree))


def apply_along_axes(values: Array, rows: list[csr_array]) -> Array:
    """Each axis of values (a, b, c) multiplied by its sparse matrix: rows (A, a), (B, b), (C, c) -> (A, B, C)."""
    for matrix in rows:
        rest = values.shape[1:]
        values = np.moveaxis((matrix @ values.reshape(values.shape[0], -1)).reshape(matrix.shape[0], *rest), 0, -1)
    return np.ascontiguousarray(values)


def make_clamped_uniform_knots(low: float, high: float, count: int, degree: int) -> Array:
    """Clamped uniform knots of `count` basis functions on [low, high]."""
    return np.concatenate([np.full(degree, low), np.linspace(low, high, count - degree + 1), np.full(degree, high)])


def find_touched_supports(
    mask: BoolArray, axes: tuple[Array, Array, Array], knots: Knots, degree: IntTriple
) -> BoolArray:
    """Whether each basis function's support holds a sample of the mask, the samples next to the support included: (nu, nv, nw).

    One sample more on each side, so that what is marked lies within a sample of the true edge on the careful side.
    """
    total = np.zeros(tuple(n + 1 for n in mask.shape), np.int64)
    total[1:, 1:, 1:] = mask.cumsum(0).cumsum(1).cumsum(2)
    for axis in range(3):
        first = np.maximum(np.searchsorted(axes[axis], knots[axis][: -degree[axis] - 1], side="right") - 1, 0)
        last = np.searchsorted(axes[axis], knots[axis][degree[axis] + 1 :], side="left") + 1
        last = np.minimum(last, mask.shape[axis])
        total = np.take(total, last, axis=axis) - np.take(total, first, axis=axis)
    return total > 0
