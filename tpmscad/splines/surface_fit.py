"""Least-squares fits of surfaces to samples on a tensor grid, free or under linear conditions, solved directly.

In the orthonormal coordinates of the two axes the free solution is Phi_u^T Q Phi_v and the constrained one its orthogonal
projection on the subspace of the conditions: two small products and a projection, no normal equations.

The fewest poles that meet a tolerance, found by refinement: candidates are fitted and measured until one meets it.

A first guess says only where the search starts. It comes from the Legendre coefficients of the surface, whose tail past a
degree bounds what is lost by leaving it out, and is low on purpose: small candidates are cheap, and the ones just below
the answer have to be tried in any case.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array
from tpmscad.splines.affine_subspace import AffineSubspace, pole_metric, solve_conditions
from tpmscad.splines.bspline import BSplineSurface
from tpmscad.splines.continuity_conditions import ContinuityConditions
from tpmscad.splines.knots import bezier_knots, uniform_knots
from tpmscad.splines.spline_axis import SplineAxis, gauss_axis


def fit_surface(
    samples: Array, axis_u: SplineAxis, axis_v: SplineAxis, subspace: AffineSubspace | None = None
) -> BSplineSurface:
    """The surface in the subspace that is nearest to the samples (m, n, D) at the axes' points, in the sum of weighted squares.

    If the subspace has a metric of its own: the one that is nearest in it to the least-squares fit of the whole space.
    """
    coordinates = least_squares_coordinates(samples, axis_u, axis_v)
    if subspace is not None:
        coordinates = subspace.project(coordinates.ravel()).reshape(coordinates.shape)
    return surface_from_coordinates(coordinates, axis_u, axis_v)


def least_squares_coordinates(samples: Array, axis_u: SplineAxis, axis_v: SplineAxis) -> Array:
    """Coordinates (U, V, D) of the unconstrained least-squares fit."""
    expected = (len(axis_u.points), len(axis_v.points))
    if samples.shape[:2] != expected or samples.ndim != 3:
        raise ValueError(f"samples {samples.shape} don't lie on the axes' grid {expected}")
    left = np.sqrt(axis_u.weights)[:, None] * axis_u.weighted_design_matrix()
    right = np.sqrt(axis_v.weights)[:, None] * axis_v.weighted_design_matrix()
    return np.einsum("mu,mnd,nv->uvd", left, samples, right, optimize=True)


def surface_from_coordinates(coordinates: Array, axis_u: SplineAxis, axis_v: SplineAxis) -> BSplineSurface:
    """The surface with the given coordinates (U, V, D)."""
    poles = np.einsum("pu,uvd,qv->pqd", axis_u.to_poles, coordinates, axis_v.to_poles, optimize=True)
    return BSplineSurface(poles, axis_u.knots, axis_v.knots, axis_u.degree, axis_v.degree)


def coordinates_from_surface(fitted: BSplineSurface, axis_u: SplineAxis, axis_v: SplineAxis) -> Array:
    """Coordinates (U, V, D) of a surface with the axes' knots."""
    half = np.linalg.solve(axis_u.to_poles, fitted.poles.reshape(axis_u.n_coordinates, -1)).reshape(fitted.poles.shape)
    return (
        np.linalg.solve(axis_v.to_poles, half.swapaxes(0, 1).reshape(axis_v.n_coordinates, -1))
        .reshape(axis_v.n_coordinates, axis_u.n_coordinates, -1)
        .swapaxes(0, 1)
    )


GridEvaluator = Callable[[Array, Array], Array]
"""Points (m, n, D) of a surface on the grid of all u (m,) with all v (n,)."""


@dataclass(frozen=True, slots=True)
class SplineSpace:
    """A tensor-product spline space, the same along u and v on [0, 1]: equal spans, C^smoothness at inner knots."""

    degree: int
    spans: int = 1
    smoothness: int = 2

    @property
    def size(self) -> int:
        """Poles of a surface."""
        return (self.degree + 1 + (self.spans - 1) * (self.degree - self.smoothness)) ** 2

    def axis(self) -> SplineAxis:
        if self.spans == 1:
            return gauss_axis(bezier_knots(self.degree), self.degree)
        return gauss_axis(uniform_knots(self.spans, self.degree, self.smoothness), self.degree)


BEZIER_SPACES = tuple(SplineSpace(degree) for degree in range(5, 21))
"""One span: on analytic surfaces the fewest poles for every tolerance. STEP readers take degrees up to 25."""


@dataclass(frozen=True, slots=True)
class FitTrial:
    """One candidate and its measured deviation."""

    space: SplineSpace
    deviation: float


@dataclass(frozen=True, slots=True, eq=False)
class AdaptiveFit:
    """The fit with the fewest poles that met `tol`, or the nearest one there was; `trials` in the order they were made."""

    surface: BSplineSurface
    space: SplineSpace
    deviation: float
    tol: float
    trials: tuple[FitTrial, ...]

    @property
    def converged(self) -> bool:
        return self.deviation <= self.tol

    @property
    def poles(self) -> int:
        return self.space.size


def fit_to_tolerance(
    evaluate: GridEvaluator,
    measure: Callable[[BSplineSurface], float],
    tol: float,
    *,
    conditions: Callable[[SplineAxis, SplineAxis], ContinuityConditions] | None = None,
    ladder: Sequence[SplineSpace] = BEZIER_SPACES,
) -> AdaptiveFit:
    """Fit a surface on [0, 1]^2 with the fewest poles of the ladder for which measure(fit) <= tol.

    `conditions(axis_u, axis_v)` are what every candidate must satisfy, nearest in the `pole_metric`. Fewest means: the MISSES
    next smaller candidates were fitted and missed. If none meets tol, the best of those tried comes back.
    """
    spaces = sorted(set(ladder), key=lambda space: (space.size, space.degree))
    made: dict[SplineSpace, tuple[BSplineSurface, float]] = {}

    def meets(space: SplineSpace) -> bool:
        if space not in made:
            axis = space.axis()
            samples = evaluate(axis.points, axis.points)
            subspace = None
            if conditions is not None:
                subspace = solve_conditions(conditions(axis, axis), pole_metric(axis, axis, samples.shape[-1]))
            surface = fit_surface(samples, axis, axis, subspace)
            made[space] = surface, measure(surface)
        return made[space][1] <= tol

    upwards = (i for i in range(first_candidate_index(evaluate, tol, spaces), len(spaces)) if meets(spaces[i]))
    found = next(upwards, None)
    if found is None:
        best = min(made, key=lambda space: made[space][1])
    else:
        found = _lowest_meeting_index(found, lambda i: meets(spaces[i]))
        best = spaces[found]
    trials = tuple(FitTrial(space, deviation) for space, (_, deviation) in made.items())
    return AdaptiveFit(made[best][0], best, made[best][1], tol, trials)


REQUIRED_MISSES = 2
"""Smaller candidates that must miss: an even degree may beat the next odd one (nodal Schwarz P: 12 and 13)."""

FIRST_GUESS_TOL_FACTOR = 20.0
"""The first guess loses this many tolerances by its degree alone: two or three degrees below the answer."""


def _lowest_meeting_index(found: int, meets: Callable[[int], bool]) -> int:
    """The index, at most `found`, below which MISSES in a row do not meet."""
    for lower in range(found - 1, max(found - 1 - REQUIRED_MISSES, -1), -1):
        if meets(lower):
            return _lowest_meeting_index(lower, meets)
    return found


def first_candidate_index(evaluate: GridEvaluator, tol: float, spaces: Sequence[SplineSpace]) -> int:
    """Index of the first one-span space that loses no more than LOW tol by its degree alone; of the last space if none does."""
    top = max((space.degree for space in spaces if space.spans == 1), default=0)
    if top == 0:
        return 0
    axis = SplineSpace(top).axis()
    coordinates = np.linalg.norm(least_squares_coordinates(evaluate(axis.points, axis.points), axis, axis), axis=-1)
    # The normalised Legendre polynomial of degree i is no larger than sqrt(2 i + 1).
    size = np.sqrt(2 * np.arange(top + 1) + 1)
    largest = coordinates * np.multiply.outer(size, size)
    for i, space in enumerate(spaces):
        kept = largest[: space.degree + 1, : space.degree + 1].sum()
        if space.spans == 1 and largest.sum() - kept <= FIRST_GUESS_TOL_FACTOR * tol:
            return i
    return len(spaces) - 1
