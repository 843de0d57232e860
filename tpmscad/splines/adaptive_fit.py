"""The fit of the lowest degree that meets a tolerance: one-span fits of candidate degrees are made by CPIA and measured.

On analytic surfaces one span takes the fewest poles for every tolerance. The search starts at a first guess from the Legendre
coefficients of the surface: their tail beyond a degree bounds what is lost by truncation. The guess is low on purpose, because
small candidates are cheap and those just below the answer must be tried in any case. From the first candidate that meets the
tolerance the search descends until REQUIRED_MISSES candidates in a row miss it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array
from tpmscad.splines.affine_subspace import pole_metric, solve_conditions, unconstrained_subspace
from tpmscad.splines.bspline import BSplineSurface
from tpmscad.splines.continuity_conditions import ContinuityConditions
from tpmscad.splines.cpia import CpiaResult, NetConvergence, axis_grid, fit_cpia
from tpmscad.splines.knots import bezier_knots
from tpmscad.splines.spline_axis import SplineAxis, gauss_axis
from tpmscad.splines.surface_fit import least_squares_coordinates

DEGREES = tuple(range(5, 21))
"""Candidates by default. STEP readers accept degrees up to 25."""

REQUIRED_MISSES = 2
"""Smaller candidates that must miss: an even degree may beat the next odd one."""

FIRST_GUESS_TOL_FACTOR = 20.0
"""The first guess loses at most this many tolerances by truncation: two or three degrees below the answer."""

GridEvaluator = Callable[[Array, Array], Array]
"""Points (m, n, D) of a surface on the grid of all u (m,) with all v (n,)."""

ConditionsOnAxes = Callable[[SplineAxis, SplineAxis], ContinuityConditions]
"""Linear conditions on the coordinates of two axes."""


@dataclass(frozen=True, slots=True, eq=False)
class AdaptiveFit:
    """Result of `fit_to_tolerance`: the fit of the lowest degree that met `tol`, or the nearest one tried.

    Parameters
    ----------
    surface : BSplineSurface
        The fitted surface.
    degree : int
        Its degree along u and v.
    deviation : float
        Its measured deviation.
    tol : float
        The deviation asked for.
    trials : dict of int to float
        The measured deviation by degree, in the order in which the degrees were tried.
    convergence : NetConvergence
        Iterations of CPIA and the proven bound on the distance of the net from their limit.
    """

    surface: BSplineSurface
    degree: int
    deviation: float
    tol: float
    trials: dict[int, float]
    convergence: NetConvergence

    @property
    def converged(self) -> bool:
        """Whether the deviation is at most `tol`."""
        return self.deviation <= self.tol

    @property
    def n_poles(self) -> int:
        """Number of poles of the surface."""
        return (self.degree + 1) ** 2


def fit_degree(evaluate: GridEvaluator, degree: int, conditions: ConditionsOnAxes | None = None) -> CpiaResult:
    """The least-squares fit of one degree under conditions, by CPIA in coordinates orthonormal on the Gauss points."""
    axis = _one_span_axis(degree)
    samples = evaluate(axis.points, axis.points)
    dimension = samples.shape[-1]
    subspace = (
        unconstrained_subspace((degree + 1) ** 2 * dimension)
        if conditions is None
        else solve_conditions(conditions(axis, axis), pole_metric(axis, axis, dimension))
    )
    return fit_cpia(samples, axis_grid(axis, axis), axis, axis, subspace)


def _one_span_axis(degree: int) -> SplineAxis:
    """The axis of both directions, sampled at Gauss points."""
    return gauss_axis(bezier_knots(degree), degree)


def fit_to_tolerance(
    evaluate: GridEvaluator,
    measure_deviation: Callable[[BSplineSurface], float],
    tol: float,
    *,
    conditions: ConditionsOnAxes | None = None,
    degrees: Sequence[int] = DEGREES,
) -> AdaptiveFit:
    """Fit a one-span surface on the unit square with the lowest degree that meets a tolerance.

    Parameters
    ----------
    evaluate : callable
        Maps u (m,) and v (n,) to points (m, n, D) of the surface.
    measure_deviation : callable
        Maps a fit to its deviation from the surface.
    tol : float
        Greatest deviation, in the unit of `measure_deviation`.
    conditions : callable, optional
        Maps two axes to the `ContinuityConditions` on their coordinates that every candidate must satisfy. Candidates are
        nearest in the `pole_metric`.
    degrees : sequence of int, optional
        Degrees to choose from, ascending.

    Returns
    -------
    AdaptiveFit
        The fit. REQUIRED_MISSES next lower candidates were tried and missed. If none meets `tol`, the best of those tried is
        returned and `converged` is False.

    Examples
    --------
    >>> import numpy as np
    >>> from tpmscad.splines import fit_to_tolerance
    >>> def saddle(u, v):
    ...     return np.stack(np.broadcast_arrays(u[:, None], v, u[:, None] * v), axis=-1)
    >>> t = np.linspace(0, 1, 5)
    >>> fit = fit_to_tolerance(saddle, lambda s: float(np.abs(s.grid(t, t) - saddle(t, t)).max()), 1e-9)
    >>> fit.converged, fit.degree
    (True, 5)
    """
    tried: dict[int, CpiaResult] = {}
    trials: dict[int, float] = {}

    def meets(degree: int) -> bool:
        if degree not in tried:
            tried[degree] = fit_degree(evaluate, degree, conditions)
            trials[degree] = measure_deviation(tried[degree].surface)
        return trials[degree] <= tol

    first = guess_degree(evaluate, tol, degrees)
    best = next((degree for degree in degrees if degree >= first and meets(degree)), None)
    if best is None:
        best = min(trials, key=lambda degree: trials[degree])
    else:
        misses = 0
        for degree in reversed([degree for degree in degrees if degree < best]):
            best, misses = (degree, 0) if meets(degree) else (best, misses + 1)
            if misses == REQUIRED_MISSES:
                break
    return AdaptiveFit(tried[best].surface, best, trials[best], tol, trials, tried[best].convergence)


def guess_degree(evaluate: GridEvaluator, tol: float, degrees: Sequence[int]) -> int:
    """The first degree that loses at most FIRST_GUESS_TOL_FACTOR tol by truncation; else the last."""
    axis = _one_span_axis(degrees[-1])
    coordinates = np.linalg.norm(least_squares_coordinates(evaluate(axis.points, axis.points), axis, axis), axis=-1)
    # The orthonormal Legendre polynomial of degree i is no larger than sqrt(2 i + 1).
    size = np.sqrt(2 * np.arange(degrees[-1] + 1) + 1)
    largest = coordinates * np.multiply.outer(size, size)
    lost = [largest.sum() - largest[: degree + 1, : degree + 1].sum() for degree in degrees]
    enough = (degree for degree, loss in zip(degrees, lost, strict=True) if loss <= FIRST_GUESS_TOL_FACTOR * tol)
    return next(enough, degrees[-1])
