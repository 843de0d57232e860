"""The filled cut of closed bodies by a plane, sample by sample, without a Boolean operation.

The plane cuts the triangles of a closed body in oriented segments, whose winding number is 1 inside the body and 0 outside. The
winding number along a row of samples is the running sum of the segments that cross the row, each counted by its direction.
"""

from __future__ import annotations

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.kernel.render.z_buffer import count_up, first_sample

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
    first, last = (first_sample(p[:, 1], height) for p in (start, end))
    rows = np.abs(last - first)
    of = np.repeat(np.arange(len(rows)), rows)
    y = np.minimum(first, last)[of] + count_up(rows)
    t = (y + 0.5 - start[of, 1]) / (end[of, 1] - start[of, 1])
    x = start[of, 0] + t * (end[of, 0] - start[of, 0])
    column = first_sample(x, width)
    direction = np.where(last > first, 1.0, -1.0)[of]
    steps = np.bincount(y * (width + 1) + column, direction, height * (width + 1)).reshape(height, width + 1)
    winding = np.rint(np.cumsum(steps, axis=1)).astype(np.int64)
    winding[winding[:, -1] != 0] = 0
    return np.asarray(winding[:, :-1] != 0)
