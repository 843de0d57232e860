"""Quadratic functions minimised under linear conditions, many small problems at once, by LAPACK.

The conditions of a problem are factorised by a QR decomposition of the transposed rows with column pivoting (Golub and Van Loan,
"Matrix computations", 5.4.2). The minimum is sought in the null space of the conditions (Nocedal and Wright, "Numerical
optimization", 16.2) by a Cholesky decomposition.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import lapack

from tpmscad._typing import Array, IntArray

MIN_PIVOT = 1e-8
"""Pivots of hard rows below this fraction of the largest count as zero: of the rows for tangent continuity many follow from
others. A row that is left out so is violated by an angle of about this fraction of a radian."""

BLOCK_SIZE = 32
"""Columns that LAPACK factorises at once where its workspace allows it, as in its own defaults."""


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
        columns = rows[:, :, involved].swapaxes(1, 2)
        n, k, _ = columns.shape
        rank, null_space, inverse = np.zeros(n, np.int64), np.tile(np.eye(k), (n, 1, 1)), np.zeros(columns.shape)
        for each in np.flatnonzero(columns.any(axis=(1, 2))):
            r, basis, inverse[each] = _factorise(columns[each])
            rank[each], null_space[each] = r, 0.0
            null_space[each, :, : k - r] = basis[:, r:]
        return EqualityConstraints(involved, rank, null_space[:, :, : k - rank.min(initial=k)], inverse)

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


def _factorise(columns: Array) -> tuple[int, Array, Array]:
    """Rank, orthonormal basis (k, k) with the range of the columns (k, m) first, and the inverse (k, m) of their transpose."""
    k, m = columns.shape
    factors, order, scales, _, _ = lapack.dgeqp3(columns, lwork=(m + 1) * BLOCK_SIZE + 2 * m)
    pivots = np.abs(factors.diagonal())
    rank = int(np.count_nonzero(pivots > MIN_PIVOT * pivots[0]))
    basis, _, _ = lapack.dormqr("L", "N", factors[:, :rank], scales[:rank], np.eye(k, order="F"), lwork=k * BLOCK_SIZE)
    inverse = np.zeros((k, m))
    inverse[:, order[:rank] - 1] = lapack.dtrtrs(factors[:rank, :rank], basis[:, :rank].T)[0].T
    return rank, basis, inverse


def _solve_each(matrix: Array, right: Array) -> Array:
    """Solutions (n, k) of systems (n, k, k), nan where a matrix is singular."""
    try:
        return np.asarray(np.linalg.solve(matrix, right[..., None])[..., 0])
    except np.linalg.LinAlgError:
        if len(matrix) == 1:
            return np.full(right.shape, np.nan)
        return np.concatenate([_solve_each(matrix[k : k + 1], right[k : k + 1]) for k in range(len(matrix))])
