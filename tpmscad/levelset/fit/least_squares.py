"""Least squares for many small sets of poles at once, in which directions count differently from row to row."""

from __future__ import annotations

import numpy as np

from tpmscad._typing import Array, BoolArray
from tpmscad.fields.field import Field
from tpmscad.levelset.quadmesh.smoothing import project_to_level_set
from tpmscad.levelset.quadmesh.vectors import normalize

TANGENTIAL_WEIGHT = 0.3
FIT_PASSES = 2


class NormalEquations:
    """Normal equations of many small least squares for poles (n, unknowns, 3), rows with a common basis and own directions."""

    def __init__(self, unknowns: int, count: int) -> None:
        self.matrix = np.zeros((count, 3, 3, unknowns, unknowns))
        self.right = np.zeros((count, unknowns, 3))

    def near(self, basis: Array, normal: Array, target: Array, slide: float) -> None:
        """basis (m, unknowns) times poles near the target (n, m, 3): weight 1 along the normal, `slide` across."""
        metric = (1 - slide**2) * normal[..., :, None] * normal[..., None, :] + slide**2 * np.eye(3)
        self._add(basis, metric, np.einsum("nmij,nmj->nmi", metric, target), 1.0)

    def along(self, basis: Array, normal: Array, target: Array, weight: float) -> None:
        """The component along the normal only, with that weight."""
        metric = normal[..., :, None] * normal[..., None, :]
        self._add(basis, metric, np.einsum("nmij,nmj->nmi", metric, target), weight)

    def _add(self, basis: Array, metric: Array, pulled: Array, weight: float) -> None:
        m, k = basis.shape
        products = (basis[:, :, None] * basis[:, None, :]).reshape(m, k * k) * weight**2
        count = len(self.matrix)
        for i in range(3):
            for j in range(i, 3):
                block = (metric[..., i, j].reshape(count, m) @ products).reshape(count, k, k)
                self.matrix[:, i, j] += block
                if i != j:
                    self.matrix[:, j, i] += block
        self.right += weight**2 * (basis.T @ pulled)

    def solved(self) -> Array:
        count, _, _, k, _ = self.matrix.shape
        full = self.matrix.transpose(0, 1, 3, 2, 4).reshape(count, 3 * k, 3 * k)
        right = self.right.transpose(0, 2, 1).reshape(count, 3 * k, 1)
        return np.asarray(np.linalg.solve(full, right).reshape(count, 3, k).transpose(0, 2, 1), float)


def project_curves_to_level_set(field: Field, points: Array, fixed: BoolArray, reach: Array) -> Array:
    """Points (n, m, 3) on the level set; rows of `fixed` (n, 3) and `reach` (n,) hold for m points each."""
    m = points.shape[1]
    flat = project_to_level_set(field, points.reshape(-1, 3), np.repeat(fixed, m, axis=0), np.repeat(reach, m), 8)
    return flat.reshape(points.shape)


def unit_normals(field: Field, points: Array, fixed: BoolArray | None = None) -> Array:
    """Unit normals at points (n, m, 3); those of the level set's section where coordinates (n, 3) are fixed."""
    slope = field.gradient(points)
    if fixed is not None:
        slope = np.where(fixed[:, None], 0.0, slope)
    return normalize(slope)
