"""Tensor-product B-splines as frozen values: poles, knots with repetition, degree. Nothing else is stored.

Evaluation is SciPy's (`scipy.interpolate.BSpline`), applied one parameter at a time. A surface's four sides are numbered
counter-clockwise in (u, v), and each runs counter-clockwise too, with the patch on its left:

    side 0: v = v0, u rising      side 1: u = u1, v rising      side 2: v = v1, u falling      side 3: u = u0, v falling
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import BSpline
from scipy.special import comb

from tpmscad._typing import Array
from tpmscad.rigid_motion import Motion


@dataclass(frozen=True, slots=True, eq=False)
class BSplineCurve:
    """A B-spline curve in D dimensions: poles (N, D), knots (N + degree + 1,) with repetition."""

    poles: Array
    knots: Array
    degree: int

    def __post_init__(self) -> None:
        if self.poles.ndim != 2 or len(self.knots) != len(self.poles) + self.degree + 1:
            raise ValueError(
                f"{self.poles.shape} poles of degree {self.degree} need {len(self.poles) + self.degree + 1} knots, "
                f"not {len(self.knots)}"
            )

    @property
    def domain(self) -> tuple[float, float]:
        return float(self.knots[self.degree]), float(self.knots[-self.degree - 1])

    def __call__(self, t: ArrayLike, order: int = 0) -> Array:
        """Points, or derivatives of the given order, at t: (..., D)."""
        return np.asarray(_spline(self.knots, self.poles, self.degree)(np.asarray(t, float), order))

    def reversed(self) -> BSplineCurve:
        """The same points on the same domain, run the other way."""
        low, high = self.domain
        return BSplineCurve(self.poles[::-1].copy(), (low + high) - self.knots[::-1], self.degree)

    def moved(self, motion: Motion) -> BSplineCurve:
        return BSplineCurve(motion.apply(self.poles), self.knots, self.degree)

    def scaled(self, factor: float) -> BSplineCurve:
        return BSplineCurve(factor * self.poles, self.knots, self.degree)


def line_segment(start: ArrayLike, end: ArrayLike, domain: tuple[float, float] = (0.0, 1.0)) -> BSplineCurve:
    """The straight segment as a curve of degree one on the given domain."""
    return BSplineCurve(np.array([start, end], float), np.repeat(np.array(domain, float), 2), 1)


@dataclass(frozen=True, slots=True, eq=False)
class BSplineSurface:
    """A tensor-product B-spline surface: poles (U, V, D), a knot vector with repetition and a degree for u and for v."""

    poles: Array
    knots_u: Array
    knots_v: Array
    degree_u: int
    degree_v: int

    def __post_init__(self) -> None:
        for axis, knots, degree in ((0, self.knots_u, self.degree_u), (1, self.knots_v, self.degree_v)):
            if self.poles.ndim != 3 or len(knots) != self.poles.shape[axis] + degree + 1:
                raise ValueError(
                    f"poles {self.poles.shape} of degree {degree} along {'uv'[axis]} need "
                    f"{self.poles.shape[axis] + degree + 1} knots, not {len(knots)}"
                )

    @property
    def domain(self) -> tuple[tuple[float, float], tuple[float, float]]:
        (pu, pv) = self.degree_u, self.degree_v
        return (
            (float(self.knots_u[pu]), float(self.knots_u[-pu - 1])),
            (float(self.knots_v[pv]), float(self.knots_v[-pv - 1])),
        )

    @property
    def corners(self) -> Array:
        """Parameters of the four corners in the order of the sides' starting points: (4, 2)."""
        (u0, u1), (v0, v1) = self.domain
        return np.array([[u0, v0], [u1, v0], [u1, v1], [u0, v1]])

    def __call__(self, u: ArrayLike, v: ArrayLike, du: int = 0, dv: int = 0) -> Array:
        """Points, or the mixed derivative of orders (du, dv), at the pairs (u, v), broadcast: (..., D)."""
        u, v = np.broadcast_arrays(np.asarray(u, float), np.asarray(v, float))
        rows = design_matrix(self.knots_u, self.degree_u, u.ravel(), du)
        columns = design_matrix(self.knots_v, self.degree_v, v.ravel(), dv)
        half = (rows @ self.poles.reshape(len(self.poles), -1)).reshape(len(rows), *self.poles.shape[1:])
        return (columns[:, None] @ half).reshape(*u.shape, self.poles.shape[2])

    def grid(self, u: ArrayLike, v: ArrayLike, du: int = 0, dv: int = 0) -> Array:
        """The same on the grid of all u with all v: (len(u), len(v), D)."""
        rows = design_matrix(self.knots_u, self.degree_u, np.asarray(u, float), du)
        columns = design_matrix(self.knots_v, self.degree_v, np.asarray(v, float), dv)
        half = (rows @ self.poles.reshape(len(self.poles), -1)).reshape(len(rows), *self.poles.shape[1:])
        return columns @ half

    def normal(self, u: ArrayLike, v: ArrayLike) -> Array:
        """S_u x S_v at the pairs (u, v), not normalised: (..., 3)."""
        return np.cross(self(u, v, 1, 0), self(u, v, 0, 1))

    def side(self, index: int) -> BSplineCurve:
        """The border curve of side 0..3, run counter-clockwise."""
        along_u = index in (0, 2)
        poles = {0: self.poles[:, 0], 1: self.poles[-1], 2: self.poles[:, -1], 3: self.poles[0]}[index]
        curve = BSplineCurve(
            poles.copy(), self.knots_u if along_u else self.knots_v, self.degree_u if along_u else self.degree_v
        )
        return curve if index in (0, 1) else curve.reversed()

    def side_pcurve(self, index: int) -> BSplineCurve:
        """The parameter curve of that side, on the domain of `side(index)` and run the same way."""
        corners = self.corners
        return line_segment(corners[index], corners[(index + 1) % 4], self.side(index).domain)

    def moved(self, motion: Motion) -> BSplineSurface:
        return BSplineSurface(motion.apply(self.poles), self.knots_u, self.knots_v, self.degree_u, self.degree_v)

    def scaled(self, factor: float) -> BSplineSurface:
        return BSplineSurface(factor * self.poles, self.knots_u, self.knots_v, self.degree_u, self.degree_v)


def design_matrix(knots: Array, degree: int, t: Array, order: int = 0) -> Array:
    """Values (or derivatives) of every basis function at t (n,): (n, len(knots) - degree - 1), dense.

    One-sided at the ends of the domain: the last point takes the last span. Patches have tens of basis functions, for
    which a dense matrix times the poles is faster than anything sparse. One span is evaluated as Bernstein polynomials, three
    times faster than by recurrence.
    """
    t = np.asarray(t, float)
    count = len(knots) - degree - 1
    if count == degree + 1 and knots[0] == knots[degree] and knots[-1] == knots[count]:
        return _bernstein(float(knots[0]), float(knots[-1]), degree, t, order)
    return np.asarray(_spline(knots, np.eye(count), degree)(t, order))


def _spline(knots: Array, coefficients: Array, degree: int) -> BSpline:
    """SciPy's spline without its checks, which take longer than a few points do."""
    return BSpline.construct_fast(np.asarray(knots, float), np.asarray(coefficients, float), degree)


def _bernstein(low: float, high: float, degree: int, t: Array, order: int) -> Array:
    """All Bernstein polynomials of the degree on [low, high], or their derivatives."""
    if order > degree:
        return np.zeros((len(t), degree + 1))
    rest = degree - order
    s = (t - low) / (high - low)
    values = comb(rest, np.arange(rest + 1)) * _powers(s, rest) * _powers(1 - s, rest)[:, ::-1]
    for k in range(rest + 1, degree + 1):  # the derivative of a polynomial's coefficients are its differences
        values = (k / (high - low)) * (np.pad(values, ((0, 0), (1, 0))) - np.pad(values, ((0, 0), (0, 1))))
    return values


def _powers(s: Array, degree: int) -> Array:
    """s^0 .. s^degree: (n, degree + 1)."""
    factors = np.repeat(s[:, None], degree + 1, axis=1)
    factors[:, 0] = 1.0
    return np.multiply.accumulate(factors, axis=1)
