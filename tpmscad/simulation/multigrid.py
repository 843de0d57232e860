"""Conjugate gradients for second-order elements, preconditioned by two levels: the coarse one has first-order elements.

The coarse matrix is factorised. The smoother is a Chebyshev polynomial of the matrix scaled by its diagonal.
Sources: Rønquist and Patera, J. Sci. Comput. 2 (1987) 389 (levels of order); Adams, Brezina, Hu and Tuminaro, J. Comput. Phys.
188 (2003) 593 (the smoother).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from tpmscad._typing import Array
from tpmscad.errors import KernelError

TOLERANCE = 1e-8
"""Residual over the scale of the loads at which the iteration ends; the error of the energy is of its square."""

MAX_ITERATIONS = 500

SMOOTHING_DEGREE = 3
"""Degree of the Chebyshev smoother."""

SMOOTHED_FRACTION = 0.1
"""The smoother damps eigenvalues above this fraction of the greatest; the coarse level takes the others."""

POWER_ITERATIONS = 15
EIGENVALUE_MARGIN = 1.1
"""Steps of the power iteration for the greatest eigenvalue, and the factor by which its estimate is raised."""

COARSE_SHIFT = 1e-10
"""Of the mean diagonal, added to the coarse matrix, whose rigid translations have no energy."""


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """Solutions (n, k) of k systems, and the iterations they took."""

    values: Array
    iterations: int


def solve(matrix: Any, loads: Array, prolongation: Any, scale: float) -> Solution:
    """Solve A x = b for each column of `loads` (n, k), with A symmetric, positive but for translations.

    `prolongation` (n, m) takes values on corners to all nodes; `scale` is the norm of loads that count, as loads that balance
    each other leave round-off. Raises KernelError without convergence.
    """
    precondition = _two_levels(matrix, prolongation)
    x = np.zeros_like(loads)
    residual = loads.copy()
    goal = TOLERANCE * scale
    direction = z = precondition(residual)
    product = np.einsum("ij,ij->j", residual, z)
    for iteration in range(1, MAX_ITERATIONS + 1):
        image = matrix @ direction
        curvature = np.einsum("ij,ij->j", direction, image)
        step = np.divide(product, curvature, out=np.zeros_like(product), where=curvature > 0)
        x += step * direction
        residual -= step * image
        if (np.linalg.norm(residual, axis=0) <= goal).all():
            return Solution(x, iteration)
        z = precondition(residual)
        former, product = product, np.einsum("ij,ij->j", residual, z)
        ratio = np.divide(product, former, out=np.zeros_like(product), where=former > 0)
        direction = z + ratio * direction
    worst = float(np.linalg.norm(residual, axis=0).max()) / scale
    raise KernelError("solve", f"residual {worst:.1e} after {MAX_ITERATIONS} iterations: use a mesh of better elements")


def _two_levels(matrix: Any, prolongation: Any) -> Callable[[Array], Array]:
    """The symmetric preconditioner: smooth, correct on the coarse level, smooth."""
    coarse = (prolongation.T @ matrix @ prolongation).tocsc()
    shift = COARSE_SHIFT * coarse.diagonal().mean()
    factors = splu(
        coarse + shift * sparse.identity(coarse.shape[0], format="csc"),
        permc_spec="MMD_AT_PLUS_A",
        options={"SymmetricMode": True},
        diag_pivot_thresh=0.0,
    )
    smooth = _chebyshev(matrix)

    def precondition(residual: Array) -> Array:
        x = smooth(residual)
        x = x + prolongation @ factors.solve(prolongation.T @ (residual - matrix @ x))
        return x + smooth(residual - matrix @ x)

    return precondition


def _chebyshev(matrix: Any) -> Callable[[Array], Array]:
    """A polynomial of the scaled matrix that approximates its inverse on the upper part of the spectrum."""
    inverse = 1.0 / matrix.diagonal()
    vector = np.random.default_rng(0).standard_normal(matrix.shape[0])
    for _ in range(POWER_ITERATIONS):
        vector = inverse * (matrix @ vector)
        greatest = float(np.linalg.norm(vector))
        vector /= greatest
    upper = EIGENVALUE_MARGIN * greatest
    lower = SMOOTHED_FRACTION * upper
    middle, half = 0.5 * (upper + lower), 0.5 * (upper - lower)

    def smooth(residual: Array) -> Array:
        scaled = inverse[:, None]
        step = scaled * residual / middle
        x = step
        ratio = half / middle
        for _ in range(SMOOTHING_DEGREE - 1):
            following = 1.0 / (2.0 * middle / half - ratio)
            step = following * ratio * step + (2.0 * following / half) * (scaled * (residual - matrix @ x))
            x, ratio = x + step, following
        return x

    return smooth
