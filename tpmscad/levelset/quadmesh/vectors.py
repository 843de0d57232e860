"""Vectors by component, (3, ...): several times as fast as the same along the last axis of many short vectors."""

from __future__ import annotations

import numpy as np

from tpmscad._typing import Array, IntArray

MIN_DIVISOR = 1e-300
"""Lengths are at least this where something is divided by them: vectors of no length stay so."""


def normalize(vectors: Array) -> Array:
    """Vectors (..., 3) of length one."""
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), MIN_DIVISOR))


def dot(a: Array, b: Array) -> Array:
    return np.asarray(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


def cross(a: Array, b: Array) -> Array:
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def length(a: Array) -> Array:
    return np.asarray(np.sqrt(dot(a, a)))


def roll_next(a: Array) -> Array:
    """What comes after each of the last axis, round."""
    return np.concatenate([a[..., 1:], a[..., :1]], axis=-1)


def roll_previous(a: Array) -> Array:
    """What comes before each of the last axis, round."""
    return np.concatenate([a[..., -1:], a[..., :-1]], axis=-1)


def sines_between_sides(side: Array, size: Array, normals: Array) -> Array:
    """Sines (Q, n) of the corners of polygons with sides (3, Q, n) of these lengths; negative where a corner is turned over."""
    return np.asarray(
        dot(cross(side, -roll_previous(side)), normals) / np.maximum(size * roll_previous(size), MIN_DIVISOR)
    )


def corner_sines(vertices: Array, corners: IntArray, normals: Array) -> Array:
    """Sines of the corner angles of polygons (Q, n) of vertices (V, 3), negative where a corner is turned over: (Q, n)."""
    points = gather(vertices, corners)
    side = roll_next(points) - points
    return sines_between_sides(side, length(side), gather(normals, corners))


def next_corner(corners: IntArray) -> IntArray:
    """The corner after each in polygons (Q, 4), triangles with a last -1; of what is no corner the first."""
    after = np.roll(corners, -1, axis=1)
    return np.where(after < 0, corners[:, :1], after)


def close_triangles(corners: IntArray) -> IntArray:
    """Polygons (Q, 4) with the first corner of triangles in the place of their last -1."""
    return np.where(corners < 0, corners[:, :1], corners)


def gather(vectors: Array, corners: IntArray) -> Array:
    """Those of vectors (V, 3) at corners (...), by component: (3, ...)."""
    return np.take(np.ascontiguousarray(vectors.T), corners, axis=1)
