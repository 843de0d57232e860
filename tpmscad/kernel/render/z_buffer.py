"""Z-buffer in NumPy: many small triangles at once, scanline by scanline, without a loop over triangles.

A sample belongs to a triangle by the half-open rule of scan conversion: rows and columns from the lower bound, included, to the
upper bound, excluded. Triangles that share an edge therefore neither overlap nor leave a gap.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray

FRAGMENTS_PER_BATCH = 3_000_000
"""Samples of triangles evaluated at once; about 200 MB of temporary arrays."""

KeepFragments = Callable[[Any, Any, Any], BoolArray]
"""Which samples (x, y, depth), each (n,), are drawn."""


@dataclass(frozen=True, slots=True, eq=False)
class ZBuffer:
    """Front triangle of each pixel (height, width), -1 for none, and its depth, inf for none."""

    triangle: IntArray
    depth: Array


def rasterise(
    screen: Array, depth: Array, corners: IntArray, width: int, height: int, keep: KeepFragments | None = None
) -> ZBuffer:
    """Visible triangle of every pixel.

    screen (n, 2): pixel coordinates of the points, x to the right and y down. depth (n,): smaller is closer. Pixel (i, j) is
    sampled at its center (i + 1/2, j + 1/2). keep: samples that are drawn, by default all.
    """
    order = np.argsort(screen[corners, 1], axis=1, kind="stable")
    upper, middle, lower = (np.take_along_axis(corners, order, axis=1)[:, k] for k in range(3))
    a, b, c = screen[upper], screen[middle], screen[lower]
    area = _cross(b - a, c - a)
    first, last = first_sample(a[:, 1], height), first_sample(c[:, 1], height)
    drawn = np.flatnonzero((last > first) & (area != 0))
    slope = _depth_slopes(a[drawn], b[drawn], c[drawn], depth[upper[drawn]], depth[middle[drawn]], depth[lower[drawn]])
    rows = (last - first)[drawn]
    of = np.repeat(np.arange(len(drawn)), rows)  # the triangle of each span
    y = first[drawn][of] + count_up(rows)
    left, right = _spans(a[drawn], b[drawn], c[drawn], of, y + 0.5)
    start, stop = first_sample(left, width), first_sample(right, width)
    filled = stop > start
    of, y, start, length = of[filled], y[filled], start[filled], (stop - start)[filled]
    triangle = np.full(width * height, -1, np.int64)
    front = np.full(width * height, np.inf)
    origin, origin_depth = a[drawn], depth[upper[drawn]]
    for spans in _batches(length):
        n = length[spans]
        span_depth = (
            origin_depth[of[spans]]
            + slope[of[spans], 0] * (start[spans] + 0.5 - origin[of[spans], 0])
            + slope[of[spans], 1] * (y[spans] + 0.5 - origin[of[spans], 1])
        )
        along = count_up(n)
        z = np.repeat(span_depth, n) + np.repeat(slope[of[spans], 0], n) * along
        pixel = np.repeat(y[spans] * width + start[spans], n) + along
        t = np.repeat(drawn[of[spans]], n)
        if keep is not None:
            kept = np.flatnonzero(keep(pixel % width + 0.5, pixel // width + 0.5, z))
            z, pixel, t = z[kept], pixel[kept], t[kept]
        np.minimum.at(front, pixel, z)
        seen = z == front[pixel]
        triangle[pixel[seen]] = t[seen]
    return ZBuffer(triangle.reshape(height, width), front.reshape(height, width))


def barycentric_weights(screen: Array, corners: IntArray, x: Any, y: Any) -> Array:
    """Weights (n, 3) of the corners (n, 3) of one triangle for each screen point (x, y): (n,), (n,)."""
    a, b, c = (screen[corners[:, k]] for k in range(3))
    p = np.stack([x, y], axis=1)
    area = _cross(b - a, c - a)
    w = np.stack([_cross(c - b, p - b) / area, _cross(a - c, p - c) / area], axis=1)
    return np.column_stack([w, 1.0 - w.sum(axis=1)])


def first_sample(x: Array, size: int) -> IntArray:
    """The first sample i with i + 1/2 >= x, in [0, size]."""
    return np.ceil(x.clip(-1.0, size + 1.0) - 0.5).astype(np.int64).clip(0, size)


def _spans(a: Array, b: Array, c: Array, of: IntArray, y: Any) -> tuple[Array, Array]:
    """Where the lines y = const enter and leave their triangles; the corners are ordered by y."""
    along = _crossing(a[of], c[of], y)
    above = y < b[of, 1]
    bent = _crossing(np.where(above[:, None], a[of], b[of]), np.where(above[:, None], b[of], c[of]), y)
    return np.minimum(along, bent), np.maximum(along, bent)


def _crossing(start: Array, end: Array, y: Any) -> Array:
    """Abscissas at the heights y of the segments from start to end (n, 2)."""
    height = end[:, 1] - start[:, 1]
    t = np.divide(y - start[:, 1], height, out=np.zeros_like(y), where=height > 0)
    return np.asarray(start[:, 0] + t * (end[:, 0] - start[:, 0]))


def _depth_slopes(a: Array, b: Array, c: Array, za: Array, zb: Array, zc: Array) -> Array:
    """Derivatives of the depth by x and y over each triangle: (n, 2)."""
    (p, q), (dp, dq) = (b - a, c - a), (zb - za, zc - za)
    area = _cross(p, q)
    return np.stack([dp * q[:, 1] - dq * p[:, 1], dq * p[:, 0] - dp * q[:, 0]], axis=1) / area[:, None]


def count_up(counts: IntArray) -> IntArray:
    """0 .. n - 1 for each n of the counts, one after another."""
    ends = np.cumsum(counts)
    return np.asarray(np.arange(ends[-1] if len(ends) else 0) - np.repeat(ends - counts, counts))


def _batches(lengths: IntArray) -> list[slice]:
    """Consecutive slices of at most `FRAGMENTS_PER_BATCH` samples each, or of one span."""
    ends, batches, start = np.cumsum(lengths), [], 0
    while start < len(lengths):
        done = ends[start - 1] if start else 0
        stop = max(start + 1, int(np.searchsorted(ends, done + FRAGMENTS_PER_BATCH, side="right")))
        batches.append(slice(start, stop))
        start = stop
    return batches


def _cross(p: Array, q: Array) -> Array:
    """Cross product in the plane."""
    return np.asarray(p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0])
