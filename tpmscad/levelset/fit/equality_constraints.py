"""Quadratic functions minimised under linear conditions, many small problems at once, compiled.

The conditions of a problem are factorised by a QR decomposition of the transposed rows with column pivoting (Golub and Van Loan,
"Matrix computations", 5.4.2; the norms of the remaining columns are updated as in LAPACK's dlaqp2). The minimum is sought in the
null space of the conditions (Nocedal and Wright, "Numerical optimization", 16.2) by a Cholesky decomposition.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad._compiled_loops import njit_cached
from tpmscad._typing import Array, BoolArray, IntArray

MIN_PIVOT = 1e-8
"""Pivots of hard rows below this fraction of the largest count as zero: of the rows for tangent continuity many follow from
others. A row that is left out so is violated by an angle of about this fraction of a radian."""

MIN_NORM_RATIO = 2.0**-26
"""The squared norm of a column that has lost all but this fraction is computed anew: the square root of the machine precision."""


@dataclass(frozen=True, slots=True, eq=False)
class EqualityConstraints:
    """Linear conditions rows @ x = target on the unknowns of n problems, redundant ones among them, by pivoted QR factors.

    `involved` (k,) are the unknowns that the conditions contain. With s = min(k, m) for m conditions, `order` (n, m) holds the
    conditions of each problem as pivoted, of which the first `rank` (n,) count, `triangle` (n, s, m) the upper triangular factor,
    `reflectors` (n, s, k) the Householder vectors, scaled by `scales` (n, s), and `null_space` (n, k, k) in its first k - rank
    columns an orthonormal basis of the changes that keep the conditions.
    """

    involved: IntArray
    order: IntArray
    rank: IntArray
    triangle: Array
    reflectors: Array
    scales: Array
    null_space: Array

    @staticmethod
    def factorise(rows: Array) -> EqualityConstraints:
        """The factors of rows (n, m, unknowns)."""
        rows = np.ascontiguousarray(rows)
        involved = np.flatnonzero(_mark_involved(rows))
        return EqualityConstraints(involved, *_factorise(rows, involved))

    def minimise(self, matrix: Array, rhs: Array, target: Array) -> Array:
        """The solutions (n, unknowns) of rows @ x = target (n, m) that minimise x' matrix x / 2 - rhs' x.

        The matrices (n, unknowns, unknowns) are symmetric and positive definite on the null space.
        """
        is_free = np.ones(matrix.shape[1], bool)
        is_free[self.involved] = False
        factors = self.order, self.rank, self.triangle, self.reflectors, self.scales, self.null_space
        return _minimise(self.involved, np.flatnonzero(is_free), *factors, matrix, rhs, target)


@njit_cached
def add_row_sum(
    vector: Array, scale: float, factors: Array, rows: Array, count: int, left: int, right: int
) -> None:  # pragma: no cover
    """Add `scale` times the sum of the first `count` rows (m, c), each times its factor, to a vector (c,) from `left` to `right`.

    Four rows at a time: the vector is loaded and stored once for all of them. Their slices are known to be contiguous here.
    """
    part = vector[left:right]
    for i in range(0, count - 3, 4):
        row_a, row_b, row_c, row_d = (
            rows[i, left:right],
            rows[i + 1, left:right],
            rows[i + 2, left:right],
            rows[i + 3, left:right],
        )
        a, b = scale * factors[i], scale * factors[i + 1]
        c, d = scale * factors[i + 2], scale * factors[i + 3]
        for x in range(len(part)):
            part[x] += (a * row_a[x] + b * row_b[x]) + (c * row_c[x] + d * row_d[x])
    for i in range(count - count % 4, count):
        row_a, a = rows[i, left:right], scale * factors[i]
        for x in range(len(part)):
            part[x] += a * row_a[x]


@njit_cached
def _mark_involved(rows: Array) -> BoolArray:  # pragma: no cover
    """The unknowns (k,) that rows (n, m, k) contain."""
    n, m, k = rows.shape
    result = np.zeros(k, np.bool_)
    for each in range(n):
        for i in range(m):
            row = rows[each, i]
            for x in range(k):
                result[x] |= row[x] != 0.0
    return result


@njit_cached
def _norm_below(columns: Array, first: int, column: int) -> float:  # pragma: no cover
    """Norm of a column from its row `first` on."""
    square = 0.0
    for i in range(first, len(columns)):
        square += columns[i, column] ** 2
    return float(np.sqrt(square))


@njit_cached
def _reflect(
    columns: Array, vector: Array, scale: float, left: int, right: int, products: Array
) -> None:  # pragma: no cover
    """Reflect columns (k, c) from `left` to `right` by 1 - scale * vector vector', of the first rows that the vector has."""
    count = len(vector)
    products[left:right] = 0.0
    add_row_sum(products, scale, vector, columns, count, left, right)
    part = products[left:right]
    for i in range(0, count - 1, 2):
        row_a, row_b, a, b = columns[i, left:right], columns[i + 1, left:right], vector[i], vector[i + 1]
        for x in range(len(part)):
            row_a[x] -= a * part[x]
            row_b[x] -= b * part[x]
    if count % 2:
        row_a, a = columns[count - 1, left:right], vector[count - 1]
        for x in range(len(part)):
            row_a[x] -= a * part[x]


@njit_cached
def _factorise(
    rows: Array, involved: IntArray
) -> tuple[IntArray, IntArray, Array, Array, Array, Array]:  # pragma: no cover
    """The arrays of `EqualityConstraints` but the first, of rows (n, m, unknowns); the triangular factors are (n, k, m)."""
    n, m, k = len(rows), rows.shape[1], len(involved)
    columns = np.empty((n, k, m))
    order, rank = np.empty((n, m), np.int64), np.empty(n, np.int64)
    reflectors, scales, null_space = np.empty((n, min(k, m), k)), np.empty((n, min(k, m))), np.empty((n, k, k))
    norms, full_norms, products = np.empty(m), np.empty(m), np.empty(max(k, m))
    for each in range(n):
        work, own_order, null = columns[each], order[each], null_space[each]
        for c in range(m):
            for i in range(k):
                work[i, c] = rows[each, c, involved[i]]
            own_order[c] = c
            norms[c] = full_norms[c] = _norm_below(work, 0, c)
        largest, done = 0.0, 0
        while done < min(k, m):
            pivot = done + np.argmax(norms[done:])
            norm = _norm_below(work, done, pivot)
            if norm <= MIN_PIVOT * largest:
                # the updated norms are no more accurate than this: judge by the true ones
                for c in range(done, m):
                    norms[c] = full_norms[c] = _norm_below(work, done, c)
                pivot = done + np.argmax(norms[done:])
                norm = norms[pivot]
            if not norm > MIN_PIVOT * largest:
                break
            largest = max(largest, norm)
            if pivot != done:
                own_order[done], own_order[pivot] = own_order[pivot], own_order[done]
                norms[pivot], full_norms[pivot] = norms[done], full_norms[done]
                for i in range(k):
                    work[i, done], work[i, pivot] = work[i, pivot], work[i, done]
            vector, head = reflectors[each, done, : k - done], work[done, done]
            end = -norm if head > 0.0 else norm
            vector[0] = 1.0
            for i in range(1, k - done):
                vector[i] = work[done + i, done] / (head - end)
            scale = scales[each, done] = (end - head) / end
            work[done, done] = end
            _reflect(work[done:], vector, scale, done + 1, m, products)
            for c in range(done + 1, m):
                if norms[c] != 0.0:
                    left = max(1.0 - (work[done, c] / norms[c]) ** 2, 0.0)
                    if left * (norms[c] / full_norms[c]) ** 2 <= MIN_NORM_RATIO:
                        norms[c] = full_norms[c] = _norm_below(work, done + 1, c)
                    else:
                        norms[c] *= np.sqrt(left)
            done += 1
        rank[each] = done
        null[:] = 0.0
        for i in range(k - done):
            null[done + i, i] = 1.0
        for j in range(done - 1, -1, -1):
            _reflect(null[j:], reflectors[each, j, : k - j], scales[each, j], 0, k - done, products)
    return order, rank, columns, reflectors, scales, null_space


@njit_cached
def _minimise(
    involved: IntArray,
    free: IntArray,
    order: IntArray,
    rank: IntArray,
    triangle: Array,
    reflectors: Array,
    scales: Array,
    null_space: Array,
    matrix: Array,
    rhs: Array,
    target: Array,
) -> Array:  # pragma: no cover
    n, size = rhs.shape
    solution = np.empty(rhs.shape)
    k, m, n_free = len(involved), order.shape[1], len(free)
    all_unknowns = np.concatenate((free, involved))
    start, left, slope, factors = np.empty(k), np.empty(m), np.empty(size), np.empty(k)
    held_rows, bent = np.empty((k, size)), np.empty((k, size))
    reduced = np.empty((size, size + 1))
    for each in range(n):
        own, r, null = matrix[each], rank[each], null_space[each]
        d = k - r
        total = n_free + d
        for j in range(r):
            left[j] = target[each, order[each, j]]
        start[:] = 0.0
        for j in range(r):
            start[j] = left[j] / triangle[each, j, j]
            for i in range(j + 1, r):
                left[i] -= start[j] * triangle[each, j, i]
        for j in range(r - 1, -1, -1):
            vector, product = reflectors[each, j], 0.0
            for i in range(k - j):
                product += vector[i] * start[j + i]
            for i in range(k - j):
                start[j + i] -= scales[each, j] * product * vector[i]

        for i in range(k):
            for f in range(size):
                held_rows[i, f] = own[involved[i], all_unknowns[f]]
        for f in range(size):
            slope[f] = rhs[each, all_unknowns[f]]
        add_row_sum(slope, -1.0, start, held_rows, k, 0, size)
        for e in range(d):
            for i in range(k):
                factors[i] = null[i, e]
            bent[e] = 0.0
            add_row_sum(bent[e], 1.0, factors, held_rows, k, 0, size)

        for f in range(n_free):
            for g in range(f, n_free):
                reduced[f, g] = own[free[f], free[g]]
            for e in range(d):
                reduced[f, n_free + e] = bent[e, f]
            reduced[f, total] = slope[f]
        for e in range(d):
            row = reduced[n_free + e]
            row[n_free : total + 1] = 0.0
            add_row_sum(row[n_free:], 1.0, bent[e, n_free:], null, k, 0, d)
            for i in range(k):
                row[total] += null[i, e] * slope[n_free + i]
        _solve_by_cholesky(reduced, total)
        for f in range(n_free):
            solution[each, free[f]] = reduced[f, total]
        for i in range(k):
            moved = start[i]
            for e in range(d):
                moved += null[i, e] * reduced[n_free + e, total]
            solution[each, involved[i]] = moved
    return solution


@njit_cached
def _solve_by_cholesky(system: Array, n: int) -> None:  # pragma: no cover
    """Solve a symmetric system of n unknowns, upper triangle given, in place of its right-hand side, the column n.

    Where the matrix is not positive definite the solution is not finite.
    """
    factors = np.empty(n)
    for i in range(n):
        for j in range(i):
            factors[j] = system[j, i]
        add_row_sum(system[i], -1.0, factors, system, i, i, n + 1)
        pivot = np.sqrt(system[i, i])
        for j in range(i, n + 1):
            system[i, j] /= pivot
    for i in range(n - 1, -1, -1):
        value = system[i, n]
        for j in range(i + 1, n):
            value -= system[i, j] * system[j, n]
        system[i, n] = value / system[i, i]
