"""Batched normal equations for the poles of curves and patches on a level set, with direction-dependent weights, compiled.

Residuals count fully along the normal of the level set and with a small weight along it, where the place of a point hardly
matters (tangent-distance minimisation; Wang, Pottmann and Liu, "Fitting B-spline curves to point clouds by curvature-based
squared distance minimization", 2006). Each residual then couples the three coordinates by a 3 x 3 metric, so the unknowns are
solved together. The basis is a tensor product, whose sums are formed one parameter after the other.
"""

from __future__ import annotations

import numpy as np

from tpmscad._compiled_loops import njit_cached
from tpmscad._typing import Array, IntArray
from tpmscad.levelset.fit.equality_constraints import EqualityConstraints, add_row_sum

Basis = tuple[Array, Array]
"""Values of the basis functions in u, (a, k), and in v, (b, l): together k l functions at a b points, u first."""


def curve_basis(values: Array) -> Basis:
    """The basis of curves with values (m, k), as a tensor product with the constant 1, first as the inner loops are along v."""
    return np.ones((1, 1)), values


class NormalEquations:
    """Normal equations of `count` least-squares problems for poles (n, unknowns, 3), with a common basis and own directions.

    `matrix` (n, 3 unknowns, 3 unknowns) and `rhs` (n, 3 unknowns) run pole by pole.
    """

    def __init__(self, unknowns: int, count: int) -> None:
        self.matrix = np.zeros((count, 3 * unknowns, 3 * unknowns))
        self.rhs = np.zeros((count, 3 * unknowns))

    def add_point_rows(self, basis: Basis, normal: Array, target: Array, tangential_weight: float) -> None:
        """Ask the basis times poles to be `target` (n, m, 3): weight 1 along the normal, less across it."""
        self._add(basis, normal, target, 1.0, tangential_weight)

    def add_normal_rows(self, basis: Basis, normal: Array, target: Array, weight: float) -> None:
        """Ask the components along the normals (n, m, 3) of the basis times poles to be those of `target`."""
        self._add(basis, normal, target, weight, 0.0)

    def add_energy(self, energy: Array, unknown: IntArray, poles: Array, weight: float) -> None:
        """Add a quadratic energy (m, m) of all poles (n, m, 3), of which the numbers `unknown` are corrected."""
        rows = weight**2 * energy[unknown]
        for axis in range(3):
            self.matrix[:, axis::3, axis::3] += rows[:, unknown]
        self.rhs -= (rows @ poles).reshape(self.rhs.shape)

    def solve_subject_to(self, conditions: EqualityConstraints, target: Array) -> Array:
        """Poles (n, unknowns, 3) that minimise the sum of squares and meet conditions on the unknowns, pole by pole."""
        return conditions.minimise(self.matrix, self.rhs, target).reshape(len(self.rhs), -1, 3)

    def _add(self, basis: Basis, normal: Array, target: Array, weight: float, tangential_weight: float) -> None:
        rows, columns = (np.ascontiguousarray(each) for each in basis)
        _add_rows(rows, columns, normal, target, weight**2, tangential_weight**2, self.matrix, self.rhs)


@njit_cached
def _products_of_pairs(basis: Array) -> Array:  # pragma: no cover
    """Products (m, k (k + 1) / 2) of basis functions i >= j, at the column i (i + 1) / 2 + j."""
    m, k = basis.shape
    products = np.empty((m, k * (k + 1) // 2))
    for a in range(m):
        for i in range(k):
            for j in range(i + 1):
                products[a, i * (i + 1) // 2 + j] = basis[a, i] * basis[a, j]
    return products


@njit_cached
def _add_rows(
    rows: Array, columns: Array, normal: Array, target: Array, full: float, less: float, matrix: Array, rhs: Array
) -> None:  # pragma: no cover
    """Add the rows of points to the normal equations; the metric of a residual is less I + (full - less) n n'."""
    (m, k), (w, l) = rows.shape, columns.shape  # noqa: E741
    pairs_u, pairs_v = _products_of_pairs(rows), _products_of_pairs(columns)
    n_pairs = pairs_v.shape[1]
    metric, weighted, factors = np.empty((6, w)), np.empty((3, w)), np.empty(m)
    # sums over the points along v, then over those along u, of the products of pairs with the six entries of the metric
    along_v, along_u = np.empty((m, 6 * n_pairs)), np.empty(6 * n_pairs)
    targets_v, targets_u = np.empty((m, 3 * l)), np.empty(3 * l)
    for each in range(len(matrix)):
        along_v[:] = 0.0
        targets_v[:] = 0.0
        for a in range(m):
            for b in range(w):
                n, t = normal[each, a * w + b], target[each, a * w + b]
                component = n[0] * t[0] + n[1] * t[1] + n[2] * t[2]
                for x in range(3):
                    weighted[x, b] = less * t[x] + (full - less) * component * n[x]
                    for y in range(x + 1):
                        metric[x * (x + 1) // 2 + y, b] = (full - less) * n[x] * n[y] + (less if x == y else 0.0)
            for e in range(6):
                add_row_sum(along_v[a, e * n_pairs :], 1.0, metric[e], pairs_v, w, 0, n_pairs)
            for x in range(3):
                add_row_sum(targets_v[a, x * l :], 1.0, weighted[x], columns, w, 0, l)
        for i in range(k):
            for a in range(m):
                factors[a] = rows[a, i]
            targets_u[:] = 0.0
            add_row_sum(targets_u, 1.0, factors, targets_v, m, 0, 3 * l)
            for j in range(l):
                for x in range(3):
                    rhs[each, 3 * (i * l + j) + x] += targets_u[x * l + j]
            for other in range(i + 1):
                for a in range(m):
                    factors[a] = pairs_u[a, i * (i + 1) // 2 + other]
                along_u[:] = 0.0
                add_row_sum(along_u, 1.0, factors, along_v, m, 0, 6 * n_pairs)
                _add_block(along_u, n_pairs, l, matrix[each], 3 * i * l, 3 * other * l)


@njit_cached
def _add_block(sums: Array, n_pairs: int, count: int, matrix: Array, row: int, column: int) -> None:  # pragma: no cover
    """Add the sums (6 n_pairs,) to the block (3 count, 3 count) of a symmetric matrix at `row`, `column`, and to its mirror."""
    for i in range(count):
        for j in range(count):
            pair = i * (i + 1) // 2 + j if i >= j else j * (j + 1) // 2 + i
            for x in range(3):
                for y in range(3):
                    entry = x * (x + 1) // 2 + y if x >= y else y * (y + 1) // 2 + x
                    value = sums[entry * n_pairs + pair]
                    matrix[row + 3 * i + x, column + 3 * j + y] += value
                    if row != column:
                        matrix[column + 3 * j + y, row + 3 * i + x] += value
