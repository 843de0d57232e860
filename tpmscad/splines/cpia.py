"""Constrained progressive-iterative approximation (CPIA): the iteration that makes the program's control nets.

PIA and LSPIA (see `benchmarks/progressive_iteration.py`, whose notation is used here) let the poles P follow the differences
Q - B P between data and surface.

CPIA asks in addition for linear conditions A P = b, here continuity with the neighbouring patches.
TPMS2STEP (eqs. 14-18) adds half the defects of the conditions to PIA's differences,

    P <- P + (Q - B P) + C P / 2,

with C P the defects. This printed update diverges: its spectral radius is 2.8 or more in each of the 36 readings of which rows
the defects are added to, with which sign and in which order (`benchmarks/cpia.py`). Proposition 1 there bounds powers of a
sum of matrices that do not commute as if they did. Where damping of C makes the iteration converge, its fixed point solves
Q - B P + C P / 2 = 0, which is neither the least-squares fit nor a solution of the conditions.

Here the difference is not corrected but projected. The step is LSPIA's with W the weights of the data,

    x <- x + mu Pi B^T W (Q - B x),     x_0 in S = {x : A x = b},     Pi the orthogonal projector on ker A,

so that every iterate satisfies the conditions to round-off. `AffineSubspace` holds S and Pi.

*Convergence.* f(x) = |Q - B x|_W^2 / 2 is quadratic with Hessian M = B^T W B, positive definite if the data determine the
surface. On S its unique minimiser x* satisfies Pi B^T W (Q - B x*) = 0, so that the error e = x - x*, which lies in ker A, obeys
e <- (I - mu Pi M Pi) e. Pi M Pi is symmetric on ker A, and by Courant-Fischer its eigenvalues there lie between the extreme
eigenvalues a and b of M. With mu = 2 / (a + b) therefore

    |e_k| <= q^k |e_0|,      q = (b - a) / (b + a) < 1.

*Stopping.* Pi B^T W (Q - B x) = -Pi M Pi e gives the proven bound |x - x*| <= |Pi B^T W (Q - B x)| / a, which needs no
knowledge of x*.

*Rate.* It depends on what the coordinates x are. With the poles themselves it is LSPIA's, close to 1: a Bernstein basis of
degree 10 in two directions has q = 1 - 3e-11. With coordinates orthonormal in L2 (`gauss_axis`; for the poles the step is
preconditioned by the inverse Gram matrices) M is a quadrature of the identity on the data's grid: degree 10 and 33 x 33
data give q = 0.74 for equal steps and 0.10 for cosine steps. Chebyshev's semi-iteration on [a, b] turns q^k into
2 r^k / (1 + r^2k), r = q / (1 + sqrt(1 - q^2)): r = 0.44 and 0.05. Where the data lie at the Gauss points of the axes, M = I
and the first step reaches the limit.

*Metric.* A subspace may measure distances by |D x| instead of |x| (`pole_metric`). With M = I the same iteration, projected
orthogonally in that metric, has x* - x = Pi_D B^T W (Q - B x): its limit is the point of S nearest in |D .| to the
least-squares fit of the whole space. For other data a metric is refused.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import count

import numpy as np

from tpmscad._typing import Array
from tpmscad.splines.affine_subspace import AffineSubspace
from tpmscad.splines.basis import apply_bases
from tpmscad.splines.bspline import BSplineSurface
from tpmscad.splines.quadrature import trapezoidal_weights
from tpmscad.splines.spline_axis import SplineAxis
from tpmscad.splines.surface_fit import (
    coordinates_from_surface,
    gram_eigenvalue_bounds,
    surface_from_coordinates,
)

EIGENVALUE_RTOL = 1e-14
"""Relative spread below which all eigenvalues count as equal: one step is the solution, and Chebyshev's recurrence would divide
by the spread."""

ORTHONORMAL_RTOL = 1e-10
"""Relative spread of the eigenvalues up to which coordinates count as orthonormal on the data."""

LIMIT_RTOL = 1e-12
"""Default bound at which the iteration stops, relative to the norm of the data: near round-off."""

ROUND_OFF_RTOL = 100 * float(np.finfo(float).eps)
"""Round-off of a residual relative to the norm of the data, which a proven bound on a computed net must include."""


@dataclass(frozen=True, slots=True)
class NetConvergence:
    """What CPIA proves of a control net.

    Parameters
    ----------
    iterations : int
        Steps of the iteration.
    bound : float
        Proven upper bound on the distance between the surface and the limit of the iteration, at equal parameters, in the
        unit of the data; round-off included.

    Examples
    --------
    >>> from tpmscad.splines import NetConvergence
    >>> NetConvergence(1, 0.25).scaled(2.0).bound
    0.5
    """

    iterations: int
    bound: float

    def scaled(self, factor: float) -> NetConvergence:
        """The same for the net scaled by a factor."""
        return NetConvergence(self.iterations, factor * self.bound)

    @staticmethod
    def worst(members: Iterable[NetConvergence]) -> NetConvergence:
        """The greatest number of iterations and the greatest bound of several nets."""
        listed = list(members)
        return NetConvergence(max(c.iterations for c in listed), max(c.bound for c in listed))


@dataclass(frozen=True, slots=True, eq=False)
class DataGrid:
    """A tensor grid of data.

    Parameters
    ----------
    u, v : ndarray, shape (m,), (n,)
        Parameters.
    weights_u, weights_v : ndarray, shape (m,), (n,)
        Positive weights; a datum has the product of its two weights.

    Examples
    --------
    >>> import numpy as np
    >>> from tpmscad.splines import DataGrid
    >>> grid = DataGrid(np.linspace(0, 1, 3), np.linspace(0, 1, 4), np.ones(3), np.ones(4))
    """

    u: Array
    v: Array
    weights_u: Array
    weights_v: Array


def axis_grid(axis_u: SplineAxis, axis_v: SplineAxis) -> DataGrid:
    """Grid of the sample points of two axes, on which `gauss_axis` and `sampled_axis` coordinates are orthonormal."""
    return DataGrid(axis_u.points, axis_v.points, axis_u.weights, axis_v.weights)


def trapezoidal_grid(u: Array, v: Array) -> DataGrid:
    """Grid whose weights are those of the trapezoidal rule, so that sums over it approach integrals.

    Parameters
    ----------
    u, v : ndarray, shape (m,), (n,)
        Ascending parameters.

    Returns
    -------
    DataGrid
        The grid.

    Examples
    --------
    >>> import numpy as np
    >>> from tpmscad.splines import trapezoidal_grid
    >>> trapezoidal_grid(np.linspace(0, 1, 3), np.linspace(0, 1, 2)).weights_u
    array([0.25, 0.5 , 0.25])
    """
    return DataGrid(u, v, trapezoidal_weights(u), trapezoidal_weights(v))


@dataclass(frozen=True, slots=True, eq=False)
class CpiaSolution:
    """Result of CPIA in coordinates (U, V, D).

    `bounds[k]` is the proven bound on |x_k - x*|, `data_norm` the norm of the weighted data.
    """

    coordinates: Array
    converged: bool
    bounds: Array
    data_norm: float

    @property
    def iterations(self) -> int:
        """Number of steps taken."""
        return len(self.bounds) - 1

    def convergence(self, max_norm_factor: float) -> NetConvergence:
        """Iterations and the bound in the maximum norm, for a basis with |S(u, v)| <= max_norm_factor |x|."""
        bound = float(self.bounds[-1]) + ROUND_OFF_RTOL * self.data_norm
        return NetConvergence(self.iterations, max_norm_factor * bound)


@dataclass(frozen=True, slots=True, eq=False)
class CpiaResult:
    """Result of `fit_cpia`.

    Parameters
    ----------
    surface : BSplineSurface
        Surface of the last iterate. It satisfies the conditions to round-off.
    converged : bool
        Whether the bound asked for was reached.
    iterations : int
        Number of steps.
    rate : float
        Proven factor per step; with Chebyshev acceleration the asymptotic one.
    bounds : ndarray, shape (iterations + 1,)
        Proven bounds on the distance of each iterate from the limit, in the norm of the coordinates. For `gauss_axis` this is
        the L2 norm of the surface over its domain.
    convergence : NetConvergence
        Iterations and the bound of the last iterate in the maximum norm, round-off included.
    """

    surface: BSplineSurface
    converged: bool
    iterations: int
    rate: float
    bounds: Array
    convergence: NetConvergence


def fit_cpia(
    samples: Array,
    grid: DataGrid,
    axis_u: SplineAxis,
    axis_v: SplineAxis,
    subspace: AffineSubspace,
    *,
    tol: float | None = None,
    max_iterations: int = 1000,
    chebyshev: bool = True,
    start: BSplineSurface | None = None,
) -> CpiaResult:
    """Least-squares fit under linear conditions, by constrained progressive-iterative approximation.

    Parameters
    ----------
    samples : ndarray, shape (m, n, D)
        Data on the grid.
    grid : DataGrid
        Parameters and weights of the data.
    axis_u, axis_v : SplineAxis
        Spline spaces; their coordinates are the unknowns.
    subspace : AffineSubspace
        The conditions on the coordinates.
    tol : float, optional
        Bound on the distance from the limit, in the norm of the coordinates, at which the iteration stops. By default
        `LIMIT_RTOL` times the norm of the data.
    max_iterations : int, optional
        Greatest number of steps.
    chebyshev : bool, optional
        Whether the iteration is accelerated.
    start : BSplineSurface, optional
        A surface with the knots of the axes, which is projected on the subspace. By default the iteration starts at the point
        of the subspace nearest to the origin.

    Returns
    -------
    CpiaResult
        Surface, iterations and proven bounds. `converged` is False where `max_iterations` did not suffice.

    Raises
    ------
    ValueError
        If the subspace has a metric of its own and the coordinates are not orthonormal on the data.

    Notes
    -----
    The module's documentation proves the convergence and the bound; it also says why the update printed in TPMS2STEP
    (eqs. 14-18) diverges.

    Examples
    --------
    >>> import numpy as np
    >>> from tpmscad.splines import bezier_knots, fit_cpia, gauss_axis, trapezoidal_grid, unconstrained_subspace
    >>> axis = gauss_axis(bezier_knots(2), 2)
    >>> t = np.linspace(0, 1, 9)
    >>> samples = np.stack(np.broadcast_arrays(t[:, None], t, t[:, None] * t), axis=-1)
    >>> result = fit_cpia(samples, trapezoidal_grid(t, t), axis, axis, unconstrained_subspace(27))
    >>> result.converged, bool(np.allclose(result.surface(0.3, 0.7), [0.3, 0.7, 0.21]))
    (True, True)
    """
    basis_u, basis_v = weighted_bases(grid, axis_u, axis_v)
    solution = solve_cpia(
        weighted_data(samples, grid),
        basis_u,
        basis_v,
        subspace,
        tol=tol,
        max_iterations=max_iterations,
        chebyshev=chebyshev,
        start=None if start is None else coordinates_from_surface(start, axis_u, axis_v),
    )
    return CpiaResult(
        surface=surface_from_coordinates(solution.coordinates, axis_u, axis_v),
        converged=solution.converged,
        iterations=solution.iterations,
        rate=contraction_factor(*gram_eigenvalue_bounds(basis_u, basis_v), chebyshev=chebyshev),
        bounds=solution.bounds,
        convergence=solution.convergence(axis_u.max_norm_factor * axis_v.max_norm_factor),
    )


def solve_cpia(
    data: Array,
    basis_u: Array,
    basis_v: Array,
    subspace: AffineSubspace,
    *,
    tol: float | None = None,
    max_iterations: int = 1000,
    chebyshev: bool = True,
    start: Array | None = None,
) -> CpiaSolution:
    """CPIA on weighted data (m, n, D) and weighted design matrices (m, U), (n, V), until the bound is at most `tol`.

    D may gather several surfaces: a subspace without conditions keeps them independent.
    """
    norm = float(np.linalg.norm(data))
    limit = LIMIT_RTOL * norm if tol is None else tol
    bounds: list[float] = []
    coordinates = np.zeros(0)
    for step, (x, bound) in enumerate(_iterate(data, basis_u, basis_v, subspace, chebyshev, start)):
        coordinates = x
        bounds.append(bound)
        if bound <= limit or step == max_iterations:
            break
    return CpiaSolution(coordinates, bounds[-1] <= limit, np.array(bounds), norm)


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
    """Endless iterates of CPIA as coordinates (U, V, D), each with the proven bound on its distance from the limit."""
    first = None if start is None else coordinates_from_surface(start, axis_u, axis_v)
    return _iterate(weighted_data(samples, grid), *weighted_bases(grid, axis_u, axis_v), subspace, chebyshev, first)


def _iterate(
    data: Array, basis_u: Array, basis_v: Array, subspace: AffineSubspace, chebyshev: bool, start: Array | None
) -> Iterator[tuple[Array, float]]:
    shape = (basis_u.shape[1], basis_v.shape[1], data.shape[2])
    low, high = gram_eigenvalue_bounds(basis_u, basis_v)
    middle, spread = (high + low) / 2, (high - low) / 2
    if subspace.metric is not None and spread > ORTHONORMAL_RTOL * middle:
        raise ValueError(
            f"a subspace with a metric needs coordinates that are orthonormal on the data; the eigenvalues of their Gram "
            f"matrix lie between {low:.6g} and {high:.6g}"
        )
    x = subspace.project(np.zeros(np.prod(shape)) if start is None else start.ravel()).reshape(shape)
    step, factor = np.zeros(shape), 0.0
    for k in count():
        difference = data - apply_bases(basis_u, x, basis_v)
        gradient = apply_bases(basis_u.T, difference, basis_v.T)
        gradient = subspace.project_direction(gradient.ravel()).reshape(shape)
        yield x, subspace.length(gradient.ravel()) / low
        if not chebyshev or k == 0 or spread < EIGENVALUE_RTOL * middle:
            step, factor = gradient / middle, spread / middle
        else:
            # The three-term recurrence of the Chebyshev polynomials on [low, high] (Saad, Iterative Methods, alg. 12.1).
            following = 1 / (2 * middle / spread - factor)
            step, factor = following * factor * step + 2 * following / spread * gradient, following
        x = subspace.project((x + step).ravel()).reshape(shape)


def contraction_factor(low: float, high: float, *, chebyshev: bool) -> float:
    """q, or r with Chebyshev's acceleration, from the extreme eigenvalues."""
    q = (high - low) / (high + low)
    return q / (1 + float(np.sqrt(1 - q**2))) if chebyshev else q


def weighted_data(samples: Array, grid: DataGrid) -> Array:
    """Samples (m, n, D) times the roots of their weights."""
    return np.sqrt(np.multiply.outer(grid.weights_u, grid.weights_v))[..., None] * samples


def weighted_bases(grid: DataGrid, axis_u: SplineAxis, axis_v: SplineAxis) -> tuple[Array, Array]:
    """Design matrices (m, U), (n, V) at the grid, rows times the roots of the weights."""
    return (
        np.sqrt(grid.weights_u)[:, None] * axis_u.design_matrix(grid.u),
        np.sqrt(grid.weights_v)[:, None] * axis_v.design_matrix(grid.v),
    )
