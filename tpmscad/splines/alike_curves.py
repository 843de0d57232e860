"""Interpolation and evaluation of many spline curves with equal numbers of poles, each with its own sites, at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad._compiled_loops import njit_cached
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
    poles = np.array(points, float, order="C")
    _solve_collocation(first, values.reshape(m, n, -1), poles)
    return AlikeCurves(knots, poles, degree)


@njit_cached
def _solve_collocation(first: IntArray, values: Array, points: Array) -> None:  # pragma: no cover - compiled
    """Solve M systems in place, x in `points` (M, N, D): row i has `values` (N, K) from the column first[i] on.

    Without pivoting: collocation matrices are totally positive (C. de Boor, A Practical Guide to Splines, chapter XIII).
    """
    m, n, width = values.shape
    for c in range(m):
        for j in range(n):
            pivot = values[c, j, j - first[c, j]]
            for i in range(j + 1, n):
                if first[c, i] > j:
                    break
                factor = values[c, i, j - first[c, i]] / pivot
                for k in range(j + 1, first[c, j] + width):
                    values[c, i, k - first[c, i]] -= factor * values[c, j, k - first[c, j]]
                for d in range(points.shape[2]):
                    points[c, i, d] -= factor * points[c, j, d]
        for j in range(n - 1, -1, -1):
            for d in range(points.shape[2]):
                x = points[c, j, d]
                for k in range(j + 1, min(first[c, j] + width, n)):
                    x -= values[c, j, k - first[c, j]] * points[c, k, d]
                points[c, j, d] = x / values[c, j, j - first[c, j]]


def _find_spans(knots: Array, degree: int, t: Array) -> IntArray:
    """The first (M, r) of the basis functions that do not vanish at t (M, r); at a knot those of the span above."""
    inner = knots[:, degree + 1 : -degree - 1]
    return np.asarray((inner[:, None, :] <= t[:, :, None]).sum(axis=2), np.int64)
