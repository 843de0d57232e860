"""Evaluation of many B-spline curves at once, at pairs of a curve and a parameter, by de Boor's algorithm.

One call per curve costs tens of microseconds whatever it evaluates. Trimmed lattices have thousands of curves, each evaluated
at a few parameters. Here curves of one degree are concatenated, and the poles and knots about each parameter are
gathered for one vectorised evaluation.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.splines.basis import differentiate_local_poles, evaluate_by_de_boor
from tpmscad.splines.bspline import BSplineCurve

MAX_POINTS_PER_BATCH = 2_000
"""Points evaluated at once: their poles and knots stay in the processor's cache."""


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
        stack = _CurveStack([members[i] for i in of_degree], degree)
        for batch in np.array_split(rows, -(-len(rows) // MAX_POINTS_PER_BATCH)):
            for total, values in zip(result, stack(slot[member[batch]], t[batch], orders), strict=True):
                total[batch] = values
    return result


class _CurveStack:
    """Curves of one degree with their poles, and their distinct knot vectors, concatenated."""

    def __init__(self, curves: Sequence[BSplineCurve], degree: int) -> None:
        self.degree = degree
        self.poles = np.ascontiguousarray(np.concatenate([c.poles for c in curves]).T)
        self.first_pole = np.concatenate([[0], np.cumsum([len(c.poles) for c in curves])])[:-1]
        known: dict[bytes, int] = {}
        self.knot_vector_index = np.array([known.setdefault(c.knots.tobytes(), len(known)) for c in curves], np.int64)
        vectors = [np.frombuffer(k) for k in known]
        self.inner_knots = [k[degree + 1 : -degree - 1] for k in vectors]
        self.knots = np.concatenate(vectors)
        self.first_knot = np.concatenate([[0], np.cumsum([len(k) for k in vectors])])[:-1]

    def __call__(self, curve: IntArray, t: Array, orders: Sequence[int]) -> list[Array]:
        p, vector = self.degree, self.knot_vector_index[curve]
        span = np.empty(len(t), np.int64)  # number of the knot interval within its own curve
        for k in np.unique(vector).tolist():
            at = np.flatnonzero(vector == k)
            span[at] = np.searchsorted(self.inner_knots[k], t[at], side="right")
        knots = self.knots[self.first_knot[vector] + span + np.arange(1, 2 * p + 1)[:, None]]
        poles = self.poles[:, self.first_pole[curve] + span + np.arange(p + 1)[:, None]]
        return [evaluate_by_de_boor(*differentiate_local_poles(poles, knots, order), t).T for order in orders]
