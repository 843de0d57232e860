"""Batched normal equations for the poles of curves and patches on a level set, with direction-dependent weights.

Residuals count fully along the normal of the level set and with a small weight along it, where the place of a point hardly
matters (tangent-distance minimisation; Wang, Pottmann and Liu, "Fitting B-spline curves to point clouds by curvature-based
squared distance minimization", 2006). Each residual then couples the three coordinates by a 3 x 3 metric, so the unknowns are
solved together. The basis is a tensor product, whose sums are formed one parameter after the other.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.levelset.fit.equality_constraints import EqualityConstraints

_ROW, _COLUMN = np.tril_indices(3)
"""Rows and columns of the six entries of a symmetric metric."""

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
        """Add the rows of points; the metric of a residual is less I + (full - less) n n', with the squares of the weights."""
        (rows, columns), full, less = basis, weight**2, tangential_weight**2
        (m, k), (w, l) = rows.shape, columns.shape  # noqa: E741
        pairs_u, pairs_v = _products_of_pairs(rows), _products_of_pairs(columns)
        entry = _spread_pairs(k, l, pairs_v.shape[1])
        n, t = (each.reshape(-1, m, w, 3) for each in (normal, target))
        metric = (full - less) * n[..., _ROW] * n[..., _COLUMN] + less * (_ROW == _COLUMN)
        sums = _sum_products(metric, pairs_u, pairs_v)
        self.matrix += np.take(sums.reshape(len(n), -1), entry, axis=1)
        weighted = less * t + (full - less) * (n * t).sum(axis=-1, keepdims=True) * n
        self.rhs += _sum_products(weighted, rows, columns).transpose(0, 1, 3, 2).reshape(len(n), -1)


def _products_of_pairs(basis: Array) -> Array:
    """Products (m, k (k + 1) / 2) of basis functions i >= j, at the column i (i + 1) / 2 + j."""
    i, j = np.tril_indices(basis.shape[1])
    return np.asarray(basis[:, i] * basis[:, j])


def _sum_products(values: Array, along_u: Array, along_v: Array) -> Array:
    """Sums (n, p, e, q) over points (a, b) of along_u (a, p) times values (n, a, b, e) times along_v (b, q)."""
    n, m, _, e = values.shape
    over_v = values.swapaxes(2, 3) @ along_v
    return (along_u.T @ over_v.reshape(n, m, -1)).reshape(n, -1, e, along_v.shape[1])


@lru_cache(maxsize=16)
def _spread_pairs(k: int, l: int, n_pairs: int) -> IntArray:  # noqa: E741
    """Places of the elements of a matrix (3 k l, 3 k l) among the sums of pairs along u, entries and pairs along v."""

    def number(count: int) -> IntArray:
        i, j = np.indices((count, count))
        return np.maximum(i, j) * (np.maximum(i, j) + 1) // 2 + np.minimum(i, j)

    u, v, x = number(k)[:, None, None, :, None, None], number(l)[:, None, None, :, None], number(3)[:, None, None, :]
    return ((u * 6 + x) * n_pairs + v).reshape(3 * k * l, 3 * k * l)
