"""Constrained progressive-iterative approximation (CPIA) in a form that converges, to the constrained least-squares fit.

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

from tpmscad.splines.axis import Axis
from tpmscad.splines.bspline import Array, Surface
from tpmscad.splines.fitting import coordinates_of, surface
from tpmscad.splines.pia import gram_bounds
from tpmscad.splines.subspace import Subspace


@dataclass(frozen=True, slots=True, eq=False)
class Grid:
    """A tensor grid of data: parameters u (m,), v (n,) and a positive weight for each."""

    u: Array
    v: Array
    weights_u: Array
    weights_v: Array


def plain_grid(u: Array, v: Array) -> Grid:
    """A grid whose weights are the trapezoidal rule's, so that sums over it approach integrals."""
    return Grid(u, v, _trapezoid(u), _trapezoid(v))


@dataclass(frozen=True, slots=True, eq=False)
class Iteration:
    """What CPIA came to: `bounds[k]` is a proven bound on the distance of iterate k from the limit, in the coordinates' norm.

    In coordinates of `gauss_axis` that norm is the L2 norm of the surface over its domain. `rate` is the proven factor per
    step (for "chebyshev" the asymptotic one).
    """

    surface: Surface
    converged: bool
    iterations: int
    rate: float
    bounds: Array


def cpia(
    samples: Array,
    grid: Grid,
    axis_u: Axis,
    axis_v: Axis,
    subspace: Subspace,
    *,
    tol: float,
    max_iterations: int = 1000,
    chebyshev: bool = True,
    start: Surface | None = None,
) -> Iteration:
    """The least-squares fit to the samples (m, n, D) in the subspace, to `tol` in the coordinates' norm, by iteration.

    The coordinates, and those of the subspace's conditions, are the axes'. Starts from the given surface of the same knots,
    else from the subspace's point nearest to the origin. Not reaching `tol` is not an error: `converged` says so.
    """
    bounds: list[float] = []
    coordinates = np.zeros(0)
    steps = iterates(samples, grid, axis_u, axis_v, subspace, chebyshev=chebyshev, start=start)
    for step, (x, bound) in enumerate(steps):
        coordinates = x
        bounds.append(bound)
        if bound <= tol or step == max_iterations:
            break
    return Iteration(
        surface=surface(coordinates, axis_u, axis_v),
        converged=bounds[-1] <= tol,
        iterations=len(bounds) - 1,
        rate=cpia_rate(grid, axis_u, axis_v, chebyshev=chebyshev),
        bounds=np.array(bounds),
    )


def cpia_rate(grid: Grid, axis_u: Axis, axis_v: Axis, *, chebyshev: bool) -> float:
    """The proven factor per step: q of the module's text, or r with Chebyshev's acceleration."""
    low, high = gram_bounds(*_bases(grid, axis_u, axis_v))
    q = (high - low) / (high + low)
    return q / (1 + float(np.sqrt(1 - q**2))) if chebyshev else q


def iterates(
    samples: Array,
    grid: Grid,
    axis_u: Axis,
    axis_v: Axis,
    subspace: Subspace,
    *,
    chebyshev: bool = True,
    start: Surface | None = None,
) -> Iterator[tuple[Array, float]]:
    """Endless iterates as coordinates (U, V, D), each with the proven bound on its distance from the limit."""
    if subspace.metric is not None:
        raise ValueError("CPIA goes to the least-squares fit: the subspace must not have a metric of its own")
    basis_u, basis_v = _bases(grid, axis_u, axis_v)
    root = np.sqrt(np.multiply.outer(grid.weights_u, grid.weights_v))[..., None]
    data = root * samples
    shape = (axis_u.size, axis_v.size, samples.shape[2])
    low, high = gram_bounds(basis_u, basis_v)
    middle, spread = (high + low) / 2, (high - low) / 2
    first = np.zeros(shape) if start is None else coordinates_of(start, axis_u, axis_v)
    x = subspace.project(first.ravel()).reshape(shape)
    step, factor = np.zeros(shape), 0.0
    for k in count():
        difference = data - np.einsum("mu,uvd,nv->mnd", basis_u, x, basis_v, optimize=True)
        gradient = np.einsum("mu,mnd,nv->uvd", basis_u, difference, basis_v, optimize=True)
        gradient = subspace.direction(gradient.ravel()).reshape(shape)
        yield x, float(np.linalg.norm(gradient)) / low
        if not chebyshev or k == 0 or spread < EQUAL * middle:
            step, factor = gradient / middle, spread / middle
        else:
            # The three-term recurrence of the Chebyshev polynomials on [low, high] (Saad, Iterative Methods, alg. 12.1).
            following = 1 / (2 * middle / spread - factor)
            step, factor = following * factor * step + 2 * following / spread * gradient, following
        x = subspace.project((x + step).ravel()).reshape(shape)


EQUAL = 1e-14
"""Eigenvalues this close are one: a single step is the solution, and the recurrence would divide by their difference."""


def _bases(grid: Grid, axis_u: Axis, axis_v: Axis) -> tuple[Array, Array]:
    return (
        np.sqrt(grid.weights_u)[:, None] * axis_u.design(grid.u),
        np.sqrt(grid.weights_v)[:, None] * axis_v.design(grid.v),
    )


def _trapezoid(t: Array) -> Array:
    gaps = np.diff(t)
    return (np.append(gaps, 0.0) + np.append(0.0, gaps)) / 2
