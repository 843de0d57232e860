"""Trivariate tensor-product splines with their gradients, evaluated in one pass over the points.

With the degree + 1 non-zero basis functions X_i, Y_j, Z_k of each direction at a point,

    f = sum_ijk c_ijk X_i Y_j Z_k,      f_x = sum_ijk c_ijk X'_i Y_j Z_k,   ...

The sums are contracted along z first, then y, then x, and value and gradient share the partial sums. SciPy's NdBSpline evaluates
one order of derivative at a time and is constructed anew for each.
"""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from tpmscad._typing import Array
from tpmscad.splines.basis import nonzero_basis

POINTS_PER_CHUNK = 16384
"""Points evaluated at once: their 64 coefficients each (cubic) take 8 MB."""

Knots = tuple[Array, Array, Array]


def evaluate_tensor_product(
    coefficients: Array, knots: Knots, degree: tuple[int, int, int], points: Array
) -> tuple[Array, Array]:
    """Values (n,) and gradients (n, 3) at points (n, 3) of the domain, from coefficients (U, V, W)."""
    windows = sliding_window_view(coefficients, tuple(p + 1 for p in degree))
    value, gradient = np.empty(len(points)), np.empty((len(points), 3))
    for start in range(0, len(points), POINTS_PER_CHUNK):
        chunk = slice(start, start + POINTS_PER_CHUNK)
        bases = [nonzero_basis(knots[axis], degree[axis], points[chunk, axis]) for axis in range(3)]
        block = windows[tuple(first for first, _, _ in bases)]
        (_, x, dx), (_, y, dy), (_, z, dz) = bases
        sum_z, slope_z = (np.einsum("nijk,nk->nij", block, row) for row in (z, dz))
        sum_yz = np.einsum("nij,nj->ni", sum_z, y)
        value[chunk] = np.einsum("ni,ni->n", sum_yz, x)
        gradient[chunk, 0] = np.einsum("ni,ni->n", sum_yz, dx)
        gradient[chunk, 1] = np.einsum("ni,ni->n", np.einsum("nij,nj->ni", sum_z, dy), x)
        gradient[chunk, 2] = np.einsum("ni,ni->n", np.einsum("nij,nj->ni", slope_z, y), x)
    return value, gradient
