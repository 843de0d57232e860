"""The rounding of an edge with a great radius for how far the surface may move, to either side.

The greater of two fields, max(f, g), is (f + g) / 2 + |f - g| / 2, and rounded with another even function of f - g in place of
the half of its size. Here its second derivative is constant about the edge, then falls to minus half of that and goes back to
nothing: the edge moves in and what is beside it moves out, so that the volume stays what it was. The radius is 1.7 times that of
a cubic which only cuts the edge off. (An arc that is a circle at the sharpest edge has a greater radius there, but a lesser one
where one side is less steep than the other.)
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.interpolate import PPoly
from scipy.optimize import brentq

from tpmscad.blend.grid import Array
from tpmscad.fields.booleans import RoundedExtreme

BENDS = (1.0, 1.0, -0.5, 0.0)
"""The second derivative at the ends of the pieces, between which it is linear."""

LEAST, MOST = 1e-3, 2.0
"""How much steeper than the fields' difference the rounding may be."""


@dataclass(frozen=True, slots=True, eq=False)
class Profile:
    """What is added to the greater of two fields that differ by s (in widths): cubics `pieces` (4, 3) between `knots` (4,) from 0
    to 1, zero beyond.

    `height` at the edge itself, `depth` below the greater beside it: both above zero.
    """

    knots: Array
    pieces: Array
    height: float
    depth: float

    def __call__(self, s: Array) -> tuple[Array, Array]:
        """The values at s >= 0, and the slopes."""
        i = np.minimum(np.searchsorted(self.knots, s, side="right"), 3) - 1
        c3, c2, c1, c0 = self.pieces[:, i]
        t = s - self.knots[i]
        inside = s < 1.0
        value, slope = ((c3 * t + c2) * t + c1) * t + c0, (3 * c3 * t + 2 * c2) * t + c1
        return np.where(inside, value, 0.0), np.where(inside, slope, 0.0)


@cache
def neutral() -> Profile:
    """The profile that adds as much as it takes away: the solid's volume stays, as far as its sides are straight."""

    def added(further: float) -> float:
        made = _made(further)
        return float(PPoly(made.pieces, made.knots).integrate(0.0, 1.0))

    return _made(float(brentq(added, LEAST, MOST)))


def _made(further: float) -> Profile:
    """Steeper by `further` times the slope of half the difference, somewhere."""
    turn = 0.5 * further
    knots = np.array([0.0, 0.5, 0.5 + 3 * turn, 0.5 + 6 * turn])
    width = float(knots[-1])
    bends = np.stack([np.diff(BENDS) / np.diff(knots), BENDS[:-1]])
    whole = PPoly(bends, knots).antiderivative(2)
    # nothing is left where the profile ends, neither value nor slope
    value, slope = float(whole(width)), float(whole(width, 1))
    pieces = whole.c.copy()
    pieces[2] -= slope
    pieces[3] -= value + slope * (knots[:-1] - width)
    pieces *= (width ** np.arange(3, -1, -1) / width)[:, None]
    made = PPoly(pieces, knots / width)
    lowest = made(made.derivative().roots(extrapolate=False)).min()
    return Profile(knots / width, pieces, float(made(0.0)), float(-lowest))


@dataclass(frozen=True, slots=True, eq=False)
class Eased(RoundedExtreme):
    """The greater or lesser of two fields, rounded by a profile: twice continuously differentiable."""

    shape: Profile

    def profile(self, apart: Array) -> tuple[Array, Array]:
        return self.shape(apart)
