"""Bezier curves and patches on [0, 1] from their poles."""

from __future__ import annotations

from functools import lru_cache
from math import comb

import numpy as np

from tpmscad._typing import Array
from tpmscad.splines.bspline import design_matrix


def bernstein_basis(degree: int, t: Array, order: int = 0) -> Array:
    """Bernstein polynomials of the degree on [0, 1], or derivatives, at t: (n, degree + 1)."""
    return design_matrix(np.repeat([0.0, 1.0], degree + 1), degree, t, order)


def evaluate_patches(rows: Array, poles: Array, columns: Array) -> Array:
    """Points on the grid of two designs, flattened u first: (n, len(rows) * len(columns), 3)."""
    n, nu, nv, _ = poles.shape
    half = (rows @ poles.reshape(n, nu, nv * 3)).reshape(n, len(rows), nv, 3)
    return (columns @ half).reshape(n, -1, 3)


@lru_cache(maxsize=256)
def side_pole_matrix(low: int, high: int, piece: int, sense: int) -> Array | None:
    """From a curve's poles to those of a piece of it, of a higher degree, run forwards or backwards; None: the same."""
    if low == high and piece == 0 and sense > 0:
        return None
    matrix = np.eye(low + 1)
    if piece:
        halves = [[comb(i, j) * 0.5**i if j <= i else 0.0 for j in range(low + 1)] for i in range(low + 1)]
        matrix = np.array(halves)
        if piece == 2:
            matrix = matrix[::-1, ::-1]
    raised = np.array(
        [
            [comb(low, j) * comb(high - low, i - j) / comb(high, i) if 0 <= i - j <= high - low else 0.0
             for j in range(low + 1)]
            for i in range(high + 1)
        ]
    )  # fmt: skip
    matrix = raised @ matrix
    return matrix if sense > 0 else matrix[::-1]
