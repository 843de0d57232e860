"""Vectors by component, (3, ...): several times as fast as the same along the last axis of many short vectors."""

from __future__ import annotations

import numpy as np

from tpmscad.patches.levelset.layout.octree import Array, Ints

TINY = 1e-300
"""Lengths are at least this where something is divided by them: vectors of no length stay so."""


def unit(vectors: Array) -> Array:
    """Vectors (..., 3) of length one."""
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), TINY))


def dot(a: Array, b: Array) -> Array:
    return np.asarray(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


def cross(a: Array, b: Array) -> Array:
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def length(a: Array) -> Array:
    return np.asarray(np.sqrt(dot(a, a)))


def ahead(a: Array) -> Array:
    """What comes after each of the last axis, round."""
    return np.concatenate([a[..., 1:], a[..., :1]], axis=-1)


def behind(a: Array) -> Array:
    """What comes before each of the last axis, round."""
    return np.concatenate([a[..., -1:], a[..., :-1]], axis=-1)


def sines(side: Array, size: Array, normals: Array) -> Array:
    """Sines (Q, n) of the corners of polygons with sides (3, Q, n) of these lengths; negative where a corner is turned over."""
    return np.asarray(dot(cross(side, -behind(side)), normals) / np.maximum(size * behind(size), TINY))


def corner_sines(vertices: Array, corners: Ints, normals: Array) -> Array:
    """Sines of the corner angles of polygons (Q, n) of vertices (V, 3), negative where a corner is turned over: (Q, n)."""
    points = taken(vertices, corners)
    side = ahead(points) - points
    return sines(side, length(side), taken(normals, corners))


def following(corners: Ints) -> Ints:
    """The corner after each in polygons (Q, 4), triangles with a last -1; of what is no corner the first."""
    after = np.roll(corners, -1, axis=1)
    return np.where(after < 0, corners[:, :1], after)


def filled(corners: Ints) -> Ints:
    """Polygons (Q, 4) with the first corner of triangles in the place of their last -1."""
    return np.where(corners < 0, corners[:, :1], corners)


def taken(vectors: Array, corners: Ints) -> Array:
    """Those of vectors (V, 3) at corners (...), by component: (3, ...)."""
    return np.take(np.ascontiguousarray(vectors.T), corners, axis=1)
