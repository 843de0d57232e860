"""Interpolation and evaluation of many spline curves with equal numbers of poles, each with its own sites, at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.splines.basis import nonzero_basis_of_spans
from tpmscad.splines.curve_batch import evaluate_rows


@dataclass(frozen=True, slots=True, eq=False)
class AlikeCurves:
    """M curves of N poles in D dimensions: `knots` (M, N + degree + 1), `poles` (M, N, D)."""

    knots: Array
    poles: Array
    degree: int

    def __call__(self, t: Array, order: int = 0) -> Array:
        """Points, or derivatives, (M, r, D) at parameters t (M, r)."""
        (m, r), n = t.shape, self.poles.shape[1]
        poles, first = self.poles.reshape(m * n, -1), n * np.arange(m + 1)
        row = np.repeat(np.arange(m), r)
        return np.asarray(
            evaluate_rows(poles, first, self.knots.ravel(), self.degree, row, t.ravel(), order).reshape(m, r, -1)
        )


def interpolate_alike(t: Array, points: Array, degree: int) -> AlikeCurves:
    """The splines of odd degree through points (M, N, D) at ascending sites t (M, N), not-a-knot at their ends."""
    m, n = t.shape
    half = (degree + 1) // 2
    ends = np.repeat(t[:, :1], degree + 1, axis=1), np.repeat(t[:, -1:], degree + 1, axis=1)
    knots = np.concatenate([ends[0], t[:, half : n - half], ends[1]], axis=1)
    first = _find_spans(knots, degree, t)
    row = np.repeat(np.arange(m), n)
    about = knots[row, first.ravel() + 1 + np.arange(2 * degree)[:, None]]
    values = nonzero_basis_of_spans(about, degree, t.ravel())[0]
    matrix = np.zeros((m, n, n))
    column = first.ravel()[:, None] + np.arange(degree + 1)
    matrix[row[:, None], np.tile(np.arange(n), m)[:, None], column] = values
    return AlikeCurves(knots, np.linalg.solve(matrix, points), degree)


def _find_spans(knots: Array, degree: int, t: Array) -> IntArray:
    """The first (M, r) of the basis functions that do not vanish at t (M, r); at a knot those of the span above."""
    inner = knots[:, degree + 1 : -degree - 1]
    return np.asarray((inner[:, None, :] <= t[:, :, None]).sum(axis=2), np.int64)
