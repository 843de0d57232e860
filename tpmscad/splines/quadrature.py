"""Gauss-Legendre quadrature: rules on one interval, composite rules between breaks, tensor rules on the unit square.

A rule with n points integrates polynomials up to degree 2 n - 1 exactly. Finding the points costs more than using
them, so rules are cached; the arrays of a cached rule are read-only.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.polynomial.legendre import leggauss

from tpmscad._typing import Array


@lru_cache(maxsize=128)
def gauss_legendre(count: int) -> tuple[Array, Array]:
    """Points in [-1, 1] and weights, (count,) each, read-only."""
    points, weights = leggauss(count)
    return _read_only(points), _read_only(weights)


@lru_cache(maxsize=128)
def gauss_legendre_unit(count: int) -> tuple[Array, Array]:
    """Points in [0, 1] and weights, (count,) each, read-only."""
    points, weights = gauss_legendre(count)
    return _read_only(0.5 * (1 + points)), _read_only(0.5 * weights)


def composite_gauss_legendre(breaks: Array, count: int) -> tuple[Array, Array]:
    """Points and weights with `count` points between every two neighbours of the ascending breaks (n + 1,): (n count,) each."""
    points, weights = gauss_legendre(count)
    half = 0.5 * np.diff(breaks)[:, None]
    return (breaks[:-1, None] + half + half * points).ravel(), (half * weights).ravel()


def tensor_gauss_legendre(count_u: int, count_v: int) -> tuple[Array, Array, Array]:
    """Points u (m,), v (n,) in [0, 1] and the weights (m, n) of the tensor-product rule on the unit square."""
    (u, weights_u), (v, weights_v) = gauss_legendre_unit(count_u), gauss_legendre_unit(count_v)
    return u, v, np.outer(weights_u, weights_v)


def trapezoidal_weights(t: Array) -> Array:
    """Weights (n,) of the trapezoidal rule for ascending points t (n,)."""
    gaps = np.diff(t)
    return (np.append(gaps, 0.0) + np.append(0.0, gaps)) / 2


def _read_only(values: Array) -> Array:
    values.flags.writeable = False
    return values
