"""Compiled loops over cells: balls around bicubic nets (n, 4, 4, 3), cones of normals, halves, and chords in rectangles."""

from __future__ import annotations

import numpy as np

from tpmscad._compiled_loops import njit_cached
from tpmscad._typing import Array, BoolArray, IntArray

REGULAR_RATIO = 1e-9
"""Of the longest sampled normal of a cell: shorter ones, at poles of the surface, have no direction."""

LEAST_MEAN = 1e-3
"""Length of the sum of a cell's sampled unit normals below which they have no mean direction."""

CONE_MARGIN = 1.3
"""Widening of the cone of a cell's sampled normals, of which a bicubic patch has more extreme ones between the samples."""


@njit_cached
def bound_nets(nets: Array, center: Array, radius: Array) -> None:  # pragma: no cover - compiled
    """Fill in centres (n, 3) and radii (n,) of balls around the poles."""
    for n in range(len(nets)):
        for c in range(3):
            low, high = np.inf, -np.inf
            for i in range(4):
                for j in range(4):
                    low, high = min(low, nets[n, i, j, c]), max(high, nets[n, i, j, c])
            center[n, c] = 0.5 * (low + high)
        square = 0.0
        for i in range(4):
            for j in range(4):
                x, y, z = (
                    nets[n, i, j, 0] - center[n, 0],
                    nets[n, i, j, 1] - center[n, 1],
                    nets[n, i, j, 2] - center[n, 2],
                )
                square = max(square, x * x + y * y + z * z)
        radius[n] = np.sqrt(square)


@njit_cached
def bound_normals(
    nets: Array, sign: Array, rows: Array, slopes: Array, axis: Array, angle: Array
) -> None:  # pragma: no cover - compiled
    """Fill in unit axes (n, 3) and half angles (n,) of cones of the normals times `sign` (n,).

    rows, slopes (k, 4): the Bernstein polynomials and their derivatives on the grid lines of the samples.
    """
    lines = len(rows)
    normals, lengths = np.empty((lines * lines, 3)), np.empty(lines * lines)
    value, slope, du, dv = np.empty((4, 3)), np.empty((4, 3)), np.empty(3), np.empty(3)
    for n in range(len(nets)):
        longest = 0.0
        for k in range(lines):
            for j in range(4):
                for c in range(3):
                    value[j, c] = slope[j, c] = 0.0
                    for i in range(4):
                        value[j, c] += rows[k, i] * nets[n, i, j, c]
                        slope[j, c] += slopes[k, i] * nets[n, i, j, c]
            for m in range(lines):
                for c in range(3):
                    du[c] = dv[c] = 0.0
                    for j in range(4):
                        du[c] += rows[m, j] * slope[j, c]
                        dv[c] += slopes[m, j] * value[j, c]
                at, square = k * lines + m, 0.0
                for c in range(3):
                    e, f = (c + 1) % 3, (c + 2) % 3
                    normals[at, c] = du[e] * dv[f] - du[f] * dv[e]
                    square += normals[at, c] ** 2
                lengths[at] = np.sqrt(square)
                longest = max(longest, lengths[at])
        least = REGULAR_RATIO * max(longest, 1e-300)
        x, y, z = 0.0, 0.0, 0.0
        for at in range(lines * lines):
            if lengths[at] > least:
                for c in range(3):
                    normals[at, c] *= sign[n] / lengths[at]
                x, y, z = x + normals[at, 0], y + normals[at, 1], z + normals[at, 2]
        size = np.sqrt(x * x + y * y + z * z)
        axis[n] = 0.0
        angle[n] = np.pi
        if size > LEAST_MEAN:
            axis[n, 0], axis[n, 1], axis[n, 2] = x / size, y / size, z / size
            cosine = 1.0
            for at in range(lines * lines):
                if lengths[at] > least:
                    along = normals[at, 0] * axis[n, 0] + normals[at, 1] * axis[n, 1] + normals[at, 2] * axis[n, 2]
                    cosine = min(cosine, along)
            angle[n] = min(CONE_MARGIN * np.arccos(max(cosine, -1.0)), np.pi)


@njit_cached
def halve_nets(
    nets: Array, parent: IntArray, half: IntArray, axis: IntArray, halves: Array
) -> None:  # pragma: no cover - compiled
    """Fill in nets (m, 4, 4, 3): the first (0) or second (1) halves of their parents by de Casteljau, or copies of them (-1).

    axis (n,): the direction across which each parent is halved.
    """
    for n in range(len(parent)):
        source, result = nets[parent[n]], halves[n]
        if half[n] < 0:
            result[:] = source
            continue
        for i in range(4):
            for c in range(3):
                if axis[parent[n]] == 0:
                    a, b, d, e = source[0, i, c], source[1, i, c], source[2, i, c], source[3, i, c]
                else:
                    a, b, d, e = source[i, 0, c], source[i, 1, c], source[i, 2, c], source[i, 3, c]
                ab, bd, de = 0.5 * (a + b), 0.5 * (b + d), 0.5 * (d + e)
                abd, bde = 0.5 * (ab + bd), 0.5 * (bd + de)
                middle = 0.5 * (abd + bde)
                if half[n] == 0:
                    b, d, e = ab, abd, middle
                else:
                    a, b, d = middle, bde, de
                if axis[parent[n]] == 0:
                    result[0, i, c], result[1, i, c], result[2, i, c], result[3, i, c] = a, b, d, e
                else:
                    result[i, 0, c], result[i, 1, c], result[i, 2, c], result[i, 3, c] = a, b, d, e


@njit_cached
def find_longer_directions(nets: Array, axis: IntArray) -> None:  # pragma: no cover - compiled
    """Fill in the direction (n,), 0 or 1, in which the longest row of poles is longer."""
    for n in range(len(nets)):
        along, across = 0.0, 0.0
        for i in range(4):
            row, column = 0.0, 0.0
            for j in range(3):
                u, v = 0.0, 0.0
                for c in range(3):
                    u += (nets[n, j + 1, i, c] - nets[n, j, i, c]) ** 2
                    v += (nets[n, i, j + 1, c] - nets[n, i, j, c]) ** 2
                row, column = row + np.sqrt(u), column + np.sqrt(v)
            along, across = max(along, row), max(across, column)
        axis[n] = 1 if across > along else 0


def chords_meet_boxes(chords: Array, slack: Array, box: Array) -> BoolArray:
    """Whether chords (m, 2, 2), widened by their slack (m, 2), meet rectangles (m, 2, 2)."""
    meets = np.empty(len(chords), np.bool_)
    _clip_chords(chords, slack, box, meets)
    return meets


@njit_cached
def _clip_chords(chords: Array, slack: Array, box: Array, meets: BoolArray) -> None:  # pragma: no cover - compiled
    for m in range(len(chords)):
        enter, leave = 0.0, 1.0
        for a in range(2):
            low, high = box[m, a, 0] - slack[m, a], box[m, a, 1] + slack[m, a]
            start, way = chords[m, 0, a], chords[m, 1, a] - chords[m, 0, a]
            if way != 0.0:
                one, two = (low - start) / way, (high - start) / way
                enter, leave = max(enter, min(one, two)), min(leave, max(one, two))
            elif not low <= start <= high:
                leave = -np.inf
        meets[m] = enter <= leave
