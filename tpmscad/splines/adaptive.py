"""The fewest poles that meet a tolerance, found by refinement: candidates are fitted and measured until one meets it.

A first guess says only where the search starts. It comes from the Legendre coefficients of the surface, whose tail past a
degree bounds what is lost by leaving it out, and is low on purpose: small candidates are cheap, and the ones just below
the answer have to be tried in any case.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from tpmscad.splines.axis import Axis, bezier_knots, gauss_axis, uniform_knots
from tpmscad.splines.bspline import Array, Surface
from tpmscad.splines.continuity import Conditions
from tpmscad.splines.fitting import fit, free_coordinates
from tpmscad.splines.subspace import pole_metric, solve_conditions

GridPoints = Callable[[Array, Array], Array]
"""Points (m, n, D) of a surface on the grid of all u (m,) with all v (n,)."""


@dataclass(frozen=True, slots=True)
class Space:
    """A tensor-product spline space, the same along u and v on [0, 1]: equal spans, C^smoothness at inner knots."""

    degree: int
    spans: int = 1
    smoothness: int = 2

    @property
    def size(self) -> int:
        """Poles of a surface."""
        return (self.degree + 1 + (self.spans - 1) * (self.degree - self.smoothness)) ** 2

    def axis(self) -> Axis:
        if self.spans == 1:
            return gauss_axis(bezier_knots(self.degree), self.degree)
        return gauss_axis(uniform_knots(self.spans, self.degree, self.smoothness), self.degree)


BEZIER = tuple(Space(degree) for degree in range(5, 21))
"""One span: on analytic surfaces the fewest poles for every tolerance. STEP readers take degrees up to 25."""


@dataclass(frozen=True, slots=True)
class Trial:
    """One candidate and its measured deviation."""

    space: Space
    deviation: float


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """The fit with the fewest poles that met `tol`, or the nearest one there was; `trials` in the order they were made."""

    surface: Surface
    space: Space
    deviation: float
    tol: float
    trials: tuple[Trial, ...]

    @property
    def converged(self) -> bool:
        return self.deviation <= self.tol

    @property
    def poles(self) -> int:
        return self.space.size


def adapt(
    evaluate: GridPoints,
    measure: Callable[[Surface], float],
    tol: float,
    *,
    conditions: Callable[[Axis, Axis], Conditions] | None = None,
    ladder: Sequence[Space] = BEZIER,
) -> Fit:
    """Fit a surface on [0, 1]^2 with the fewest poles of the ladder for which measure(fit) <= tol.

    `conditions(axis_u, axis_v)` are what every candidate must satisfy, nearest in the `pole_metric`. Fewest means: the MISSES
    next smaller candidates were fitted and missed. If none meets tol, the best of those tried comes back.
    """
    spaces = sorted(set(ladder), key=lambda space: (space.size, space.degree))
    made: dict[Space, tuple[Surface, float]] = {}

    def meets(space: Space) -> bool:
        if space not in made:
            axis = space.axis()
            samples = evaluate(axis.points, axis.points)
            subspace = None
            if conditions is not None:
                subspace = solve_conditions(conditions(axis, axis), pole_metric(axis, axis, samples.shape[-1]))
            surface = fit(samples, axis, axis, subspace)
            made[space] = surface, measure(surface)
        return made[space][1] <= tol

    upwards = (i for i in range(first_guess(evaluate, tol, spaces), len(spaces)) if meets(spaces[i]))
    found = next(upwards, None)
    if found is None:
        best = min(made, key=lambda space: made[space][1])
    else:
        found = _lowest(found, lambda i: meets(spaces[i]))
        best = spaces[found]
    trials = tuple(Trial(space, deviation) for space, (_, deviation) in made.items())
    return Fit(made[best][0], best, made[best][1], tol, trials)


MISSES = 2
"""Smaller candidates that must miss: an even degree may beat the next odd one (nodal Schwarz P: 12 and 13)."""

LOW = 20.0
"""The first guess loses this many tolerances by its degree alone: two or three degrees below the answer."""


def _lowest(found: int, meets: Callable[[int], bool]) -> int:
    """The index, at most `found`, below which MISSES in a row do not meet."""
    for lower in range(found - 1, max(found - 1 - MISSES, -1), -1):
        if meets(lower):
            return _lowest(lower, meets)
    return found


def first_guess(evaluate: GridPoints, tol: float, spaces: Sequence[Space]) -> int:
    """Index of the first one-span space that loses no more than LOW tol by its degree alone; of the last space if none does."""
    top = max((space.degree for space in spaces if space.spans == 1), default=0)
    if top == 0:
        return 0
    axis = Space(top).axis()
    coordinates = np.linalg.norm(free_coordinates(evaluate(axis.points, axis.points), axis, axis), axis=-1)
    # The normalised Legendre polynomial of degree i is no larger than sqrt(2 i + 1).
    size = np.sqrt(2 * np.arange(top + 1) + 1)
    largest = coordinates * np.multiply.outer(size, size)
    for i, space in enumerate(spaces):
        kept = largest[: space.degree + 1, : space.degree + 1].sum()
        if space.spans == 1 and largest.sum() - kept <= LOW * tol:
            return i
    return len(spaces) - 1
