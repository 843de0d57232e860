"""Fits of surfaces that are given by samples on any grid of their parameters, within a tolerance and in the same parameters.

Along each parameter the fit has a space of its own: one that is given, or one of degree 9 whose spans are bisected until lines of
the surface are within a quarter of the tolerance. The fit is by least squares on Gauss points; its error is measured on a grid.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.splines.basis import design_matrix
from tpmscad.splines.bspline import BSplineCurve, BSplineSurface
from tpmscad.splines.quadrature import composite_gauss_legendre
from tpmscad.splines.spline_axis import SplineAxis, sampled_axis
from tpmscad.splines.surface_fit import fit_surface

CHART_DEGREE = 9
"""Degree along a parameter without a space of its own; foot points take no higher one."""

FIT_LINES = 7
"""Lines of the surface on which the spans along one parameter are bisected."""

MAX_SPANS = 384
"""Most spans along one parameter; a surface that needs more is returned with the error that is left. Eight turns of a helix take
128: smooth splines pay for their continuity, by a factor of 1e5 in the error beside polynomials on the same spans."""

MIN_POINTS = 4
"""Fewest Gauss points in a span."""

LINE_TOL = 0.25
"""Of the tolerance: error of the lines, to leave some for what is between them."""

SPAN_CHECKS = np.linspace(0.02, 0.98, 9)
"""Places in a span at which the error of a line is measured."""

CHECK_LINES = (61, 53)
"""Lines along u and v on whose grid the error of a carrier is measured; they are on no Gauss points."""

Space = tuple[Array, int]
"""Knots and degree."""

Sampler = Callable[[Array, Array], Array]
"""Points (len(u), len(v), 3) on the grid of all u with all v."""


def fit_chart(sample: Sampler, tol: float) -> tuple[BSplineSurface, float]:
    """A chart of the unit square, points (n, m, 3) on the grid of s (n,) and t (m,), and its greatest measured error."""
    box, ends = np.array([[0.0, 1.0], [0.0, 1.0]]), np.array([0.0, 1.0])
    spaces = [find_space(sample, axis, box, ends, np.empty(0, int), tol) for axis in (0, 1)]
    return fit_in_spaces(sample, spaces, [True, True], tol)


def fit_curve(
    sample: Callable[[Array], Array], breaks: Array, continuity: Array | IntArray, tol: float
) -> BSplineCurve | None:
    """A curve of degree `CHART_DEGREE` through points (n, 3) at t (n,), with spans bisected until it is within `tol`; else None.

    It has the given continuity at the inner breaks.
    """
    knots = make_break_knots(breaks, continuity, CHART_DEGREE)
    while True:
        ends, own = np.unique(knots), _make_axis(knots, CHART_DEGREE)
        weights = np.sqrt(own.weights)[:, None]
        rows = weights * design_matrix(knots, CHART_DEGREE, own.points)
        poles = np.linalg.lstsq(rows, weights * sample(own.points), rcond=None)[0]
        curve = BSplineCurve(np.asarray(poles, float), knots, CHART_DEGREE)
        at = ends[:-1, None] + np.diff(ends)[:, None] * SPAN_CHECKS
        missed = np.linalg.norm(curve(at.ravel()) - sample(at.ravel()), axis=1).reshape(at.shape).max(axis=1)
        bad = missed > tol
        if not bad.any():
            return curve
        if len(ends) - 1 + bad.sum() > MAX_SPANS:
            return None
        knots = np.sort(np.concatenate([knots, 0.5 * (ends[1:] + ends[:-1])[bad]]))


def fit_in_spaces(
    sample: Sampler, spaces: list[Space], adaptive: list[bool], tol: float
) -> tuple[BSplineSurface, float]:
    """The fit in both spaces and its measured error; the spans of those that are adaptive are halved until it is within `tol`."""
    while True:
        axes = [_make_axis(*space) for space in spaces]
        spline = fit_surface(sample(axes[0].points, axes[1].points), axes[0], axes[1])
        error = measure_grid_error(spline, sample)
        finer = [_bisect_all(space) if free else space for space, free in zip(spaces, adaptive, strict=True)]
        counts = [len(np.unique(knots)) - 1 for knots, _ in finer]
        if error <= tol or not any(adaptive) or max(counts) > MAX_SPANS:
            return spline, error
        spaces = finer


def make_break_knots(breaks: Array, continuity: Array | IntArray, degree: int) -> Array:
    """Clamped knots with the given continuity at the inner breaks."""
    repeats = np.maximum(degree - continuity, 1)
    return np.concatenate(
        [np.repeat(breaks[0], degree + 1), np.repeat(breaks[1:-1], repeats), np.repeat(breaks[-1], degree + 1)]
    )


def _make_axis(knots: Array, degree: int) -> SplineAxis:
    """The space with Gauss points, a few more than it has degrees of freedom: samples of a tensor grid are what a fit costs."""
    ends, repeats = np.unique(knots, return_counts=True)
    repeats[[0, -1]] = MIN_POINTS
    spans = len(ends) - 1
    least = max(MIN_POINTS, int(np.ceil(1.5 * (degree + spans) / spans)))
    counts = np.clip(1 + np.maximum(repeats[:-1], repeats[1:]), least, max(least, degree + 3))
    missing = len(knots) - degree - 1 - int(counts.sum())
    if missing > 0:  # spans that join with creases have almost as many poles as if they stood alone
        counts += 1 + missing // spans
    points, weights = zip(
        *(composite_gauss_legendre(ends[k : k + 2], count) for k, count in enumerate(counts.tolist())), strict=True
    )
    return sampled_axis(knots, degree, np.concatenate(points), np.concatenate(weights))


def _bisect_all(space: Space) -> Space:
    """The space with every span halved."""
    knots, degree = space
    ends = np.unique(knots)
    return np.sort(np.concatenate([knots, 0.5 * (ends[1:] + ends[:-1])])), degree


def find_space(
    sample: Sampler, axis: int, box: Array, breaks: Array, continuity: Array | IntArray, tol: float
) -> Space:
    """A space of degree `CHART_DEGREE` whose fits to lines of the surface along one parameter are within LINE_TOL."""
    knots = make_break_knots(breaks, continuity, CHART_DEGREE)
    low, high = box[1 - axis]
    across = low + (high - low) * (0.5 - 0.5 * np.cos(np.pi * np.arange(FIT_LINES) / (FIT_LINES - 1)))

    def lines(t: Array) -> Array:
        """Points of all lines at parameters t: (len(t), FIT_LINES * 3)."""
        found = sample(t, across) if axis == 0 else sample(across, t).swapaxes(0, 1)
        return found.reshape(len(t), -1)

    while True:
        own = _make_axis(knots, CHART_DEGREE)
        rows = own.weighted_design_matrix() * np.sqrt(own.weights)[:, None]
        coordinates = rows.T @ lines(own.points)
        ends = np.unique(knots)
        at = ends[:-1, None] + np.diff(ends)[:, None] * SPAN_CHECKS
        missed = own.design_matrix(at.ravel()) @ coordinates - lines(at.ravel())
        distance = np.linalg.norm(missed.reshape(*at.shape, FIT_LINES, 3), axis=3).max(axis=(1, 2))
        bad = distance > LINE_TOL * tol
        if not bad.any() or len(ends) - 1 + bad.sum() > MAX_SPANS:
            return knots, CHART_DEGREE
        knots = np.sort(np.concatenate([knots, 0.5 * (ends[1:] + ends[:-1])[bad]]))


def measure_grid_error(spline: BSplineSurface, sample: Sampler) -> float:
    """Greatest distance of equal parameters on a grid, between the spline and what is fitted."""
    u, v = (np.linspace(*interval, count) for interval, count in zip(spline.domain, CHECK_LINES, strict=True))
    return float(np.linalg.norm(spline.grid(u, v) - sample(u, v), axis=2).max())
