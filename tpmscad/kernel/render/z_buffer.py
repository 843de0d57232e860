"""Scan conversion in NumPy: the front triangle of each sample, and the filled cut of closed bodies by a plane.

The z-buffer takes many small triangles at once, scanline by scanline, without a loop over triangles. A sample belongs to a
triangle by the half-open rule of scan conversion: rows and columns from the lower bound, included, to the upper bound, excluded.
Triangles that share an edge therefore neither overlap nor leave a gap.

A plane cuts the triangles of a closed body in oriented segments, whose winding number is 1 inside the body and 0 outside. The
winding number along a row of samples is the running sum of the segments that cross the row, each counted by its direction.
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
    first, last = _first_sample(a[:, 1], height), _first_sample(c[:, 1], height)
    drawn = np.flatnonzero((last > first) & (area != 0))
    slope = _depth_slopes(a[drawn], b[drawn], c[drawn], depth[upper[drawn]], depth[middle[drawn]], depth[lower[drawn]])
    rows = (last - first)[drawn]
    of = np.repeat(np.arange(len(drawn)), rows)  # the triangle of each span
    y = first[drawn][of] + _count_up(rows)
    left, right = _spans(a[drawn], b[drawn], c[drawn], of, y + 0.5)
    start, stop = _first_sample(left, width), _first_sample(right, width)
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
        along = _count_up(n)
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


def _first_sample(x: Array, size: int) -> IntArray:
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


def _count_up(counts: IntArray) -> IntArray:
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


MIN_FACING = 1e-6
"""Cosine between the normal of the plane and the direction of view below which no sample sees the cut."""


def cut_segments(points: Array, corners: IntArray, normal: Array, offset: float) -> tuple[Array, Array]:
    """Start and end (s, 3) of the segments in which the plane normal . p = offset cuts the triangles.

    A vertex in the plane counts as above it, so that the segments of a closed body close.
    """
    height = (points @ normal - offset)[corners]
    above = height >= 0
    cut = above.any(axis=1) & ~above.all(axis=1)
    height, above, p = height[cut], above[cut], points[corners[cut]]
    following = np.roll(above, -1, axis=1)
    ends = []
    for leaves in (False, True):
        k = np.argmax(
            (above == leaves) & (following != leaves), axis=1
        )  # the side that enters, or leaves, the upper half
        rows, k2 = np.arange(len(k)), (k + 1) % 3
        below, over = (k2, k) if leaves else (k, k2)
        h0, h1 = height[rows, below], height[rows, over]
        t = (-h0 / (h1 - h0))[:, None]
        ends.append(p[rows, below] + t * (p[rows, over] - p[rows, below]))
    return ends[0], ends[1]


def fill_segments(start: Array, end: Array, width: int, height: int) -> BoolArray:
    """Samples (height, width) with a winding number other than zero among closed chains of segments, (s, 2) in pixels.

    A row on which the chains do not close, for want of a triangle, is left empty.
    """
    first, last = (_first_sample(p[:, 1], height) for p in (start, end))
    rows = np.abs(last - first)
    of = np.repeat(np.arange(len(rows)), rows)
    y = np.minimum(first, last)[of] + _count_up(rows)
    t = (y + 0.5 - start[of, 1]) / (end[of, 1] - start[of, 1])
    x = start[of, 0] + t * (end[of, 0] - start[of, 0])
    column = _first_sample(x, width)
    direction = np.where(last > first, 1.0, -1.0)[of]
    steps = np.bincount(y * (width + 1) + column, direction, height * (width + 1)).reshape(height, width + 1)
    winding = np.rint(np.cumsum(steps, axis=1)).astype(np.int64)
    winding[winding[:, -1] != 0] = 0
    return np.asarray(winding[:, :-1] != 0)
