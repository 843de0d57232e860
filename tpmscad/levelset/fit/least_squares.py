"""Batched least squares for the poles of curves and patches on a level set, with direction-dependent weights.

Residuals count fully along the normal of the level set and with a small weight along it, where the place of a point hardly
matters (tangent-distance minimisation; Wang, Pottmann and Liu, "Fitting B-spline curves to point clouds by curvature-based
squared distance minimization", 2006). Each residual then couples the three coordinates by a 3 x 3 metric, so the unknowns are
solved together.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dgeqp3, dorgqr, dtrtrs

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.fields.field import Field
from tpmscad.levelset.quadmesh.smoothing import project_to_level_set
from tpmscad.levelset.quadmesh.vectors import normalize

TANGENTIAL_WEIGHT = 0.3
"""Weight of residuals along the level set; those along its normal have the weight 1."""

FIT_PASSES = 2
"""Alternations of projecting points of a curve or patch onto the level set and fitting to the projections."""

MAX_STEP_OF_CHORD = 0.3
"""Largest Newton step towards the level set, as a fraction of a curve's chord or a patch's diagonal."""

PROJECTION_STEPS = 8
"""Newton steps towards the level set."""


FAIRNESS_WEIGHT = 3e-3
"""Weight of the second differences of poles. Where the level set turns by 90 degrees within a part of a curve, curves of degree 9
would have control polygons several times as long as they are, normals that swing as much, and patches that fold beside them."""

MIN_PIVOT = 1e-8
"""Pivots of hard rows below this fraction of the largest count as zero: of the rows for tangent continuity many follow from
others. A row that is left out so is violated by an angle of about this fraction of a radian."""


@dataclass(frozen=True, slots=True, eq=False)
class HardRows:
    """Linear conditions rows @ x = target on the unknowns of n problems, redundant ones among them, by pivoted QR factors.

    `involved` (k,) are the unknowns that the conditions contain, `inverse` (n, k, m) gives values of these that satisfy them, and
    `null_space` (n, k, d) an orthonormal basis of the changes that keep them, with zero columns where it has fewer dimensions.
    """

    involved: IntArray
    inverse: Array
    null_space: Array

    @staticmethod
    def factorise(rows: Array) -> HardRows:
        """The factors of rows (n, m, unknowns)."""
        involved = np.flatnonzero((rows != 0).any(axis=(0, 1)))
        count, m, k = len(rows), rows.shape[1], len(involved)
        inverse, null_space = np.zeros((count, k, m)), np.zeros((count, k, k))
        largest = 0
        for i, each in enumerate(rows[:, :, involved] if k else []):  # LAPACK complains of matrices without entries
            factors, order, scalars, _, _ = dgeqp3(each.T)
            diagonal = np.abs(np.diagonal(factors))
            rank = int(np.count_nonzero(diagonal > MIN_PIVOT * diagonal.max(initial=0.0)))
            square = np.zeros((k, k), order="F")
            square[:, : min(m, k)] = factors[:, :k]
            orthogonal, _, _ = dorgqr(square, scalars)
            if rank:  # a curve that is held to the normal's axis has no conditions
                solved, _ = dtrtrs(factors[:rank, :rank], orthogonal[:, :rank].T)
                inverse[i][:, order[:rank] - 1] = solved.T
            null_space[i, :, : k - rank] = orthogonal[:, rank:]
            largest = max(largest, k - rank)
        return HardRows(involved, inverse, null_space[:, :, :largest])

    def minimise(self, matrix: Array, rhs: Array, target: Array) -> Array:
        """The solutions (n, unknowns) of rows @ x = target (n, m) that minimise x' matrix x / 2 - rhs' x."""
        involved, null = self.involved, self.null_space
        free = np.setdiff1d(np.arange(matrix.shape[-1]), involved)
        start = (self.inverse @ target[..., None])[..., 0]
        slope = rhs - (matrix[:, :, involved] @ start[..., None])[..., 0]
        reduced = np.empty((len(matrix), len(free) + null.shape[2], len(free) + null.shape[2]))
        end = len(free)
        reduced[:, :end, :end] = matrix[:, free[:, None], free]
        reduced[:, :end, end:] = matrix[:, free[:, None], involved] @ null
        reduced[:, end:, :end] = np.swapaxes(reduced[:, :end, end:], 1, 2)
        reduced[:, end:, end:] = np.swapaxes(null, 1, 2) @ matrix[:, involved[:, None], involved] @ null
        missing, column = np.nonzero(~null.any(axis=1))
        reduced[missing, end + column, end + column] = 1.0
        right = np.concatenate([slope[:, free], (slope[:, None, involved] @ null)[:, 0]], axis=1)
        step = np.linalg.solve(reduced, right[..., None])
        solution = np.empty(rhs.shape)
        solution[:, free] = step[:, :end, 0]
        solution[:, involved] = start + (null @ step[:, end:])[..., 0]
        return solution


class NormalEquations:
    """Normal equations of `count` least-squares problems for poles (n, unknowns, 3), with a common basis and own directions."""

    def __init__(self, unknowns: int, count: int) -> None:
        self.matrix = np.zeros((count, 3, 3, unknowns, unknowns))
        self.rhs = np.zeros((count, unknowns, 3))

    def add_point_rows(self, basis: Array, normal: Array, target: Array, tangential_weight: float) -> None:
        """Ask basis (m, unknowns) times poles to be `target` (n, m, 3): weight 1 along the normal, less across it."""
        metric = (1 - tangential_weight**2) * normal[..., :, None] * normal[
            ..., None, :
        ] + tangential_weight**2 * np.eye(3)
        self._add(basis, metric, np.einsum("nmij,nmj->nmi", metric, target), 1.0)

    def add_normal_rows(self, basis: Array, normal: Array, target: Array, weight: float) -> None:
        """Ask the components along the normals (n, m, 3) of basis (m, unknowns) times poles to be those of `target`."""
        metric = normal[..., :, None] * normal[..., None, :]
        self._add(basis, metric, np.einsum("nmij,nmj->nmi", metric, target), weight)

    def add_fairness_rows(self, rows: Array, value: Array, weight: float) -> None:
        """Ask rows (m, unknowns) times poles to cancel `value` (n, m, 3), alike in all directions."""
        for axis in range(3):
            self.matrix[:, axis, axis] += weight**2 * (rows.T @ rows)
        self.rhs -= weight**2 * (rows.T @ value)

    def solve(self) -> Array:
        """Poles (n, unknowns, 3) that minimise the sum of squares."""
        count, _, _, k, _ = self.matrix.shape
        full = self.matrix.transpose(0, 1, 3, 2, 4).reshape(count, 3 * k, 3 * k)
        rhs = self.rhs.transpose(0, 2, 1).reshape(count, 3 * k, 1)
        return np.asarray(np.linalg.solve(full, rhs).reshape(count, 3, k).transpose(0, 2, 1), float)

    def solve_subject_to(self, conditions: HardRows, target: Array) -> Array:
        """Poles (n, unknowns, 3) that minimise the sum of squares and meet conditions on the unknowns, pole by pole."""
        count, _, _, k, _ = self.matrix.shape
        full = self.matrix.transpose(0, 3, 1, 4, 2).reshape(count, 3 * k, 3 * k)
        return conditions.minimise(full, self.rhs.reshape(count, 3 * k), target).reshape(count, k, 3)

    def _add(self, basis: Array, metric: Array, weighted_target: Array, weight: float) -> None:
        m, k = basis.shape
        products = (basis[:, :, None] * basis[:, None, :]).reshape(m, k * k) * weight**2
        count = len(self.matrix)
        for i in range(3):
            for j in range(i, 3):
                block = (metric[..., i, j].reshape(count, m) @ products).reshape(count, k, k)
                self.matrix[:, i, j] += block
                if i != j:
                    self.matrix[:, j, i] += block
        self.rhs += weight**2 * (basis.T @ weighted_target)


def project_curves_to_level_set(field: Field, points: Array, fixed: BoolArray, max_step: Array) -> Array:
    """Points (n, m, 3) projected onto the level set; `fixed` (n, 3) and `max_step` (n,) hold for m points each."""
    m = points.shape[1]
    flat, fixed, max_step = points.reshape(-1, 3), np.repeat(fixed, m, axis=0), np.repeat(max_step, m)
    return project_to_level_set(field, flat, fixed, max_step, PROJECTION_STEPS).reshape(points.shape)


def unit_normals(field: Field, points: Array, fixed: BoolArray | None = None) -> Array:
    """Unit normals of the level set at points (n, m, 3), or of its section by the box where coordinates (n, 3) are fixed."""
    gradient = field.gradient(points)
    if fixed is not None:
        gradient = np.where(fixed[:, None], 0.0, gradient)
    return normalize(gradient)
