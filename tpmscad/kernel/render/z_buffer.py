"""Z-buffer in NumPy, vectorised over the candidate pixels of many small triangles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, IntArray

PIXELS_PER_BATCH = 4_000_000
"""Candidate pixels evaluated at once; about 300 MB of temporary arrays."""


@dataclass(frozen=True, slots=True, eq=False)
class ZBuffer:
    """Front triangle of each pixel (height, width), -1 for none; its depth, inf for none; barycentric coordinates (.., 3)."""

    triangle: IntArray
    depth: Array
    weights: Array


def rasterise(screen: Array, depth: Array, corners: IntArray, width: int, height: int) -> ZBuffer:
    """Visible triangle of every pixel.

    screen (n, 2): pixel coordinates of the points, x to the right and y down. depth (n,): smaller is closer.
    """
    a, b, c = (screen[corners[:, k]] for k in range(3))
    low = np.floor(np.minimum(np.minimum(a, b), c)).astype(np.int64).clip(0, [width, height])
    high = (np.floor(np.maximum(np.maximum(a, b), c)).astype(np.int64) + 1).clip(0, [width, height])
    size = (high - low).clip(0)
    area = _cross(b - a, c - a)
    drawn = np.flatnonzero((size.prod(axis=1) > 0) & (np.abs(area) > 0))
    count = size[drawn].prod(axis=1)
    triangle = np.full(width * height, -1, np.int64)
    front = np.full(width * height, np.inf)
    weights = np.zeros((width * height, 3))
    ends = np.cumsum(count)
    start = 0
    while start < len(drawn):
        stop = max(
            start + 1, int(np.searchsorted(ends, (ends[start - 1] if start else 0) + PIXELS_PER_BATCH, side="right"))
        )
        t = np.repeat(drawn[start:stop], count[start:stop])
        within = np.arange(len(t)) - np.repeat(
            ends[start:stop] - count[start:stop] - (ends[start - 1] if start else 0), count[start:stop]
        )
        x = low[t, 0] + within % size[t, 0]
        y = low[t, 1] + within // size[t, 0]
        p = np.stack([x, y], axis=1) + 0.5
        w = np.stack([_cross(c[t] - b[t], p - b[t]), _cross(a[t] - c[t], p - c[t])], axis=1) / area[t, None]
        w = np.column_stack([w, 1.0 - w.sum(axis=1)])
        inside = np.flatnonzero((w >= 0.0).all(axis=1))
        t, w, pixel = t[inside], w[inside], (y * width + x)[inside]
        z = (w * depth[corners[t]]).sum(axis=1)
        np.minimum.at(front, pixel, z)
        seen = z == front[pixel]
        triangle[pixel[seen]], weights[pixel[seen]] = t[seen], w[seen]
        start = stop
    shape = (height, width)
    return ZBuffer(triangle.reshape(shape), front.reshape(shape), weights.reshape(*shape, 3))


def _cross(p: Array, q: Array) -> Array:
    """Cross product in the plane."""
    return np.asarray(p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0])
