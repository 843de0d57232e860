"""The solutions of linear conditions as an affine subspace, by one singular value decomposition of the rows.

The rows are decomposed, never their products, so that a condition number is not squared. With rows in orthonormal
coordinates, scaled per order, the smallest non-zero singular value is 2e-3 and the zero ones are 1e-15 (one span of degree 7 to
16 with G2 conditions on all sides): the numerical rank is unambiguous.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array
from tpmscad.splines.continuity_conditions import ContinuityConditions
from tpmscad.splines.spline_axis import SplineAxis

SINGULAR_VALUE_RTOL = 1e-11
"""Singular values below this fraction of the largest belong to redundant rows: far above round-off, far below the others."""

CONSISTENCY_RTOL = 1e-9
"""Greatest residual of the conditions, relative to the longest target, for which they count as consistent."""

POLE_EXCURSION_WEIGHT = 1e-5
"""Weight of a pole's displacement in `pole_metric`. Poles then stay within 0.02 cells of minimal surfaces."""


@dataclass(frozen=True, slots=True, eq=False)
class AffineSubspace:
    """The affine subspace {x : A x = b} of R^n, with an optional diagonal metric D.

    Lengths are |D x|; "nearest" and "orthogonal" are meant in this metric.

    Parameters
    ----------
    row_basis : ndarray, shape (rank, n)
        Orthonormal basis V of the row space of A D^-1.
    min_norm_point : ndarray, shape (n,)
        The point of the subspace nearest to the origin.
    metric : ndarray, shape (n,), optional
        The positive diagonal of D; one by default.

    Examples
    --------
    >>> import numpy as np
    >>> from tpmscad.splines import AffineSubspace
    >>> line = AffineSubspace(np.array([[0.0, 1.0]]), np.array([0.0, 2.0]))  # y = 2
    >>> line.project(np.array([3.0, 5.0]))
    array([3., 2.])
    """

    row_basis: Array
    min_norm_point: Array
    metric: Array | None = None

    @property
    def dimension(self) -> int:
        """Dimension of the subspace."""
        return self.row_basis.shape[1] - self.row_basis.shape[0]

    def length(self, x: Array) -> float:
        """Length |D x| of a vector (n,)."""
        return float(np.linalg.norm(x if self.metric is None else x * self.metric))

    def project_direction(self, x: Array) -> Array:
        """Component of vectors (..., n) along the subspace: the orthogonal projector I - V^T V, applied to D x."""
        scaled = x if self.metric is None else x * self.metric
        along = scaled - (scaled @ self.row_basis.T) @ self.row_basis
        # A second pass removes what cancellation leaves of the first where x lies nearly in the row space.
        along = along - (along @ self.row_basis.T) @ self.row_basis
        return along if self.metric is None else along / self.metric

    def project(self, x: Array) -> Array:
        """Nearest points of the subspace: (..., n)."""
        return self.min_norm_point + self.project_direction(x - self.min_norm_point)

    def null_space_basis(self) -> Array:
        """Basis of the directions of the subspace, orthonormal in the metric: (n, dimension)."""
        complement = np.linalg.qr(self.row_basis.T, mode="complete")[0][:, len(self.row_basis) :]
        return complement if self.metric is None else complement / self.metric[:, None]


def solve_conditions(conditions: ContinuityConditions, metric: Array | None = None) -> AffineSubspace:
    """Solution space of linear conditions.

    Parameters
    ----------
    conditions : ContinuityConditions
        Rows and targets; redundant rows are allowed.
    metric : ndarray, shape (n,), optional
        Positive diagonal of the metric that decides which point of the subspace is nearest to a given one.

    Returns
    -------
    AffineSubspace
        All vectors that satisfy the conditions.

    Raises
    ------
    ValueError
        If the conditions contradict one another.

    Examples
    --------
    >>> import numpy as np
    >>> from tpmscad.splines import ContinuityConditions, solve_conditions
    >>> solve_conditions(ContinuityConditions(np.array([[0.0, 1.0]]), np.array([2.0]), np.array([0]))).dimension
    1
    """
    matrix = conditions.matrix if metric is None else conditions.matrix / metric
    left, values, right = np.linalg.svd(matrix, full_matrices=False)
    rank = int(np.count_nonzero(values > SINGULAR_VALUE_RTOL * values[0]))
    left, values, right = left[:, :rank], values[:rank], right[:rank]
    point = right.T @ ((left.T @ conditions.target) / values)
    residual = np.abs(matrix @ point - conditions.target).max()
    limit = CONSISTENCY_RTOL * max(1.0, np.abs(conditions.target).max())
    if residual > limit:
        raise ValueError(f"the conditions contradict one another: residual {residual:.3g} exceeds {limit:.3g}")
    return AffineSubspace(right, point if metric is None else point / metric, metric)


def pole_metric(axis_u: SplineAxis, axis_v: SplineAxis, dimension: int = 3) -> Array:
    """Metric that keeps the poles of a projected surface near those of the original.

    Parameters
    ----------
    axis_u, axis_v : SplineAxis
        The spline spaces.
    dimension : int, optional
        Dimension D of the poles.

    Returns
    -------
    ndarray, shape (U V D,)
        Positive diagonal for `solve_conditions`, at least one everywhere.

    Notes
    -----
    Legendre coordinates of high degree have Bernstein coefficients of up to 4^degree per direction. The L2-nearest surface that
    satisfies conditions may then have poles many cells away from the surface, and a bounding box of the poles is useless. A
    coordinate that displaces poles by up to a per unit is weighted by sqrt(1 + (w a)^2), w = `POLE_EXCURSION_WEIGHT`; up to
    degree 10 the weight is 1.

    Examples
    --------
    >>> from tpmscad.splines import bezier_knots, gauss_axis, pole_metric
    >>> axis = gauss_axis(bezier_knots(3), 3)
    >>> pole_metric(axis, axis).shape
    (48,)
    """
    max_pole_shift = np.multiply.outer(np.abs(axis_u.to_poles).max(axis=0), np.abs(axis_v.to_poles).max(axis=0))
    return np.repeat(np.sqrt(1 + (POLE_EXCURSION_WEIGHT * max_pole_shift.ravel()) ** 2), dimension)


def unconstrained_subspace(size: int) -> AffineSubspace:
    """The whole space as a subspace without conditions.

    Parameters
    ----------
    size : int
        Number of unknowns.

    Returns
    -------
    AffineSubspace
        A subspace whose projections change nothing.

    Examples
    --------
    >>> from tpmscad.splines import unconstrained_subspace
    >>> unconstrained_subspace(5).dimension
    5
    """
    return AffineSubspace(np.zeros((0, size)), np.zeros(size))
