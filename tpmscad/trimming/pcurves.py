"""Parameter curves of space curves on the body's quadrics: with the curve's parameter, interpolated until near enough."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np

from tpmscad.patches.carriers import Plane, Quadric
from tpmscad.splines.bspline import Curve, design
from tpmscad.trimming.fitting import DEGREE, SPANS, interpolation
from tpmscad.trimming.regions import Region, repeated
from tpmscad.trimming.tool import Array, TrimmingError

CHECKS = 4
"""Points between knots where the deviation is measured."""


def parameter_curve(
    curve: Callable[[Array], Array], span: Array, region: Region, tol: float, least: int
) -> tuple[Curve, float]:
    """The curve in the face's (u, v) that runs with `curve` over the span, and how far it is from it at most.

    least: spans to begin with.

    TrimmingError where `tol` is not reached: a curve that passes a pole or an apex too near.
    """
    low, high = float(span[0]), float(span[1])
    error = np.inf
    for spans in [s for s in SPANS if s >= least] or SPANS[-1:]:
        knots, sites, inverse, checks, rows = _space(spans)
        uv = _in_one_piece(region.carrier, curve(low + (high - low) * sites))
        uv = uv + (repeated(uv[len(uv) // 2], region.carrier, region.middle) - uv[len(uv) // 2])
        poles = inverse @ uv
        u, v = (rows @ poles).T
        points = curve(low + (high - low) * checks)
        error = float(np.linalg.norm(region.carrier(u, v) - points, axis=1).max())
        if error < tol + np.abs(region.carrier.distance(points)).max():  # which no parameters can mend
            return Curve(poles, low + (high - low) * knots, DEGREE), error
    raise TrimmingError(
        f"a cut's parameters on the body are still {error:.3g} off, near {curve(np.array([low]))[0].round(6)}"
    )


def _in_one_piece(carrier: Plane | Quadric, points: Array) -> Array:
    uv = carrier.parameters(points)
    for axis, period in enumerate(carrier.period):
        if period:
            uv[:, axis] = np.unwrap(uv[:, axis], period=period)
    return uv


@lru_cache(maxsize=16)
def _space(spans: int) -> tuple[Array, Array, Array, Array, Array]:
    """Knots, Greville sites and the inverse of interpolation there; places between, and the basis there."""
    knots, sites, inverse = interpolation(spans)
    checks = np.linspace(0.0, 1.0, CHECKS * spans + 1)
    return knots, sites, inverse, checks, design(knots, DEGREE, checks)
