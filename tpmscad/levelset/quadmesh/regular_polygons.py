"""Regular polygons nearest to the polygons of a mesh, and the mean positions that they propose for its vertices.

The nearest regular n-gon in the least-squares sense has the same centroid and mean plane. Its radius and phase are the first
harmonic of the corners: their mean after corner k is rotated back by 2 pi k / n.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tpmscad._compiled_loops import njit_cached
from tpmscad._typing import Array, IntArray
from tpmscad.levelset.quadmesh.vectors import MIN_DIVISOR, cross, dot, length, roll_next

MIN_WEIGHTED_SINE = 0.1
WEIGHT_POWER = 2
"""A polygon's weight is 1 / max(least corner sine, MIN_WEIGHTED_SINE) ** WEIGHT_POWER; equal weights leave corners reversed at
necks."""


def fit_regular_polygons(points: Array) -> Array:
    """Regular n-gons (3, Q, n) nearest to polygons (3, Q, n)."""
    n = points.shape[2]
    centre = points.mean(axis=2, keepdims=True)
    spokes = points - centre
    normal = cross(spokes, roll_next(spokes)).sum(axis=2)
    normal /= np.maximum(length(normal), MIN_DIVISOR)
    e1 = spokes[:, :, 0] - dot(spokes[:, :, 0], normal) * normal
    e1 /= np.maximum(length(e1), MIN_DIVISOR)
    e2 = cross(normal, e1)
    x, y = dot(spokes, e1[:, :, None]), dot(spokes, e2[:, :, None])
    cos, sin = np.cos(2 * np.pi / n * np.arange(n)), np.sin(2 * np.pi / n * np.arange(n))
    a, b = (x @ cos + y @ sin) / n, (y @ cos - x @ sin) / n
    return np.asarray(
        centre
        + e1[:, :, None] * (a[:, None] * cos - b[:, None] * sin)
        + e2[:, :, None] * (a[:, None] * sin + b[:, None] * cos)
    )


def average_target_positions(vertices: Array, normals: Array, polygons: Sequence[IntArray]) -> tuple[Array, Array]:
    """Weighted mean (V, 3) of the positions that polygons propose for each vertex, and its shortest side (V,).

    `polygons` holds one array (Q, n) for each number of corners n. A vertex without polygons has the mean zero and an infinite
    side.
    """
    count = len(vertices)
    weighted, weights, shortest = np.zeros((count, 3)), np.zeros(count), np.full(count, np.inf)
    for corners in polygons:
        turns = 2 * np.pi / corners.shape[1] * np.arange(corners.shape[1])
        _add_proposals(vertices, normals, corners, np.cos(turns), np.sin(turns), weighted, weights, shortest)
    weighted /= np.maximum(weights, MIN_DIVISOR)[:, None]
    return weighted, shortest


@njit_cached
def _add_proposals(
    vertices: Array,
    normals: Array,
    polygons: IntArray,
    cosines: Array,
    sines: Array,
    weighted: Array,
    weights: Array,
    shortest: Array,
) -> None:  # pragma: no cover
    """Add the weighted proposals of polygons (Q, n) to the sums of their corners: `fit_regular_polygons` one by one."""
    n = polygons.shape[1]
    side, size, spoke = np.empty((n, 3)), np.empty(n), np.empty((n, 3))
    centre, normal, e1, e2 = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for corners in polygons:
        for x in range(3):
            centre[x] = 0.0
            for k in range(n):
                centre[x] += vertices[corners[k], x]
            centre[x] /= n
        for k in range(n):
            square = 0.0
            for x in range(3):
                side[k, x] = vertices[corners[(k + 1) % n], x] - vertices[corners[k], x]
                spoke[k, x] = vertices[corners[k], x] - centre[x]
                square += side[k, x] ** 2
            size[k] = np.sqrt(square)
        least = np.inf
        normal[:] = 0.0
        for k in range(n):
            a, b, before = spoke[k], spoke[(k + 1) % n], k - 1 if k else n - 1
            triple = 0.0
            for x in range(3):
                y, z = (x + 1) % 3, (x + 2) % 3
                normal[x] += a[y] * b[z] - a[z] * b[y]
                triple += (side[before, y] * side[k, z] - side[before, z] * side[k, y]) * normals[corners[k], x]
            least = min(least, triple / max(size[k] * size[before], MIN_DIVISOR))
        _scale_to_unit(normal)
        along = spoke[0, 0] * normal[0] + spoke[0, 1] * normal[1] + spoke[0, 2] * normal[2]
        for x in range(3):
            e1[x] = spoke[0, x] - along * normal[x]
        _scale_to_unit(e1)
        for x in range(3):
            y, z = (x + 1) % 3, (x + 2) % 3
            e2[x] = normal[y] * e1[z] - normal[z] * e1[y]
        radius_1, radius_2 = 0.0, 0.0
        for k in range(n):
            first = spoke[k, 0] * e1[0] + spoke[k, 1] * e1[1] + spoke[k, 2] * e1[2]
            second = spoke[k, 0] * e2[0] + spoke[k, 1] * e2[1] + spoke[k, 2] * e2[2]
            radius_1 += (first * cosines[k] + second * sines[k]) / n
            radius_2 += (second * cosines[k] - first * sines[k]) / n
        weight = 1.0 / min(max(least, MIN_WEIGHTED_SINE), 1.0) ** WEIGHT_POWER
        for k in range(n):
            vertex, before = corners[k], k - 1 if k else n - 1
            weights[vertex] += weight
            shortest[vertex] = min(shortest[vertex], min(size[k], size[before]))
            first = radius_1 * cosines[k] - radius_2 * sines[k]
            second = radius_1 * sines[k] + radius_2 * cosines[k]
            for x in range(3):
                weighted[vertex, x] += weight * (centre[x] + e1[x] * first + e2[x] * second)


@njit_cached
def _scale_to_unit(vector: Array) -> None:  # pragma: no cover
    size = max(np.sqrt(vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2), MIN_DIVISOR)
    for x in range(3):
        vector[x] /= size
