"""What the polygons of a layout ask of their corners: to go where they are in the regular polygon nearest to each.

The nearest regular n-gon has the same centre, and its corners turned back by 2 pi k / n have the same mean.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tpmscad.patches.levelset.layout.octree import Array, Ints
from tpmscad.patches.levelset.layout.vectors import TINY, ahead, behind, cross, dot, length, sines, taken

WORST, POWER = 0.1, 2
"""A polygon pulls with 1 / max(least sine of its corners, WORST)^POWER: without that, layouts with necks keep turned corners."""


def asked(vertices: Array, normals: Array, polygons: Sequence[Ints]) -> tuple[Array, Array]:
    """The mean of what polygons, given by their number of corners (Q, n), ask of each vertex, (V, 3), and the shortest of their
    sides there, (V,); nothing and infinity for vertices of none of them."""
    count = len(vertices)
    wanted, share, shortest = np.zeros((3, count)), np.zeros(count), np.full(count, np.inf)
    for corners in polygons:
        points, at = taken(vertices, corners), corners.ravel()
        side = ahead(points) - points
        size = length(side)
        sine = sines(side, size, taken(normals, corners)).min(axis=1)
        pull = 1.0 / np.clip(sine, WORST, 1.0) ** POWER
        target = pull[:, None] * regular(points)
        share += np.bincount(at, np.repeat(pull, corners.shape[1]), minlength=count)
        for axis in range(3):
            wanted[axis] += np.bincount(at, target[axis].ravel(), minlength=count)
        np.minimum.at(shortest, at, np.minimum(size, behind(size)).ravel())
    return (wanted / np.maximum(share, TINY)).T, shortest


def regular(points: Array) -> Array:
    """The regular n-gons nearest to polygons (3, Q, n)."""
    n = points.shape[2]
    centre = points.mean(axis=2, keepdims=True)
    spokes = points - centre
    normal = cross(spokes, ahead(spokes)).sum(axis=2)
    normal /= np.maximum(length(normal), TINY)
    first = spokes[:, :, 0] - dot(spokes[:, :, 0], normal) * normal
    first /= np.maximum(length(first), TINY)
    second = cross(normal, first)
    along, across = dot(spokes, first[:, :, None]), dot(spokes, second[:, :, None])
    cos, sin = np.cos(2 * np.pi / n * np.arange(n)), np.sin(2 * np.pi / n * np.arange(n))
    x, y = (along @ cos + across @ sin) / n, (across @ cos - along @ sin) / n
    return np.asarray(
        centre
        + first[:, :, None] * (x[:, None] * cos - y[:, None] * sin)
        + second[:, :, None] * (x[:, None] * sin + y[:, None] * cos)
    )
