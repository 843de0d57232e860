"""One direction of a tensor-product fit: a spline space in coordinates that are orthonormal on its sample points.

Bernstein and B-spline bases lose digits with the degree (the condition number of a Bernstein basis doubles with every degree),
Legendre polynomials do not. Fits and their constraints are therefore solved for coordinates c with

    poles = to_poles @ c,      sum_i w_i (S(t_i))^2 = |c|^2   for every spline S of the space,

in which least squares on the samples is an orthogonal projection. On one span the coordinates start from Legendre
polynomials and never pass through the Bernstein basis; several spans are of low degree and start from B-splines.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import comb
from typing import Literal

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import ArrayLike
from scipy.linalg import solve_triangular

from tpmscad._typing import Array
from tpmscad.splines.bspline import design_matrix


@dataclass(frozen=True, slots=True, eq=False)
class SplineAxis:
    """Knots and degree of one direction, sample points and weights (m,), and coordinates: basis @ to_basis, (n,) of them."""

    knots: Array
    degree: int
    points: Array
    weights: Array
    basis: Literal["legendre", "bspline"]
    to_basis: Array
    to_poles: Array

    @property
    def size(self) -> int:
        """The number of coordinates, and of poles."""
        return len(self.knots) - self.degree - 1

    @property
    def domain(self) -> tuple[float, float]:
        return float(self.knots[self.degree]), float(self.knots[-self.degree - 1])

    def design(self, t: ArrayLike, order: int = 0) -> Array:
        """Value, or derivative of the given order, at t (k,) for every coordinate: (k, size)."""
        return _evaluate_basis(self.knots, self.degree, self.basis, np.asarray(t, float), order) @ self.to_basis

    def sampled(self) -> Array:
        """The design at the sample points with the square roots of the weights in it, orthonormal columns: (m, size)."""
        return np.sqrt(self.weights)[:, None] * self.design(self.points)


def gauss_axis(knots: ArrayLike, degree: int, oversampling: int = 4) -> SplineAxis:
    """An axis sampled at degree + 1 + oversampling Gauss-Legendre points per span: least squares is the continuous one."""
    knots = np.asarray(knots, float)
    points, weights = composite_gauss_legendre(knots, degree + 1 + oversampling)
    return sampled_axis(knots, degree, points, weights)


def sampled_axis(knots: ArrayLike, degree: int, points: ArrayLike, weights: ArrayLike | None = None) -> SplineAxis:
    """An axis for given sample points (m,) with positive weights (one each by default).

    Raises ValueError if the points don't determine the spline (Schoenberg-Whitney).
    """
    knots, points = np.asarray(knots, float), np.asarray(points, float)
    weights = np.ones(len(points)) if weights is None else np.asarray(weights, float)
    spans = np.unique(knots[degree:-degree])
    basis: Literal["legendre", "bspline"] = "legendre" if len(spans) == 2 else "bspline"
    count = len(knots) - degree - 1
    values = np.sqrt(weights)[:, None] * _evaluate_basis(knots, degree, basis, points, 0)
    if len(points) < count:
        raise ValueError(f"{len(points)} sample points can't determine {count} poles")
    triangle = np.linalg.qr(values)[1]
    if np.min(np.abs(np.diag(triangle))) < DIAGONAL_RANK_RTOL * np.max(np.abs(np.diag(triangle))):
        raise ValueError("the sample points don't determine the spline: some span has too few of them")
    triangle *= np.sign(np.diag(triangle))[:, None]
    to_basis = solve_triangular(triangle, np.eye(count))
    to_poles = legendre_to_bernstein(degree) @ to_basis if basis == "legendre" else to_basis
    return SplineAxis(knots, degree, points, weights, basis, to_basis, to_poles)


def pole_axis(knots: ArrayLike, degree: int) -> SplineAxis:
    """The axis whose coordinates are the poles themselves, sampled at the Greville points."""
    knots = np.asarray(knots, float)
    count = len(knots) - degree - 1
    return SplineAxis(
        knots, degree, greville_abscissae(knots, degree), np.ones(count), "bspline", np.eye(count), np.eye(count)
    )


DIAGONAL_RANK_RTOL = 1e-12
"""Relative size below which a diagonal entry of a triangular factor counts as zero: round-off of a few hundred terms."""


def bezier_knots(degree: int, domain: tuple[float, float] = (0.0, 1.0)) -> Array:
    """The knots of one polynomial span."""
    return np.repeat(np.array(domain, float), degree + 1)


def uniform_knots(
    spans: int, degree: int, smoothness: int | None = None, domain: tuple[float, float] = (0.0, 1.0)
) -> Array:
    """Clamped knots of equal spans, C^smoothness at the inner ones (degree - 1 by default)."""
    repeats = 1 if smoothness is None else degree - smoothness
    inner = np.linspace(*domain, spans + 1)[1:-1]
    return np.concatenate(
        [np.repeat(domain[0], degree + 1), np.repeat(inner, repeats), np.repeat(domain[1], degree + 1)]
    )


def greville_abscissae(knots: Array, degree: int) -> Array:
    """Averages of degree consecutive knots, one per pole."""
    return np.array([knots[i + 1 : i + degree + 1].mean() for i in range(len(knots) - degree - 1)])


def composite_gauss_legendre(knots: Array, count: int) -> tuple[Array, Array]:
    """Gauss-Legendre points and weights, `count` in every span of positive length."""
    breaks = np.unique(knots)
    nodes, weights = legendre.leggauss(count)
    half = np.diff(breaks)[:, None] / 2
    middle = (breaks[:-1] + breaks[1:])[:, None] / 2
    return (middle + half * nodes).ravel(), (half * weights).ravel()


def legendre_to_bernstein(degree: int) -> Array:
    """Bernstein coefficients of the Legendre polynomials normalised in L2 on [0, 1], one per column.

    Farouki, Legendre-Bernstein basis transformations, J. Comput. Appl. Math. 119 (2000), eq. 20; sums of integers, so exact.
    """
    n = degree
    matrix = np.empty((n + 1, n + 1))
    for i in range(n + 1):
        for j in range(n + 1):
            terms = range(max(0, i + j - n), min(i, j) + 1)
            total = sum((-1) ** (j + k) * comb(j, k) ** 2 * comb(n - j, i - k) for k in terms)
            matrix[i, j] = total / comb(n, i)
    return matrix * np.sqrt(2 * np.arange(n + 1) + 1)


def _evaluate_basis(knots: Array, degree: int, basis: str, t: Array, order: int) -> Array:
    if basis == "bspline":
        return design_matrix(knots, degree, t, order)
    low, high = knots[0], knots[-1]
    scale = 2 / (high - low)
    series = np.diag(np.sqrt(2 * np.arange(degree + 1) + 1))
    for _ in range(order):
        series = legendre.legder(series, scl=scale)
    return np.asarray(legendre.legval(scale * (t - low) - 1, series)).T
