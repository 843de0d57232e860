"""Progressive-iterative approximation before CPIA: PIA for interpolation and LSPIA for least squares; the rate of CPIA.

The poles follow the differences between data and surface; no linear system is solved. Q (m, n, D) are data on a grid, B is
the design matrix of the tensor-product basis at their parameters, and B P are the points of the surface with poles P.

**PIA** (Lin, Wang, Dong 2004; TPMS2STEP, eqs. 7-9) has one datum per pole and adds the differences to the poles,

    P <- P + (Q - B P).

A totally positive basis with an invertible B has its eigenvalues in (0, 1]. The error contracts by 1 - lambda_min per
step, and P tends to the interpolant B^-1 Q.

**LSPIA** (Deng, Lin 2014) has more data than poles. P <- P + mu B^T (Q - B P) is gradient descent on |Q - B P|^2 / 2 and
converges to the least-squares poles for 0 < mu < 2 / lambda_max(B^T B). The best constant is mu = 2 / (a + b), with a and b the
extreme eigenvalues of B^T B; the error then contracts by (b - a) / (b + a) per step. Both iterations work on one direction of
the grid at a time, and the extreme eigenvalues of the tensor product are products of those of its factors. The constrained form
that makes the program's control nets is `tpmscad.splines.cpia`.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from tpmscad._typing import Array
from tpmscad.splines.cpia import DataGrid, contraction_factor, weighted_bases
from tpmscad.splines.spline_axis import SplineAxis
from tpmscad.splines.surface_fit import apply_bases, gram_eigenvalue_bounds


def iterate_pia(samples: Array, basis_u: Array, basis_v: Array) -> Iterator[Array]:
    """Iterates of PIA, which tend to the interpolant; an endless generator.

    Parameters
    ----------
    samples : ndarray, shape (U, V, D)
        Data on a grid, one per pole; also the starting poles.
    basis_u, basis_v : ndarray, shape (U, U), (V, V)
        Design matrices: basis functions in columns, parameters in rows.

    Yields
    ------
    ndarray, shape (U, V, D)
        Poles, the starting poles first.

    Notes
    -----
    Lin, Wang, Dong (2004); TPMS2STEP, eqs. 7-9.
    """
    poles = samples
    while True:
        yield poles
        poles = poles + (samples - apply_bases(basis_u, poles, basis_v))


def pia_convergence_rate(basis_u: Array, basis_v: Array) -> float:
    """Asymptotic factor by which PIA's error contracts per step.

    Parameters
    ----------
    basis_u, basis_v : ndarray, shape (U, U), (V, V)
        Design matrices at the parameters of the data.

    Returns
    -------
    float
        The spectral radius of I - B.
    """
    values_u, values_v = np.linalg.eigvals(basis_u), np.linalg.eigvals(basis_v)
    return float(np.abs(1 - np.multiply.outer(values_u, values_v)).max())


def iterate_lspia(samples: Array, basis_u: Array, basis_v: Array, start: Array | None = None) -> Iterator[Array]:
    """Iterates of LSPIA with the best constant step, which tend to the least-squares fit; an endless generator.

    Parameters
    ----------
    samples : ndarray, shape (m, n, D)
        Data on a grid.
    basis_u, basis_v : ndarray, shape (m, U), (n, V)
        Design matrices at the parameters of the data.
    start : ndarray, shape (U, V, D), optional
        Starting poles; zero by default.

    Yields
    ------
    ndarray, shape (U, V, D)
        Poles, the starting poles first.

    Notes
    -----
    Deng, Lin, Progressive and iterative approximation for least squares B-spline fitting, Computer-Aided Design 47 (2014).
    """
    shape = (basis_u.shape[1], basis_v.shape[1], samples.shape[2])
    low, high = gram_eigenvalue_bounds(basis_u, basis_v)
    mu = 2 / (low + high)
    poles = np.zeros(shape) if start is None else start
    while True:
        yield poles
        difference = samples - apply_bases(basis_u, poles, basis_v)
        poles = poles + mu * apply_bases(basis_u.T, difference, basis_v.T)


def cpia_convergence_rate(grid: DataGrid, axis_u: SplineAxis, axis_v: SplineAxis, *, chebyshev: bool) -> float:
    """Proven factor by which CPIA's error contracts per step.

    Parameters
    ----------
    grid : DataGrid
        Parameters and weights of the data.
    axis_u, axis_v : SplineAxis
        Spline spaces whose coordinates are the unknowns.
    chebyshev : bool
        Whether the iteration is accelerated.

    Returns
    -------
    float
        q of the module's documentation, or the asymptotic factor r with acceleration.
    """
    return contraction_factor(*gram_eigenvalue_bounds(*weighted_bases(grid, axis_u, axis_v)), chebyshev=chebyshev)
