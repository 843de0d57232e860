"""The fit with the fewest poles that meets a tolerance: candidate spline spaces are fitted by CPIA and measured.

The search starts at a first guess from the Legendre coefficients of the surface: their tail beyond a degree bounds what is lost
by truncation. The guess is low on purpose, because small candidates are cheap and those just below the answer must be tried in
any case. From the first candidate that meets the tolerance the search descends until REQUIRED_MISSES candidates in a row miss
it.
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
from tpmscad.splines.knots import bezier_knots, uniform_knots
from tpmscad.splines.spline_axis import SplineAxis, gauss_axis
from tpmscad.splines.surface_fit import least_squares_coordinates

REQUIRED_MISSES = 2
"""Smaller candidates that must miss: an even degree may beat the next odd one."""

FIRST_GUESS_TOL_FACTOR = 20.0
"""The first guess loses at most this many tolerances by truncation: two or three degrees below the answer."""

GridEvaluator = Callable[[Array, Array], Array]
"""Points (m, n, D) of a surface on the grid of all u (m,) with all v (n,)."""

ConditionsOnAxes = Callable[[SplineAxis, SplineAxis], ContinuityConditions]
"""Linear conditions on the coordinates of two axes."""


@dataclass(frozen=True, slots=True)
class SplineSpace:
    """A tensor-product spline space on the unit square, the same along u and v.

    Parameters
    ----------
    degree : int
        Polynomial degree.
    spans : int, optional
        Number of equal spans; one by default.
    smoothness : int, optional
        The splines are C^smoothness at inner knots.

    Examples
    --------
    >>> from tpmscad.splines import SplineSpace
    >>> SplineSpace(5).n_poles
    36
    """

    degree: int
    spans: int = 1
    smoothness: int = 2

    @property
    def n_poles(self) -> int:
        """Number of poles of a surface."""
        return (self.degree + 1 + (self.spans - 1) * (self.degree - self.smoothness)) ** 2

    def make_axis(self) -> SplineAxis:
        """The axis of both directions, sampled at Gauss points."""
        if self.spans == 1:
            return gauss_axis(bezier_knots(self.degree), self.degree)
        return gauss_axis(uniform_knots(self.spans, self.degree, self.smoothness), self.degree)


BEZIER_SPACES = tuple(SplineSpace(degree) for degree in range(5, 21))
"""One span: on analytic surfaces the fewest poles for every tolerance. STEP readers accept degrees up to 25."""


@dataclass(frozen=True, slots=True)
class FitTrial:
    """One candidate of a search.

    Parameters
    ----------
    space : SplineSpace
        Its spline space.
    deviation : float
        The measured deviation of its fit.

    Examples
    --------
    >>> from tpmscad.splines import FitTrial, SplineSpace
    >>> FitTrial(SplineSpace(5), 1e-3).space.degree
    5
    """

    space: SplineSpace
    deviation: float


@dataclass(frozen=True, slots=True, eq=False)
class AdaptiveFit:
    """Result of `fit_to_tolerance`: the fit with the fewest poles that met `tol`, or the nearest one tried.

    Parameters
    ----------
    surface : BSplineSurface
        The fitted surface.
    space : SplineSpace
        Its spline space.
    deviation : float
        Its measured deviation.
    tol : float
        The deviation asked for.
    trials : tuple of FitTrial
        The candidates in the order in which they were tried.
    convergence : NetConvergence
        Iterations of CPIA and the proven bound on the distance of the net from their limit.
    """

    surface: BSplineSurface
    space: SplineSpace
    deviation: float
    tol: float
    trials: tuple[FitTrial, ...]
    convergence: NetConvergence

    @property
    def converged(self) -> bool:
        """Whether the deviation is at most `tol`."""
        return self.deviation <= self.tol

    @property
    def n_poles(self) -> int:
        """Number of poles of the surface."""
        return self.space.n_poles


def fit_in_space(evaluate: GridEvaluator, space: SplineSpace, conditions: ConditionsOnAxes | None = None) -> CpiaResult:
    """The least-squares fit in one spline space under conditions, by CPIA in coordinates orthonormal on the Gauss points."""
    axis = space.make_axis()
    samples = evaluate(axis.points, axis.points)
    dimension = samples.shape[-1]
    subspace = (
        unconstrained_subspace(space.n_poles * dimension)
        if conditions is None
        else solve_conditions(conditions(axis, axis), pole_metric(axis, axis, dimension))
    )
    return fit_cpia(samples, axis_grid(axis, axis), axis, axis, subspace)


def fit_to_tolerance(
    evaluate: GridEvaluator,
    measure_deviation: Callable[[BSplineSurface], float],
    tol: float,
    *,
    conditions: ConditionsOnAxes | None = None,
    candidates: Sequence[SplineSpace] = BEZIER_SPACES,
) -> AdaptiveFit:
    """Fit a surface on the unit square with the fewest poles that meet a tolerance.

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
    candidates : sequence of SplineSpace, optional
        Spline spaces to choose from.

    Returns
    -------
    AdaptiveFit
        The fit. REQUIRED_MISSES next smaller candidates were tried and missed. If none meets `tol`, the best of those tried is
        returned and `converged` is False.

    Examples
    --------
    >>> import numpy as np
    >>> from tpmscad.splines import fit_to_tolerance
    >>> def saddle(u, v):
    ...     return np.stack(np.broadcast_arrays(u[:, None], v, u[:, None] * v), axis=-1)
    >>> t = np.linspace(0, 1, 5)
    >>> fit = fit_to_tolerance(saddle, lambda s: float(np.abs(s.grid(t, t) - saddle(t, t)).max()), 1e-9)
    >>> fit.converged, fit.space.degree
    (True, 5)
    """
    spaces = sorted(set(candidates), key=lambda space: (space.n_poles, space.degree))
    tried: dict[SplineSpace, tuple[CpiaResult, float]] = {}

    def meets(space: SplineSpace) -> bool:
        if space not in tried:
            fitted = fit_in_space(evaluate, space, conditions)
            tried[space] = fitted, measure_deviation(fitted.surface)
        return tried[space][1] <= tol

    first = first_candidate_index(evaluate, tol, spaces)
    meeting = next((i for i in range(first, len(spaces)) if meets(spaces[i])), None)
    if meeting is None:
        best = min(tried, key=lambda space: tried[space][1])
    else:
        best = spaces[_lowest_meeting_index(meeting, lambda i: meets(spaces[i]))]
    trials = tuple(FitTrial(space, deviation) for space, (_, deviation) in tried.items())
    fitted, deviation = tried[best]
    return AdaptiveFit(fitted.surface, best, deviation, tol, trials, fitted.convergence)


def _lowest_meeting_index(meeting: int, meets: Callable[[int], bool]) -> int:
    """The index, at most `meeting`, below which REQUIRED_MISSES candidates in a row miss."""
    lower, misses = meeting - 1, 0
    while lower >= 0 and misses < REQUIRED_MISSES:
        if meets(lower):
            meeting, misses = lower, 0
        else:
            misses += 1
        lower -= 1
    return meeting


def first_candidate_index(evaluate: GridEvaluator, tol: float, spaces: Sequence[SplineSpace]) -> int:
    """Index of the first one-span space that loses at most FIRST_GUESS_TOL_FACTOR tol by truncation; else of the last space."""
    highest = max((space.degree for space in spaces if space.spans == 1), default=0)
    if highest == 0:
        return 0
    axis = SplineSpace(highest).make_axis()
    coordinates = np.linalg.norm(least_squares_coordinates(evaluate(axis.points, axis.points), axis, axis), axis=-1)
    # The orthonormal Legendre polynomial of degree i is no larger than sqrt(2 i + 1).
    size = np.sqrt(2 * np.arange(highest + 1) + 1)
    largest = coordinates * np.multiply.outer(size, size)
    for i, space in enumerate(spaces):
        kept = largest[: space.degree + 1, : space.degree + 1].sum()
        if space.spans == 1 and largest.sum() - kept <= FIRST_GUESS_TOL_FACTOR * tol:
            return i
    return len(spaces) - 1
