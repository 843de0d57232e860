"""Extrema of the height along curves, and the division of curves there."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.brep.triangles.measured_deviation import Curves

Line = Callable[[Array, IntArray], tuple[Array, Array]]
"""Shares (n,) of the way along lines, and the numbers of the lines (n,), to points (n, 3) and derivatives of heights (n,)."""

DIVISION_STEPS = 12
"""Steps towards an extremum at which a curve is divided, which reach round-off."""


def find_extrema(line: Line, n: int, steps: int) -> tuple[Array, Array, BoolArray]:
    """Shares (n,) of lines at which the height has an extremum, the points there (n, 3), and whether there is one (n,).

    Steps of the regula falsi on the slope, with half the slope of an end that stays again (the Illinois algorithm); the height is
    exact to the square of the error of the place.
    """
    everyone = np.arange(n)
    t, point = np.full(n, 0.5), np.zeros((n, 3))
    low, high = line(np.zeros(n), everyone)[1], line(np.ones(n), everyone)[1]
    turning = low * high < 0.0
    some = np.flatnonzero(turning)
    a, b, slope_a, slope_b = np.zeros(len(some)), np.ones(len(some)), low[some], high[some]
    before = np.full(len(some), np.nan)
    for _ in range(steps if len(some) else 0):
        at = (a * slope_b - b * slope_a) / (slope_b - slope_a)
        point[some], slope = line(at, some)
        t[some] = at
        left = slope * slope_a > 0.0
        weight = np.where(left == before, 0.5, 1.0)
        a, slope_a = np.where(left, at, a), np.where(left, slope, weight * slope_a)
        b, slope_b = np.where(left, b, at), np.where(left, weight * slope_b, slope)
        before = left.astype(float)
    return t, point, turning


def divide_at_extrema(curves: Curves, span: Array, shares: list[Array], tol: float) -> list[Array]:
    """Shares of the span (n, 2) of each curve, with those at which its height exceeds both neighbours by more than `tol`."""
    which = np.repeat(np.arange(len(shares)), [len(each) - 1 for each in shares])
    if not len(which):
        return shares
    ends = np.concatenate([np.stack([each[:-1], each[1:]], axis=1) for each in shares])
    low, length = span[which, 0], np.diff(span, axis=1)[which, 0]

    def line(t: Array, own: IntArray) -> tuple[Array, Array]:
        at = (1.0 - t) * ends[own, 0] + t * ends[own, 1]
        points, slope = curves(which[own], low[own] + at * length[own])
        return points, slope[:, 2] * length[own]

    share, point, turning = find_extrema(line, len(which), DIVISION_STEPS)
    everyone = np.arange(len(which))
    z = np.stack([line(np.full(len(which), end), everyone)[0][:, 2] for end in (0.0, 1.0)])
    new = turning & ((point[:, 2] > z.max(axis=0) + tol) | (point[:, 2] < z.min(axis=0) - tol))
    at = (1.0 - share) * ends[:, 0] + share * ends[:, 1]
    found = list(shares)
    for curve in np.unique(which[new]).tolist():
        found[curve] = np.sort(np.concatenate([shares[curve], at[new & (which == curve)]]))
    return found
