"""Progressive-iterative approximation: the poles follow the differences between data and surface, no system is solved.

PIA (Lin, Wang, Dong 2004; TPMS2STEP, eqs. 7-9) has one datum per pole: P <- P + (Q - B P). A totally positive basis with an
invertible collocation matrix B has its eigenvalues in (0, 1], so the error contracts by 1 - lambda_min and P -> B^-1 Q.

LSPIA (Deng, Lin 2014) has more data than poles: P <- P + mu B^T (Q - B P) is gradient descent on |Q - B P|^2 / 2 and converges
to the least-squares poles for 0 < mu < 2 / lambda_max(B^T B), fastest with mu = 2 / (lambda_min + lambda_max), by the factor
(lambda_max - lambda_min) / (lambda_max + lambda_min) per step.

Both work on tensor grids one direction at a time; extreme eigenvalues of the tensor product are products of the factors'.
Iterations are endless generators of poles (U, V, D), the starting poles first: the caller decides when to stop.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from tpmscad.splines.bspline import Array


def pia(samples: Array, basis_u: Array, basis_v: Array) -> Iterator[Array]:
    """Poles that come to interpolate the samples (U, V, D), from the samples themselves.

    basis_u (U, U) and basis_v (V, V) hold the basis functions (columns) at the samples' parameters (rows).
    """
    poles = samples
    while True:
        yield poles
        poles = poles + (samples - _tensor(basis_u, poles, basis_v))


def pia_rate(basis_u: Array, basis_v: Array) -> float:
    """The factor by which PIA's error contracts in the long run: the spectral radius of I - B."""
    values_u, values_v = np.linalg.eigvals(basis_u), np.linalg.eigvals(basis_v)
    return float(np.abs(1 - np.multiply.outer(values_u, values_v)).max())


def lspia(samples: Array, basis_u: Array, basis_v: Array, start: Array | None = None) -> Iterator[Array]:
    """Poles (U, V, D) that come to fit the samples (m, n, D) in least squares, with the best constant mu.

    basis_u (m, U) and basis_v (n, V) as for `pia`; from zero poles unless told.
    """
    shape = (basis_u.shape[1], basis_v.shape[1], samples.shape[2])
    low, high = gram_bounds(basis_u, basis_v)
    mu = 2 / (low + high)
    poles = np.zeros(shape) if start is None else start
    while True:
        yield poles
        difference = samples - _tensor(basis_u, poles, basis_v)
        poles = poles + mu * _tensor(basis_u.T, difference, basis_v.T)


def gram_bounds(basis_u: Array, basis_v: Array) -> tuple[float, float]:
    """Least and greatest eigenvalue of B^T B for B the tensor product of the two."""
    values = [np.linalg.svd(b, compute_uv=False) ** 2 for b in (basis_u, basis_v)]
    return float(values[0][-1] * values[1][-1]), float(values[0][0] * values[1][0])


def _tensor(left: Array, grid: Array, right: Array) -> Array:
    return np.einsum("mu,uvd,nv->mnd", left, grid, right, optimize=True)
