"""Univariate spline spaces in coordinates that are orthonormal on sample points: one direction of a tensor-product fit.

Bernstein and B-spline bases are ill-conditioned at high degree: the condition number of the Bernstein basis doubles with
every degree. Legendre polynomials have no such loss. Fits and their constraints are therefore solved for coordinates c with

    poles = to_poles @ c,      sum_i w_i S(t_i)^2 = |c|^2   for every spline S of the space,

in which least squares on the samples is an orthogonal projection. On one span the coordinates start from Legendre
polynomials and never pass through the Bernstein basis. Spaces of several spans are of low degree and start from B-splines.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import solve_triangular

from tpmscad._typing import Array
from tpmscad.splines.basis import design_matrix, knot_domain, legendre_basis, legendre_to_bernstein
from tpmscad.splines.knots import greville_abscissae
from tpmscad.splines.quadrature import composite_gauss_legendre

DIAGONAL_RANK_RTOL = 1e-12
"""Relative size below which a diagonal entry of a triangular factor counts as zero: round-off of a few hundred terms."""


@dataclass(frozen=True, slots=True, eq=False)
class SplineAxis:
    """One direction of a tensor-product fit: a spline space with sample points and coordinates.

    Made by `gauss_axis`, `sampled_axis` or `pole_axis`.

    Parameters
    ----------
    knots : ndarray, shape (n + degree + 1,)
        Knot vector with repetition.
    degree : int
        Polynomial degree.
    points, weights : ndarray, shape (m,)
        Sample points and their positive weights.
    basis_kind : {"legendre", "bspline"}
        The basis that the coordinates start from.
    to_basis, to_poles : ndarray, shape (n, n)
        Matrices from coordinates to coefficients in that basis and to poles.

    Examples
    --------
    >>> from tpmscad.splines import bezier_knots, gauss_axis
    >>> axis = gauss_axis(bezier_knots(3), 3)
    >>> axis.n_coordinates, axis.weighted_design_matrix().shape
    (4, (8, 4))
    """

    knots: Array
    degree: int
    points: Array
    weights: Array
    basis_kind: Literal["legendre", "bspline"]
    to_basis: Array
    to_poles: Array

    @property
    def n_coordinates(self) -> int:
        """Number of coordinates, which is the number of poles."""
        return len(self.knots) - self.degree - 1

    @property
    def domain(self) -> tuple[float, float]:
        """Ends of the parameter interval."""
        return knot_domain(self.knots, self.degree)

    @property
    def max_norm_factor(self) -> float:
        """A number c with |S(t)| <= c |x| for every spline S of coordinates x and every t of the domain.

        |S(t)| <= |phi(t)| |x| by the Cauchy-Schwarz inequality, with phi = basis @ to_basis. The orthonormal Legendre polynomials
        have sum (2 i + 1) = (degree + 1)^2 as the greatest sum of squares; B-splines are convex weights of the rows of to_basis.
        """
        if self.basis_kind == "legendre":
            return (self.degree + 1) * float(np.linalg.norm(self.to_basis, 2))
        return float(np.linalg.norm(self.to_basis, axis=1).max())

    def design_matrix(self, t: ArrayLike, order: int = 0) -> Array:
        """Values, or derivatives of the given order, at t (k,) for every coordinate: (k, n_coordinates)."""
        t = np.asarray(t, float)
        if self.basis_kind == "legendre":
            return legendre_basis(self.degree, self.domain, t, order) @ self.to_basis
        return design_matrix(self.knots, self.degree, t, order) @ self.to_basis

    def weighted_design_matrix(self) -> Array:
        """The design matrix at the sample points, rows times the roots of the weights: (m, n_coordinates)."""
        return np.sqrt(self.weights)[:, None] * self.design_matrix(self.points)


def gauss_axis(knots: ArrayLike, degree: int, oversampling: int = 4) -> SplineAxis:
    """Spline axis sampled at Gauss-Legendre points, in coordinates orthonormal in L2.

    Parameters
    ----------
    knots : array_like
        Knot vector with repetition.
    degree : int
        Polynomial degree.
    oversampling : int, optional
        Points per span beyond degree + 1.

    Returns
    -------
    SplineAxis
        The axis; least squares on its points is the continuous least-squares fit up to the quadrature error of the data.

    Examples
    --------
    >>> from tpmscad.splines import bezier_knots, gauss_axis
    >>> len(gauss_axis(bezier_knots(5), 5).points)
    10
    """
    knots = np.asarray(knots, float)
    points, weights = composite_gauss_legendre(np.unique(knots), degree + 1 + oversampling)
    return sampled_axis(knots, degree, points, weights)


def sampled_axis(knots: ArrayLike, degree: int, points: ArrayLike, weights: ArrayLike | None = None) -> SplineAxis:
    """Spline axis for given sample points, in coordinates orthonormal on them.

    Parameters
    ----------
    knots : array_like
        Knot vector with repetition.
    degree : int
        Polynomial degree.
    points : array_like, shape (m,)
        Sample points.
    weights : array_like, shape (m,), optional
        Positive weights; one by default.

    Returns
    -------
    SplineAxis
        The axis.

    Raises
    ------
    ValueError
        If the points don't determine the spline (Schoenberg-Whitney conditions).

    Examples
    --------
    >>> import numpy as np
    >>> from tpmscad.splines import bezier_knots, sampled_axis
    >>> sampled_axis(bezier_knots(2), 2, np.linspace(0, 1, 5)).n_coordinates
    3
    """
    knots, points = np.asarray(knots, float), np.asarray(points, float)
    weights = np.ones(len(points)) if weights is None else np.asarray(weights, float)
    spans = np.unique(knots[degree:-degree])
    kind: Literal["legendre", "bspline"] = "legendre" if len(spans) == 2 else "bspline"
    count = len(knots) - degree - 1
    legendre = kind == "legendre"
    basis = legendre_basis(degree, (knots[0], knots[-1]), points) if legendre else design_matrix(knots, degree, points)
    values = np.sqrt(weights)[:, None] * basis
    if len(points) < count:
        raise ValueError(f"{len(points)} sample points can't determine {count} poles")
    triangle = np.linalg.qr(values)[1]
    if np.min(np.abs(np.diag(triangle))) < DIAGONAL_RANK_RTOL * np.max(np.abs(np.diag(triangle))):
        raise ValueError("the sample points don't determine the spline: some span has too few of them")
    triangle *= np.sign(np.diag(triangle))[:, None]
    to_basis = solve_triangular(triangle, np.eye(count))
    to_poles = legendre_to_bernstein(degree) @ to_basis if legendre else to_basis
    return SplineAxis(knots, degree, points, weights, kind, to_basis, to_poles)


def pole_axis(knots: ArrayLike, degree: int) -> SplineAxis:
    """Spline axis whose coordinates are the poles themselves, sampled at the Greville abscissae.

    Parameters
    ----------
    knots : array_like
        Knot vector with repetition.
    degree : int
        Polynomial degree.

    Returns
    -------
    SplineAxis
        The axis. Its coordinates are not orthonormal.

    Examples
    --------
    >>> from tpmscad.splines import bezier_knots, pole_axis
    >>> pole_axis(bezier_knots(2), 2).points
    array([0. , 0.5, 1. ])
    """
    knots = np.asarray(knots, float)
    count = len(knots) - degree - 1
    return SplineAxis(
        knots, degree, greville_abscissae(knots, degree), np.ones(count), "bspline", np.eye(count), np.eye(count)
    )
