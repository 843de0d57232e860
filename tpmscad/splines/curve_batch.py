"""Evaluation of many B-spline curves at once, at pairs of a curve and a parameter, by de Boor's algorithm.

One call per curve costs tens of microseconds whatever it evaluates. Trimmed lattices have thousands of curves, each evaluated
at a few parameters. Here curves of one degree are concatenated, and evaluated in one compiled loop.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tpmscad._compiled_loops import njit_cached
from tpmscad._typing import Array, IntArray
from tpmscad.splines.bspline import BSplineCurve


def evaluate_curves(
    curves: Sequence[BSplineCurve], curve_index: IntArray, t: Array, orders: Sequence[int] = (0,)
) -> list[Array]:
    """Points, or derivatives, of the curves `curve_index` (n,) at parameters t (n,): (n, D) for each order.

    One-sided at the ends of a domain, as `BSplineCurve`; outside the domain the first or last span is extrapolated.
    """
    used, member = np.unique(curve_index, return_inverse=True)
    dimension = curves[int(used[0])].poles.shape[1] if len(used) else 0
    result = [np.empty((len(t), dimension)) for _ in orders]
    members = [curves[int(i)] for i in used]
    degrees = np.array([c.degree for c in members], np.int64)
    for degree in np.unique(degrees).tolist():
        of_degree = np.flatnonzero(degrees == degree)
        slot = np.full(len(members), -1)
        slot[of_degree] = np.arange(len(of_degree))
        rows = np.flatnonzero(degrees[member] == degree)
        own = [members[i] for i in of_degree]
        table = (
            np.concatenate([c.poles for c in own]),
            np.cumsum([0, *(len(c.poles) for c in own)]),
            np.concatenate([c.knots for c in own]),
            degree,
        )
        where, at = slot[member[rows]], np.ascontiguousarray(t[rows], np.float64)
        for total, order in zip(result, orders, strict=True):
            total[rows] = evaluate_rows(*table, where, at, order)
    return result


@njit_cached
def evaluate_rows(
    poles: Array, first_pole: IntArray, knots: Array, degree: int, curve: IntArray, t: Array, order: int
) -> Array:  # pragma: no cover - compiled
    """Derivatives (n, D) of the curves (n,) named at t (n,), by de Boor's algorithm.

    poles, knots: of all curves one after another, of which curve c has poles first_pole[c] to first_pole[c + 1] - 1 and
    degree + 1 more knots.
    """
    result, d = np.zeros((len(t), poles.shape[1])), np.empty((degree + 1, poles.shape[1]))
    if order > degree:
        return result
    for i in range(len(t)):
        c, x = curve[i], t[i]
        base = first_pole[c] + c * (degree + 1)
        low, high = degree, first_pole[c + 1] - first_pole[c] - 1  # the span, its last knot that is not above x
        while low < high:
            middle = (low + high + 1) // 2
            if knots[base + middle] <= x:
                low = middle
            else:
                high = middle - 1
        at, first = base + low, first_pole[c] + low - degree
        for j in range(degree + 1):
            for k in range(poles.shape[1]):
                d[j, k] = poles[first + j, k]
        for r in range(order):
            p = degree - r
            for j in range(p):
                factor = p / (knots[at + 1 + j] - knots[at + 1 + j - p])
                for k in range(poles.shape[1]):
                    d[j, k] = factor * (d[j + 1, k] - d[j, k])
        for p in range(degree - order, 0, -1):
            for j in range(p):
                left = knots[at + 1 + j - p]
                ahead = (x - left) / (knots[at + 1 + j] - left)
                for k in range(poles.shape[1]):
                    d[j, k] += ahead * (d[j + 1, k] - d[j, k])
        for k in range(poles.shape[1]):
            result[i, k] = d[0, k]
    return result
