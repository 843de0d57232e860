"""The solutions of linear conditions as an affine subspace, by one singular value decomposition of the rows.

The rows are decomposed, never their products, so a condition number is not squared. With rows in orthonormal coordinates,
scaled per order, the smallest non-zero singular value is 2e-3 and the zeros are 1e-15 for one span of degree 7 to 16 with
G2 conditions on all sides: the rank is not a matter of taste.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array
from tpmscad.splines.continuity_conditions import ContinuityConditions
from tpmscad.splines.spline_axis import SplineAxis

SINGULAR_VALUE_RTOL = 1e-11
"""Singular values below this share of the largest are redundant rows: far above round-off, far below those that count."""

CONSISTENCY_RTOL = 1e-9
"""Greatest residual of the conditions, relative to the longest target, before they count as contradictory."""


POLE_EXCURSION_WEIGHT = 1e-5
"""`pole_metric` counts a pole's movement this much: poles then stay within 0.02 cells of minimal surfaces (3 at degree 16
without), and deviations grow by 10 % (degree 13) to 70 % (16)."""


@dataclass(frozen=True, slots=True, eq=False)
class AffineSubspace:
    """{x : A x = b} with a metric D (n,): lengths are |D x|, nearest and orthogonal are meant in it; None is D = 1.

    `rows` V (rank, n) are orthonormal and span the rows of A / D, `particular` is the point nearest to the origin (n,).
    """

    rows: Array
    particular: Array
    metric: Array | None = None

    @property
    def dimension(self) -> int:
        return self.rows.shape[1] - self.rows.shape[0]

    def direction(self, x: Array) -> Array:
        """The part of a vector along the subspace: the orthogonal projector I - V^T V (in D x) applied to (..., n)."""
        scaled = x if self.metric is None else x * self.metric
        part = scaled - (scaled @ self.rows.T) @ self.rows
        # A second pass takes away what the first leaves by cancellation where x is nearly in the row space.
        part = part - (part @ self.rows.T) @ self.rows
        return part if self.metric is None else part / self.metric

    def project(self, x: Array) -> Array:
        """The nearest point of the subspace: (..., n)."""
        return self.particular + self.direction(x - self.particular)

    def basis(self) -> Array:
        """Orthonormal directions of the subspace: (n, dimension)."""
        complement = np.linalg.qr(self.rows.T, mode="complete")[0][:, len(self.rows) :]
        return complement if self.metric is None else complement / self.metric[:, None]


def solve_conditions(conditions: ContinuityConditions, metric: Array | None = None) -> AffineSubspace:
    """The subspace that satisfies the conditions; ValueError if they contradict one another.

    `metric` (n,), positive, decides which of its points is nearest to a given one.
    """
    matrix = conditions.matrix if metric is None else conditions.matrix / metric
    left, values, right = np.linalg.svd(matrix, full_matrices=False)
    rank = int(np.count_nonzero(values > SINGULAR_VALUE_RTOL * values[0]))
    left, values, right = left[:, :rank], values[:rank], right[:rank]
    particular = right.T @ ((left.T @ conditions.target) / values)
    residual = np.abs(matrix @ particular - conditions.target).max()
    if residual > CONSISTENCY_RTOL * max(1.0, np.abs(conditions.target).max()):
        raise ValueError(f"the conditions contradict one another: residual {residual:.3g}")
    return AffineSubspace(right, particular if metric is None else particular / metric, metric)


def pole_metric(axis_u: SplineAxis, axis_v: SplineAxis, dimension: int = 3) -> Array:
    """A metric in which the nearest surface also has poles near those of the surface that is projected: (U V dimension,).

    High Legendre coordinates have Bernstein coefficients of up to 4^degree per direction: what meets conditions cheapest in
    L2 can send poles out by cells (nodal Schwarz P, degree 16: 190), so a CAD system's box around them means nothing. A
    coordinate that moves poles by up to a for a unit of it counts sqrt(1 + (WANDERING a)^2); up to degree 10 this is 1.
    """
    reach = np.multiply.outer(np.abs(axis_u.to_poles).max(axis=0), np.abs(axis_v.to_poles).max(axis=0))
    return np.repeat(np.sqrt(1 + (POLE_EXCURSION_WEIGHT * reach.ravel()) ** 2), dimension)


def unconstrained_subspace(size: int) -> AffineSubspace:
    """The whole space of `size` unknowns: no condition."""
    return AffineSubspace(np.zeros((0, size)), np.zeros(size))
