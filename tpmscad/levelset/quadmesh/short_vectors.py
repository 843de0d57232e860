"""Algebra of single vectors in space for compiled loops; the arguments are arrays (3,) or tuples of three numbers.

The sums are in the order of the array operations of `vectors`, so that a loop has the same bits as these.
"""

from __future__ import annotations

import numpy as np

from tpmscad._compiled_loops import njit_cached


@njit_cached
def difference_of(points, i, j):  # type: ignore[no-untyped-def]  # pragma: no cover
    """The vector from point i to point j of points (n, 3)."""
    return points[j, 0] - points[i, 0], points[j, 1] - points[i, 1], points[j, 2] - points[i, 2]


@njit_cached
def dot_of(a, b):  # type: ignore[no-untyped-def]  # pragma: no cover
    """The scalar product of two vectors."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit_cached
def dot_as_einsum(a, b):  # type: ignore[no-untyped-def]  # pragma: no cover
    """The scalar product of two vectors, summed in the order of `numpy.einsum`, whose vector units add every second term."""
    return (a[0] * b[0] + a[2] * b[2]) + a[1] * b[1]


@njit_cached
def norm_of(a):  # type: ignore[no-untyped-def]  # pragma: no cover
    """The length of a vector."""
    return np.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])


@njit_cached
def triple_product_of(a, b, c):  # type: ignore[no-untyped-def]  # pragma: no cover
    """The scalar product of a x b with c."""
    x, y, z = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
    return x * c[0] + y * c[1] + z * c[2]
