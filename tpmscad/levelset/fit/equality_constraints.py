"""Quadratic functions minimised under linear conditions, many small problems at once, by LAPACK.

The conditions of a problem are factorised by their singular values, or, where they are many, by a QR decomposition of the
transposed rows with column pivoting, which is faster (Golub and Van Loan, "Matrix computations", 2.4 and 5.4.2). The minimum is
sought in the null space of the conditions (Nocedal and Wright, "Numerical optimization", 16.2).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import lapack

from tpmscad._typing import Array, IntArray

MIN_PIVOT = 1e-8
"""Pivots or singular values of hard rows below this fraction of the largest count as zero: of the rows for tangent continuity
many follow from others. A row that is left out so is violated by an angle of about this fraction of a radian."""

BLOCK_SIZE = 32
"""Columns that LAPACK factorises at once where its workspace allows it, as in its own defaults."""

MAX_SIZE_OF_SVD = 64
"""Entries of the rows of a problem up to which a decomposition by singular values takes no longer than the call of a QR
decomposition."""


@dataclass(frozen=True, slots=True, eq=False)
class EqualityConstraints:
    """Linear conditions rows @ x = target on the unknowns of n problems, redundant ones among them.

    `involved` (k,) are the unknowns that the conditions contain, `rank` (n,) tells how many of the m conditions of a problem
    count. The first k - rank columns of `null_space` (n, k, d) are an orthonormal basis of the changes that keep the conditions,
    the others are zero; `inverse` (n, k, m) gives the least change that meets a target.
    """

    involved: IntArray
    rank: IntArray
    null_space: Array
    inverse: Array

    @staticmethod
    def factorise(rows: Array) -> EqualityConstraints:
        """The factors of rows (n, m, unknowns)."""
        involved = np.flatnonzero((rows != 0.0).any(axis=(0, 1)))
        rows = rows[:, :, involved]
        factorise = _factorise_by_svd if rows[0].size <= MAX_SIZE_OF_SVD else _factorise_by_qr
        rank, null_space, inverse = factorise(rows)
        return EqualityConstraints(
            involved, rank, null_space[:, :, : len(involved) - rank.min(initial=len(involved))], inverse
        )

    def __getitem__(self, part: slice) -> EqualityConstraints:
        """The conditions of some of the problems."""
        return EqualityConstraints(self.involved, self.rank[part], self.null_space[part], self.inverse[part])

    def minimise(self, matrix: Array, rhs: Array, target: Array) -> Array:
        """The solutions (n, unknowns) of rows @ x = target (n, m) that minimise x' matrix x / 2 - rhs' x.

        The matrices (n, unknowns, unknowns) are symmetric and positive definite on the null space.
        """
        n, size = rhs.shape
        is_free = np.ones(size, bool)
        is_free[self.involved] = False
        free, held = np.flatnonzero(is_free), self.involved
        turned = np.concatenate((free, held))
        null, f = self.null_space, len(free)
        start = (self.inverse @ target[..., None])[..., 0]
        rows = matrix[:, turned[:, None], held]
        slope = rhs[:, turned] - (rows @ start[..., None])[..., 0]
        across = rows @ null
        reduced = np.empty((n, f + null.shape[2], f + null.shape[2]))
        reduced[:, :f, :f] = matrix[:, free[:, None], free]
        reduced[:, :f, f:] = across[:, :f]
        reduced[:, f:, :f] = across[:, :f].swapaxes(1, 2)
        reduced[:, f:, f:] = null.swapaxes(1, 2) @ across[:, f:]
        # the columns of zeros of the null space ask nothing: their unknowns are set to zero
        spare, own = np.nonzero(~null.any(axis=1))
        reduced[spare, f + own, f + own] = 1.0
        right = np.concatenate((slope[:, :f], (slope[:, None, f:] @ null)[:, 0]), axis=1)
        found = _solve_each(reduced, right)
        solution = np.empty((n, size))
        solution[:, free] = found[:, :f]
        solution[:, held] = start + (null @ found[:, f:, None])[..., 0]
        return solution


def _factorise_by_svd(rows: Array) -> tuple[IntArray, Array, Array]:
    """Rank, null space and inverse of rows (n, m, k), all at once: the few conditions of each of many curves."""
    left, size, right = np.linalg.svd(rows, full_matrices=True)
    counts = size > MIN_PIVOT * size[:, :1]
    rank, k = counts.sum(axis=1), rows.shape[2]
    null_space = right[:, ::-1].swapaxes(1, 2) * (np.arange(k) < k - rank[:, None])[:, None]
    scale = np.where(counts, 1.0 / np.where(counts, size, 1.0), 0.0)
    some = size.shape[1]
    inverse = right[:, :some].swapaxes(1, 2) @ (scale[:, :, None] * left[:, :, :some].swapaxes(1, 2))
    return rank, null_space, inverse


def _factorise_by_qr(rows: Array) -> tuple[IntArray, Array, Array]:
    """As `_factorise_by_svd`, one problem after the other: many conditions, as those of patches."""
    n, m, k = rows.shape
    rank, null_space, inverse = np.zeros(n, np.int64), np.zeros((n, k, k)), np.zeros((n, k, m))
    for each in range(n):
        factors, order, scales, _, _ = lapack.dgeqp3(rows[each].T, lwork=(m + 1) * BLOCK_SIZE + 2 * m)
        pivots = np.abs(factors.diagonal())
        r = int(np.count_nonzero(pivots > MIN_PIVOT * pivots[0]))
        basis = np.eye(k, order="F")
        if r:
            basis, _, _ = lapack.dormqr("L", "N", factors[:, :r], scales[:r], basis, lwork=k * BLOCK_SIZE)
            inverse[each][:, order[:r] - 1] = lapack.dtrtrs(factors[:r, :r], basis[:, :r].T)[0].T
        rank[each], null_space[each, :, : k - r] = r, basis[:, r:]
    return rank, null_space, inverse


def _solve_each(matrix: Array, right: Array) -> Array:
    """Solutions (n, k) of systems (n, k, k), nan where a matrix is singular."""
    try:
        return np.asarray(np.linalg.solve(matrix, right[..., None])[..., 0])
    except np.linalg.LinAlgError:
        if len(matrix) == 1:
            return np.full(right.shape, np.nan)
        return np.concatenate([_solve_each(matrix[k : k + 1], right[k : k + 1]) for k in range(len(matrix))])
