"""Splines through values at any parameters, with spans bisected until a measured error is within a tolerance."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tpmscad._typing import Array
from tpmscad.splines.basis import design_matrix
from tpmscad.splines.bspline import BSplineCurve

FIT_DEGREE = 7

MAX_FIT_SPANS = 400
"""Most spans of a fitted curve; half an ellipse on a cylinder takes 8 for a relative error of 1e-10."""

WORST_ERROR_FRACTION = 0.03
"""Fraction of the largest error: spans with a larger error are bisected together."""

ERROR_CHECKS_PER_SPAN = 5
"""Points per knot span at which a fit's error is measured."""


def fit_adaptively(
    values: Callable[[Array], Array],
    breaks: Array,
    error: Callable[[BSplineCurve, Array], Array],
    tol: float,
    bends: Array | None = None,
    kinks: Array | None = None,
) -> BSplineCurve | None:
    """Spline through values(t); spans with an error above `tol` are bisected and the spline is fitted again.

    `bends` are those of the breaks at which only first derivatives are continuous, `kinks` those at which only the values are.
    None if MAX_FIT_SPANS spans do not suffice.
    """
    inside = (np.arange(ERROR_CHECKS_PER_SPAN) + 0.5) / ERROR_CHECKS_PER_SPAN
    while len(breaks) <= MAX_FIT_SPANS:
        knots, sites = make_knots_and_sites(breaks, bends, kinks)
        try:
            poles = np.asarray(np.linalg.solve(design_matrix(knots, FIT_DEGREE, sites), values(sites)), float)
        except np.linalg.LinAlgError:
            break
        fit = BSplineCurve(poles, knots, FIT_DEGREE)
        checks = (breaks[:-1, None] + np.diff(breaks)[:, None] * inside).ravel()
        worst = error(fit, checks).reshape(-1, ERROR_CHECKS_PER_SPAN).max(axis=1)
        if (worst <= tol).all():
            return fit
        bad = np.flatnonzero(
            ~(worst <= max(tol, WORST_ERROR_FRACTION * worst.max()))
        )  # the largest errors dominate those of neighbouring spans
        breaks = np.union1d(breaks, 0.5 * (breaks[bad] + breaks[bad + 1]))
    return None


def make_knots_and_sites(breaks: Array, bends: Array | None = None, kinks: Array | None = None) -> tuple[Array, Array]:
    """Knots of degree `FIT_DEGREE` at the breaks, repeated at the bends and kinks, and the Greville abscissae."""
    counts = np.ones(len(breaks), np.int64)
    for places, count in ((bends, FIT_DEGREE - 1), (kinks, FIT_DEGREE)):
        if places is not None:
            counts[1:-1][np.isin(breaks[1:-1], places)] = count
    inner = np.repeat(breaks, counts)
    knots = np.concatenate([np.repeat(breaks[0], FIT_DEGREE), inner, np.repeat(breaks[-1], FIT_DEGREE)])
    sites = np.array([knots[i + 1 : i + FIT_DEGREE + 1].mean() for i in range(len(knots) - FIT_DEGREE - 1)])
    return knots, np.clip(sites, breaks[0], breaks[-1])
