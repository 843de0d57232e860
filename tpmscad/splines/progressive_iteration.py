"""Progressive-iterative approximation: the poles follow the differences between data and surface, no system is solved.

PIA (Lin, Wang, Dong 2004; TPMS2STEP, eqs. 7-9) has one datum per pole: P <- P + (Q - B P). A totally positive basis with an
invertible collocation matrix B has its eigenvalues in (0, 1], so the error contracts by 1 - lambda_min and P -> B^-1 Q.

LSPIA (Deng, Lin 2014) has more data than poles: P <- P + mu B^T (Q - B P) is gradient descent on |Q - B P|^2 / 2 and converges
to the least-squares poles for 0 < mu < 2 / lambda_max(B^T B), fastest with mu = 2 / (lambda_min + lambda_max), by the factor
(lambda_max - lambda_min) / (lambda_max + lambda_min) per step.

Both work on tensor grids one direction at a time; extreme eigenvalues of the tensor product are products of the factors'.
Iterations are endless generators of poles (U, V, D), the starting poles first: the caller decides when to stop.

Constrained progressive-iterative approximation (CPIA) in a form that converges, to the constrained least-squares fit.

TPMS2STEP (eqs. 14-18) adds the defects of the continuity conditions to PIA's differences; that iteration need not converge
(benchmarks/cpia.py) nor keep the conditions. Here the step is LSPIA's, projected on the conditions:

    x <- x + mu Pi B^T W (Q - B x),     x_0 in S = {x : A x = b},     Pi the orthogonal projector on ker A,

so that every iterate keeps the conditions to round-off. `Subspace` holds S and Pi.

**Proof of convergence.** f(x) = |Q - B x|_W^2 / 2 is quadratic with Hessian M = B^T W B, positive definite if the samples
determine the surface. On S its only minimiser x* satisfies Pi B^T W (Q - B x*) = 0, so the error e = x - x*, which lies in
ker A, obeys e <- (I - mu Pi M Pi) e. Pi M Pi is symmetric on ker A, and by Courant-Fischer its eigenvalues there lie between
the extreme ones a, b of M. With mu = 2 / (a + b) therefore

    |e_k| <= q^k |e_0|,      q = (b - a) / (b + a) < 1.

Also Pi B^T W (Q - B x) = -Pi M Pi e gives |x - x*| <= |Pi B^T W (Q - B x)| / a: the stopping rule needs no knowledge of x*.

**Rate.** It depends on the coordinates that x are. With the poles themselves it is LSPIA's, close to 1 (a Bernstein basis of
degree 10 in two directions: 1 - 3e-11). With coordinates that are orthonormal in L2 (`gauss_axis`; for the poles the step is
preconditioned by the inverse of the two Gram matrices) M is a quadrature of the identity on the data's own grid: degree 10 and
33 x 33 data give q = 0.74 for equal steps and 0.10 for cosine ones. Chebyshev's semi-iteration over [a, b] makes
2 r^k / (1 + r^2k), r = q / (1 + sqrt(1 - q^2)), of q^k: r = 0.44 and 0.05.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import count

import numpy as np

from tpmscad._typing import Array
from tpmscad.splines.affine_subspace import AffineSubspace
from tpmscad.splines.bspline import BSplineSurface
from tpmscad.splines.quadrature import trapezoidal_weights
from tpmscad.splines.spline_axis import SplineAxis
from tpmscad.splines.surface_fit import coordinates_from_surface, surface_from_coordinates


def iterate_pia(samples: Array, basis_u: Array, basis_v: Array) -> Iterator[Array]:
    """Poles that come to interpolate the samples (U, V, D), from the samples themselves.

    basis_u (U, U) and basis_v (V, V) hold the basis functions (columns) at the samples' parameters (rows).
    """
    poles = samples
    while True:
        yield poles
        poles = poles + (samples - _apply_bases(basis_u, poles, basis_v))


def pia_convergence_rate(basis_u: Array, basis_v: Array) -> float:
    """The factor by which PIA's error contracts in the long run: the spectral radius of I - B."""
    values_u, values_v = np.linalg.eigvals(basis_u), np.linalg.eigvals(basis_v)
    return float(np.abs(1 - np.multiply.outer(values_u, values_v)).max())


def iterate_lspia(samples: Array, basis_u: Array, basis_v: Array, start: Array | None = None) -> Iterator[Array]:
    """Poles (U, V, D) that come to fit the samples (m, n, D) in least squares, with the best constant mu.

    basis_u (m, U) and basis_v (n, V) as for `pia`; from zero poles unless told.
    """
    shape = (basis_u.shape[1], basis_v.shape[1], samples.shape[2])
    low, high = gram_eigenvalue_bounds(basis_u, basis_v)
    mu = 2 / (low + high)
    poles = np.zeros(shape) if start is None else start
    while True:
        yield poles
        difference = samples - _apply_bases(basis_u, poles, basis_v)
        poles = poles + mu * _apply_bases(basis_u.T, difference, basis_v.T)


def gram_eigenvalue_bounds(basis_u: Array, basis_v: Array) -> tuple[float, float]:
    """Least and greatest eigenvalue of B^T B for B the tensor product of the two."""
    values = [np.linalg.svd(b, compute_uv=False) ** 2 for b in (basis_u, basis_v)]
    return float(values[0][-1] * values[1][-1]), float(values[0][0] * values[1][0])


def _apply_bases(left: Array, grid: Array, right: Array) -> Array:
    return np.einsum("mu,uvd,nv->mnd", left, grid, right, optimize=True)


@dataclass(frozen=True, slots=True, eq=False)
class DataGrid:
    """A tensor grid of data: parameters u (m,), v (n,) and a positive weight for each."""

    u: Array
    v: Array
    weights_u: Array
    weights_v: Array


def trapezoidal_grid(u: Array, v: Array) -> DataGrid:
    """A grid whose weights are the trapezoidal rule's, so that sums over it approach integrals."""
    return DataGrid(u, v, trapezoidal_weights(u), trapezoidal_weights(v))


@dataclass(frozen=True, slots=True, eq=False)
class CpiaResult:
    """What CPIA came to: `bounds[k]` is a proven bound on the distance of iterate k from the limit, in the coordinates' norm.

    In coordinates of `gauss_axis` that norm is the L2 norm of the surface over its domain. `rate` is the proven factor per
    step (for "chebyshev" the asymptotic one).
    """

    surface: BSplineSurface
    converged: bool
    iterations: int
    rate: float
    bounds: Array


def fit_cpia(
    samples: Array,
    grid: DataGrid,
    axis_u: SplineAxis,
    axis_v: SplineAxis,
    subspace: AffineSubspace,
    *,
    tol: float,
    max_iterations: int = 1000,
    chebyshev: bool = True,
    start: BSplineSurface | None = None,
) -> CpiaResult:
    """The least-squares fit to the samples (m, n, D) in the subspace, to `tol` in the coordinates' norm, by iteration.

    The coordinates, and those of the subspace's conditions, are the axes'. Starts from the given surface of the same knots,
    else from the subspace's point nearest to the origin. Not reaching `tol` is not an error: `converged` says so.
    """
    bounds: list[float] = []
    coordinates = np.zeros(0)
    steps = iterate_cpia(samples, grid, axis_u, axis_v, subspace, chebyshev=chebyshev, start=start)
    for step, (x, bound) in enumerate(steps):
        coordinates = x
        bounds.append(bound)
        if bound <= tol or step == max_iterations:
            break
    return CpiaResult(
        surface=surface_from_coordinates(coordinates, axis_u, axis_v),
        converged=bounds[-1] <= tol,
        iterations=len(bounds) - 1,
        rate=cpia_convergence_rate(grid, axis_u, axis_v, chebyshev=chebyshev),
        bounds=np.array(bounds),
    )


def cpia_convergence_rate(grid: DataGrid, axis_u: SplineAxis, axis_v: SplineAxis, *, chebyshev: bool) -> float:
    """The proven factor per step: q of the module's text, or r with Chebyshev's acceleration."""
    low, high = gram_eigenvalue_bounds(*_weighted_bases(grid, axis_u, axis_v))
    q = (high - low) / (high + low)
    return q / (1 + float(np.sqrt(1 - q**2))) if chebyshev else q


def iterate_cpia(
    samples: Array,
    grid: DataGrid,
    axis_u: SplineAxis,
    axis_v: SplineAxis,
    subspace: AffineSubspace,
    *,
    chebyshev: bool = True,
    start: BSplineSurface | None = None,
) -> Iterator[tuple[Array, float]]:
    """Endless iterates as coordinates (U, V, D), each with the proven bound on its distance from the limit."""
    if subspace.metric is not None:
        raise ValueError("CPIA goes to the least-squares fit: the subspace must not have a metric of its own")
    basis_u, basis_v = _weighted_bases(grid, axis_u, axis_v)
    root = np.sqrt(np.multiply.outer(grid.weights_u, grid.weights_v))[..., None]
    data = root * samples
    shape = (axis_u.n_coordinates, axis_v.n_coordinates, samples.shape[2])
    low, high = gram_eigenvalue_bounds(basis_u, basis_v)
    middle, spread = (high + low) / 2, (high - low) / 2
    first = np.zeros(shape) if start is None else coordinates_from_surface(start, axis_u, axis_v)
    x = subspace.project(first.ravel()).reshape(shape)
    step, factor = np.zeros(shape), 0.0
    for k in count():
        difference = data - np.einsum("mu,uvd,nv->mnd", basis_u, x, basis_v, optimize=True)
        gradient = np.einsum("mu,mnd,nv->uvd", basis_u, difference, basis_v, optimize=True)
        gradient = subspace.direction(gradient.ravel()).reshape(shape)
        yield x, float(np.linalg.norm(gradient)) / low
        if not chebyshev or k == 0 or spread < EIGENVALUE_RTOL * middle:
            step, factor = gradient / middle, spread / middle
        else:
            # The three-term recurrence of the Chebyshev polynomials on [low, high] (Saad, Iterative Methods, alg. 12.1).
            following = 1 / (2 * middle / spread - factor)
            step, factor = following * factor * step + 2 * following / spread * gradient, following
        x = subspace.project((x + step).ravel()).reshape(shape)


EIGENVALUE_RTOL = 1e-14
"""Eigenvalues this close are one: a single step is the solution, and the recurrence would divide by their difference."""


def _weighted_bases(grid: DataGrid, axis_u: SplineAxis, axis_v: SplineAxis) -> tuple[Array, Array]:
    return (
        np.sqrt(grid.weights_u)[:, None] * axis_u.design_matrix(grid.u),
        np.sqrt(grid.weights_v)[:, None] * axis_v.design_matrix(grid.v),
    )
