"""Batched least squares for the poles of curves and patches on a level set, with direction-dependent weights.

Residuals count fully along the normal of the level set and with a small weight along it, where the place of a point hardly
matters (tangent-distance minimisation; Wang, Pottmann and Liu, "Fitting B-spline curves to point clouds by curvature-based
squared distance minimization", 2006). Each residual then couples the three coordinates by a 3 x 3 metric, so the unknowns are
solved together.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, BoolArray
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


MIN_SINGULAR_VALUE = 1e-8
"""Singular values of hard rows below this fraction of the largest count as zero: of the rows for tangent continuity many follow
from others. A row that is left out so is violated by an angle of about this fraction of a radian."""


@dataclass(frozen=True, slots=True, eq=False)
class HardRows:
    """Linear conditions rows @ x = target on the unknowns of n problems, redundant ones among them, by their singular values.

    `inverse` (n, unknowns, m) is the pseudo-inverse of the rows, `row_space` (n, r, unknowns) an orthonormal basis of the space
    that they span, with zero rows where that has fewer dimensions.
    """

    inverse: Array
    row_space: Array

    @staticmethod
    def factorise(rows: Array) -> HardRows:
        """The factors of rows (n, m, unknowns)."""
        left, values, right = np.linalg.svd(rows, full_matrices=False)
        kept = values > MIN_SINGULAR_VALUE * values[:, :1]
        factor = np.where(kept, 1.0 / np.where(kept, values, 1.0), 0.0)
        right = right * kept[..., None]
        return HardRows((np.swapaxes(right, 1, 2) * factor[:, None]) @ np.swapaxes(left, 1, 2), right)

    def minimise(self, matrix: Array, rhs: Array, target: Array) -> Array:
        """The solutions (n, unknowns) of rows @ x = target (n, m) that minimise x' matrix x / 2 - rhs' x."""
        start = self.inverse @ target[..., None]
        across = np.swapaxes(self.row_space, 1, 2) @ self.row_space
        free = np.eye(matrix.shape[-1]) - across
        size = np.trace(matrix, axis1=1, axis2=2)[:, None, None] / matrix.shape[-1]
        step = np.linalg.solve(free @ matrix @ free + size * across, free @ (rhs[..., None] - matrix @ start))
        return np.asarray((start + free @ step)[..., 0], float)


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
