"""Trivariate weights w = sum_ijk B_i(x) B_j(y) B_k(z) C_ijk over the box of the regions (porous blending, eq. 13).

A coefficient is fixed if its support meets a region outside the blending region: at 0 for the first region and at 1 for the
second (eqs 14 and 16). All other coefficients are free. Where a support meets both regions the knots must be refined.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import BSpline, NdBSpline
from scipy.sparse import csr_array

from tpmscad._typing import Array, BoolArray
from tpmscad.fields.field import Field
from tpmscad.fields.tape.tape_nodes import Node, clamp, tensor_spline

IntTriple = tuple[int, int, int]
Knots = tuple[Array, Array, Array]


@dataclass(frozen=True, slots=True, eq=False)
class VolumeWeight(Field):
    """A tensor-product B-spline weight: coefficients (nu, nv, nw), knots and degree of each axis, free mask (nu, nv, nw).

    `lower_bounds` and `upper_bounds` of the free coefficients lie within [0, 1]. The weight of points (..., 3) is (...), in
    [0, 1] if the coefficients are; `gradient` is exact. Beyond the box the weight is constant along each axis.
    """

    coefficients: Array
    knots: Knots
    degree: IntTriple
    is_free: BoolArray
    lower_bounds: float | Array = 0.0
    upper_bounds: float | Array = 1.0

    def trace(self, x: Node, y: Node, z: Node) -> Node:
        """The weight on the nodes of a tape."""
        ends = [(float(t[p]), float(t[-p - 1])) for t, p in zip(self.knots, self.degree, strict=True)]
        u, v, w = (clamp(t, low, high) for t, (low, high) in zip((x, y, z), ends, strict=True))
        value = tensor_spline(self.knots, self.degree, self.coefficients, (u, v, w))
        return x.recorder.with_gradient(clamp(value, 0.0, 1.0), (value,), lambda: (1.0,))

    def on_grid(self, x: ArrayLike, y: ArrayLike, z: ArrayLike) -> Array:
        """Values on the tensor-product grid of three axes: (nx, ny, nz)."""
        rows = [self._basis_rows(axis, np.asarray(t, float)) for axis, t in enumerate((x, y, z))]
        return np.clip(apply_along_axes(self.coefficients, rows), 0.0, 1.0)

    def apply_transpose(self, x: Array, y: Array, z: Array, values: Array) -> Array:
        """Sums over a grid of values (nx, ny, nz) times each basis function: (nu, nv, nw)."""
        rows = [csr_array(self._basis_rows(axis, t).T) for axis, t in enumerate((x, y, z))]
        return apply_along_axes(values, rows)

    def design_matrix(self, points: Array) -> csr_array:
        """Values of all basis functions at points (m, 3): sparse (m, nu * nv * nw)."""
        if len(points) == 0:  # SciPy 1.17 cannot make a matrix without rows
            return csr_array((0, self.coefficients.size))
        rows = NdBSpline.design_matrix(self._clamp(points), self.knots, self.degree)
        # SciPy 1.17 makes the matrix only as wide as the last coefficient it uses.
        return csr_array((rows.data, rows.indices, rows.indptr), shape=(len(points), self.coefficients.size))

    def with_coefficients(self, coefficients: Array) -> VolumeWeight:
        """The weight with other coefficients (nu, nv, nw)."""
        return replace(self, coefficients=coefficients)

    def _clamp(self, points: Array) -> Array:
        low = np.array([t[p] for t, p in zip(self.knots, self.degree, strict=True)])
        high = np.array([t[-p - 1] for t, p in zip(self.knots, self.degree, strict=True)])
        return np.clip(points, low, high)

    def _basis_rows(self, axis: int, t: Array) -> csr_array:
        knots, degree = self.knots[axis], self.degree[axis]
        return csr_array(BSpline.design_matrix(np.clip(t, knots[degree], knots[-degree - 1]), knots, degree))


def apply_along_axes(values: Array, matrices: list[csr_array]) -> Array:
    """Mode-n products (Kolda and Bader 2009) of values (a, b, c) with sparse (A, a), (B, b), (C, c): (A, B, C)."""
    for matrix in matrices:
        rest = values.shape[1:]
        values = np.moveaxis((matrix @ values.reshape(values.shape[0], -1)).reshape(matrix.shape[0], *rest), 0, -1)
    return np.ascontiguousarray(values)


def find_touched_supports(
    mask: BoolArray, axes: tuple[Array, Array, Array], knots: Knots, degree: IntTriple
) -> BoolArray:
    """Mask (nu, nv, nw) of the basis functions with a sample of the mask (nx, ny, nz) in or next to their support.

    The extra sample on each side errs on the safe side: the edge of the masked set lies within a sample of what the grid shows.
    The samples in a box are counted with prefix sums (a summed-area table).
    """
    prefix_sum = np.zeros(tuple(n + 1 for n in mask.shape), np.int64)
    prefix_sum[1:, 1:, 1:] = mask.cumsum(0).cumsum(1).cumsum(2)
    for axis in range(3):
        first = np.maximum(np.searchsorted(axes[axis], knots[axis][: -degree[axis] - 1], side="right") - 1, 0)
        last = np.searchsorted(axes[axis], knots[axis][degree[axis] + 1 :], side="left") + 1
        last = np.minimum(last, mask.shape[axis])
        prefix_sum = np.take(prefix_sum, last, axis=axis) - np.take(prefix_sum, first, axis=axis)
    return prefix_sum > 0
