"""Batched least squares for the poles of curves and patches on a level set, with direction-dependent weights.

Residuals count fully along the normal of the level set and with a small weight along it, where the place of a point hardly
matters (tangent-distance minimisation; Wang, Pottmann and Liu, "Fitting B-spline curves to point clouds by curvature-based
squared distance minimization", 2006). Each residual then couples the three coordinates by a 3 x 3 metric, so the unknowns are
solved together.
"""

from __future__ import annotations

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
