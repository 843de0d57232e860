"""Vector algebra on arrays with the components first, (3, ...), and in compiled loops, and corner look-ups of polygon meshes.

Many short vectors are processed several times faster with the components along the first axis than along the last one.
`normalize` and the arguments named `vertices` or `corners` keep the usual layout, (..., 3) and (Q, n).
Functions of compiled loops take single vectors, arrays (3,) or tuples; they add in the order of the array operations, so that a
loop has the same bits as these.
"""

from __future__ import annotations

from typing import TypeVar

import numpy as np

from tpmscad._compiled_loops import njit_cached
from tpmscad._typing import Array, BoolArray, IntArray

Rows = TypeVar("Rows", Array, BoolArray, IntArray)

MIN_DIVISOR = 1e-300
"""Least divisor of a normalisation: a vector of length zero stays zero."""


def normalize(vectors: Array) -> Array:
    """Unit vectors along `vectors` (..., 3), components last."""
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), MIN_DIVISOR))


def dot(a: Array, b: Array) -> Array:
    """Scalar products of vectors (3, ...): (...)."""
    return np.asarray(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


def cross(a: Array, b: Array) -> Array:
    """Cross products of vectors (3, ...): (3, ...)."""
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def length(a: Array) -> Array:
    """Lengths of vectors (3, ...): (...)."""
    return np.asarray(np.sqrt(dot(a, a)))


def roll_next(a: Rows) -> Rows:
    """Cyclic successor of each entry along the last axis."""
    return np.concatenate([a[..., 1:], a[..., :1]], axis=-1)


def roll_previous(a: Array) -> Array:
    """Cyclic predecessor of each entry along the last axis."""
    return np.concatenate([a[..., -1:], a[..., :-1]], axis=-1)


def sines_between_sides(side: Array, size: Array, normals: Array) -> Array:
    """Signed sines (Q, n) of the corner angles of polygons with sides (3, Q, n) of lengths (Q, n); negative if reversed.

    A corner is reversed if the normal of its two sides opposes the surface normal (3, Q, n) there.
    """
    return np.asarray(
        dot(cross(side, -roll_previous(side)), normals) / np.maximum(size * roll_previous(size), MIN_DIVISOR)
    )


def corner_sines(vertices: Array, corners: IntArray, normals: Array) -> Array:
    """Signed sines (Q, n) of the corner angles of polygons (Q, n); `vertices` and `normals` are (V, 3)."""
    points = gather(vertices, corners)
    side = roll_next(points) - points
    return sines_between_sides(side, length(side), gather(normals, corners))


def next_corner(corners: IntArray) -> IntArray:
    """Successor of each corner in polygons (Q, 4), triangles padded with -1; the entry of the padding is the first corner."""
    after = np.roll(corners, -1, axis=1)
    return np.where(after < 0, corners[:, :1], after)


def close_triangles(corners: IntArray) -> IntArray:
    """Polygons (Q, 4) in which the padding -1 of triangles is replaced by their first corner."""
    return np.where(corners < 0, corners[:, :1], corners)


def gather(vectors: Rows, corners: IntArray) -> Rows:
    """Rows of `vectors` (V, 3) at `corners` (...), components first: (3, ...)."""
    return np.take(np.ascontiguousarray(vectors.T), corners, axis=1)


@njit_cached
def difference_of(points, i, j):  # type: ignore[no-untyped-def]  # pragma: no cover
    """The vector from point i to point j of points (n, 3)."""
    return points[j, 0] - points[i, 0], points[j, 1] - points[i, 1], points[j, 2] - points[i, 2]


@njit_cached
def dot_of(a, b):  # type: ignore[no-untyped-def]  # pragma: no cover
    """The scalar product of two vectors."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit_cached
def norm_of(a):  # type: ignore[no-untyped-def]  # pragma: no cover
    """The length of a vector."""
    return np.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])


@njit_cached
def triple_product_of(a, b, c):  # type: ignore[no-untyped-def]  # pragma: no cover
    """The scalar product of a x b with c."""
    x, y, z = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
    return x * c[0] + y * c[1] + z * c[2]
