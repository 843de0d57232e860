"""Progressive-iterative approximation: PIA for interpolation and LSPIA for least squares.

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
that makes the program's control nets is `cpia`.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from tpmscad._typing import Array
from tpmscad.splines.surface_fit import apply_bases


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

    Examples
    --------
    >>> import numpy as np
    >>> from itertools import islice
    >>> from tpmscad.splines import bezier_knots, design_matrix, iterate_pia
    >>> t = np.linspace(0, 1, 3)
    >>> basis = design_matrix(bezier_knots(2), 2, t)
    >>> samples = np.multiply.outer(t, t)[..., None]
    >>> *_, last = islice(iterate_pia(samples, basis, basis), 100)
    >>> bool(np.abs(last - samples).max() < 1e-12)  # the abscissae of a linear function are its poles
    True
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

    Examples
    --------
    >>> import numpy as np
    >>> from tpmscad.splines import pia_convergence_rate
    >>> pia_convergence_rate(np.eye(2), np.eye(3))
    0.0
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

    Examples
    --------
    >>> import numpy as np
    >>> from itertools import islice
    >>> from tpmscad.splines import bezier_knots, design_matrix, iterate_lspia
    >>> t = np.linspace(0, 1, 5)
    >>> basis = design_matrix(bezier_knots(1), 1, t)
    >>> *_, last = islice(iterate_lspia(np.ones((5, 5, 1)), basis, basis), 200)
    >>> bool(np.abs(last - 1).max() < 1e-12)
    True
    """
    shape = (basis_u.shape[1], basis_v.shape[1], samples.shape[2])
    low, high = gram_eigenvalue_bounds(basis_u, basis_v)
    mu = 2 / (low + high)
    poles = np.zeros(shape) if start is None else start
    while True:
        yield poles
        difference = samples - apply_bases(basis_u, poles, basis_v)
        poles = poles + mu * apply_bases(basis_u.T, difference, basis_v.T)


def gram_eigenvalue_bounds(basis_u: Array, basis_v: Array) -> tuple[float, float]:
    """Least and greatest eigenvalue of B^T B for the tensor product B of two design matrices."""
    values = [np.linalg.svd(b, compute_uv=False) ** 2 for b in (basis_u, basis_v)]
    return float(values[0][-1] * values[1][-1]), float(values[0][0] * values[1][0])
