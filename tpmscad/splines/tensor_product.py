"""Tensor-product splines of x, y, z with their slopes, in one pass over the points.

SciPy's NdBSpline answers for one order of derivative at a time and builds itself anew for each: of a figure's solid it took 46 %
of the seconds.
"""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from tpmscad._typing import Array, IntArray

POINTS_PER_CHUNK = 16384
"""Points to a piece: their coefficients, 64 each, stay within 8 MB."""

Knots = tuple[Array, Array, Array]


def evaluate_tensor_product(
    coefficients: Array, knots: Knots, degree: tuple[int, int, int], points: Array
) -> tuple[Array, Array]:
    """The spline of coefficients (nu, nv, nw) and its gradient at points (n, 3) within its domain: (n,), (n, 3)."""
    near = sliding_window_view(coefficients, tuple(p + 1 for p in degree))
    value, slope = np.empty(len(points)), np.empty((len(points), 3))
    for start in range(0, len(points), POINTS_PER_CHUNK):
        piece = slice(start, start + POINTS_PER_CHUNK)
        found = [evaluate_nonzero_basis(knots[axis], degree[axis], points[piece, axis]) for axis in range(3)]
        block = near[tuple(first for first, _, _ in found)]
        (_, x, dx), (_, y, dy), (_, z, dz) = found
        of_z, along_z = (np.einsum("nijk,nk->nij", block, row) for row in (z, dz))
        of_yz = np.einsum("nij,nj->ni", of_z, y)
        value[piece] = np.einsum("ni,ni->n", of_yz, x)
        slope[piece, 0] = np.einsum("ni,ni->n", of_yz, dx)
        slope[piece, 1] = np.einsum("ni,ni->n", np.einsum("nij,nj->ni", of_z, dy), x)
        slope[piece, 2] = np.einsum("ni,ni->n", np.einsum("nij,nj->ni", along_z, y), x)
    return value, slope


def evaluate_nonzero_basis(knots: Array, degree: int, t: Array) -> tuple[IntArray, Array, Array]:
    """The first of the degree + 1 basis functions that live at each t (n,), their values and slopes there: (n, degree + 1) each.

    By the recursion of Cox and de Boor; at a knot the span above it counts, at the domain's end the last.
    """
    last = len(knots) - degree - 2
    span = np.clip(np.searchsorted(knots, t, side="right") - 1, degree, last)
    upper = [knots[span + j] - t for j in range(1, degree + 1)]
    lower = [t - knots[span + 1 - j] for j in range(1, degree + 1)]
    values = [np.ones(len(t))]
    parts: list[Array] = []
    for j in range(1, degree + 1):
        parts = [values[r] / (upper[r] + lower[j - 1 - r]) for r in range(j)]
        rising = [np.zeros(len(t))] + [lower[j - 1 - r] * parts[r] for r in range(j)]
        falling = [upper[r] * parts[r] for r in range(j)] + [np.zeros(len(t))]
        values = [a + b for a, b in zip(rising, falling, strict=True)]
    none = np.zeros(len(t))
    slopes = [degree * (a - b) for a, b in zip([none, *parts], [*parts, none], strict=True)]
    return span - degree, np.stack(values, axis=-1), np.stack(slopes, axis=-1)
