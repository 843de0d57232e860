"""The solutions of linear conditions as an affine subspace, by one singular value decomposition of the rows.

The rows are decomposed, never their products, so a condition number is not squared. With rows in orthonormal coordinates,
scaled per order, the smallest non-zero singular value is 2e-3 and the zeros are 1e-15 for one span of degree 7 to 16 with
G2 conditions on all sides: the rank is not a matter of taste.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad.splines.bspline import Array
from tpmscad.splines.continuity import Conditions

RANK = 1e-11
"""Singular values below this share of the largest are redundant rows: far above round-off, far below those that count."""

CONSISTENCY = 1e-9
"""Greatest residual of the conditions, relative to the longest target, before they count as contradictory."""


@dataclass(frozen=True, slots=True, eq=False)
class Subspace:
    """{x : V (x - particular) = 0}: orthonormal rows V (rank, n), and the point of it nearest to the origin (n,)."""

    rows: Array
    particular: Array

    @property
    def dimension(self) -> int:
        return self.rows.shape[1] - self.rows.shape[0]

    def direction(self, x: Array) -> Array:
        """The part of a vector along the subspace: the orthogonal projector I - V^T V applied to (..., n)."""
        part = x - (x @ self.rows.T) @ self.rows
        # A second pass takes away what the first leaves by cancellation where x is nearly in the row space.
        return part - (part @ self.rows.T) @ self.rows

    def project(self, x: Array) -> Array:
        """The nearest point of the subspace: (..., n)."""
        return self.particular + self.direction(x - self.particular)

    def basis(self) -> Array:
        """Orthonormal directions of the subspace: (n, dimension)."""
        return np.linalg.qr(self.rows.T, mode="complete")[0][:, len(self.rows) :]


def solve_conditions(conditions: Conditions) -> Subspace:
    """The subspace that satisfies the conditions; ValueError if they contradict one another."""
    left, values, right = np.linalg.svd(conditions.matrix, full_matrices=False)
    rank = int(np.count_nonzero(values > RANK * values[0]))
    left, values, right = left[:, :rank], values[:rank], right[:rank]
    particular = right.T @ ((left.T @ conditions.target) / values)
    residual = np.abs(conditions.matrix @ particular - conditions.target).max()
    if residual > CONSISTENCY * max(1.0, np.abs(conditions.target).max()):
        raise ValueError(f"the conditions contradict one another: residual {residual:.3g}")
    return Subspace(right, particular)


def free(size: int) -> Subspace:
    """The whole space of `size` unknowns: no condition."""
    return Subspace(np.zeros((0, size)), np.zeros(size))
