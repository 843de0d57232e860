"""Many B-spline curves at once: points at pairs of a curve and a parameter, by de Boor's algorithm.

A call for each curve costs tens of microseconds whatever it evaluates; cut lattices have thousands of curves, each looked at in a
few points.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.splines.bspline import BSplineCurve

MAX_POINTS_PER_BATCH = 2_000
"""Points evaluated at once: their poles and knots stay in the processor's cache."""


def evaluate_curves(
    curves: Sequence[BSplineCurve], index: IntArray, t: Array, orders: Sequence[int] = (0,)
) -> list[Array]:
    """For each order the points, or derivatives, at parameters t (n,) of the curves `index` (n,): (n, D) each.

    One-sided at the ends of a domain, as `Curve`; beyond them the last span is prolonged.
    """
    used, own = np.unique(index, return_inverse=True)
    dimension = curves[int(used[0])].poles.shape[1] if len(used) else 0
    result = [np.empty((len(t), dimension)) for _ in orders]
    members = [curves[int(i)] for i in used]
    degrees = np.array([c.degree for c in members], np.int64)
    for degree in np.unique(degrees).tolist():
        of_degree = np.flatnonzero(degrees == degree)
        place = np.full(len(members), -1)
        place[of_degree] = np.arange(len(of_degree))
        rows = np.flatnonzero(degrees[own] == degree)
        stack = _CurveStack([members[i] for i in of_degree], degree)
        for some in np.array_split(rows, -(-len(rows) // MAX_POINTS_PER_BATCH)):
            for total, found in zip(result, stack(place[own[some]], t[some], orders), strict=True):
                total[some] = found
    return result


class _CurveStack:
    """Curves of one degree, their poles and their distinct knot vectors laid end to end."""

    def __init__(self, curves: Sequence[BSplineCurve], degree: int) -> None:
        self.degree = degree
        self.poles = np.ascontiguousarray(np.concatenate([c.poles for c in curves]).T)
        self.first_pole = np.concatenate([[0], np.cumsum([len(c.poles) for c in curves])])[:-1]
        known: dict[bytes, int] = {}
        self.kind = np.array([known.setdefault(c.knots.tobytes(), len(known)) for c in curves], np.int64)
        vectors = [np.frombuffer(k) for k in known]
        self.inner = [k[degree + 1 : -degree - 1] for k in vectors]
        self.knots = np.concatenate(vectors)
        self.first_knot = np.concatenate([[0], np.cumsum([len(k) for k in vectors])])[:-1]

    def __call__(self, own: IntArray, t: Array, orders: Sequence[int]) -> list[Array]:
        p, kind = self.degree, self.kind[own]
        span = np.empty(len(t), np.int64)  # which knot interval of its own curve, from 0
        for k in np.unique(kind).tolist():
            at = np.flatnonzero(kind == k)
            span[at] = np.searchsorted(self.inner[k], t[at], side="right")
        knots = self.knots[self.first_knot[kind] + span + np.arange(1, 2 * p + 1)[:, None]]
        poles = self.poles[:, self.first_pole[own] + span + np.arange(p + 1)[:, None]]
        return [_de_boor(*_differentiate(poles, knots, order), t).T for order in orders]


def _differentiate(poles: Array, knots: Array, order: int) -> tuple[Array, Array]:
    """Poles (D, p + 1, n) and knots (2 p, n) about a parameter's interval, of the derivative."""
    for _ in range(order):
        p = poles.shape[1] - 1
        if p == 0:
            return np.zeros_like(poles), knots
        poles, knots = p * np.diff(poles, axis=1) / (knots[p:] - knots[:p]), knots[1:-1]
    return poles, knots


def _de_boor(poles: Array, knots: Array, t: Array) -> Array:
    """The points at t (n,) from the poles (D, p + 1, n) and the knots (2 p, n) about its interval: (D, n)."""
    p = poles.shape[1] - 1
    for r in range(1, p + 1):
        left = knots[r - 1 : p]
        part = (t - left) / (knots[p : 2 * p - r + 1] - left)
        poles = poles[:, :-1] + part * (poles[:, 1:] - poles[:, :-1])
    return poles[:, 0]
