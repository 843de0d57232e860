"""Distances of points from round struts, compiled: cylinders, cones and balls, of which a grid knows the near ones."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tpmscad._compiled_loops import njit_cached
from tpmscad._typing import Array, IntArray

CELLS_ALONG_GRID = 24
"""Cells along the longest edge of the grid by which near struts are found; 1000 struts then take as long as about 20."""

BLOCK_CELLS = 6
"""Cells along the edges of a block, whose near struts are sought among all: 25,200 struts take .5 s instead of 5."""


class NearStruts(NamedTuple):
    """The struts whose surfaces may be nearest to a point of a grid's cell k: `members[first[k] : first[k + 1]]`, ascending.

    low, size (3,): corner of the grid, edges of a cell; counts (3,): of cells. Beyond the grid all struts are asked.
    """

    low: Array
    size: Array
    counts: IntArray
    first: IntArray
    members: IntArray


def find_near(points: Array, margin: float, start: Array, along: Array, radii: Array) -> NearStruts:
    """The grid around points (n, 3), with a margin, of struts from starts (k, 3) along vectors (k, 3), of radii (k, 2)."""
    low, high = points.min(axis=0) - margin, points.max(axis=0) + margin
    counts = np.maximum(((high - low) / (high - low).max() * CELLS_ALONG_GRID).astype(np.int64), 1)
    size = (high - low) / counts
    return NearStruts(low, size, counts, *_list_near(low, size, counts, start, along, radii))


@njit_cached  # type: ignore[untyped-decorator]  # numba has no types
def _nearest_part(
    dx: float, dy: float, dz: float, ax: float, ay: float, az: float, first: float, last: float
) -> float:  # pragma: no cover - compiled
    """Where on the axis a = (ax, ay, az) the ball lies that is nearest to a point d, as a fraction of the axis from its start.

    The radii of the balls grow along the axis from `first` to `last`; they fill a cone that touches both.
    """
    square = ax * ax + ay * ay + az * az
    if square == 0.0:
        return 0.0
    t = (dx * ax + dy * ay + dz * az) / square
    if first != last:
        length = np.sqrt(square)
        sine = (first - last) / length
        if abs(sine) >= 1.0:  # one ball holds all others
            return 0.0 if first > last else 1.0
        # the normal of the cone leans against the axis by the same angle everywhere
        away = np.sqrt(max(dx * dx + dy * dy + dz * dz - t * t * square, 0.0))
        t -= away * sine / (np.sqrt(1.0 - sine * sine) * length)
    return min(max(t, 0.0), 1.0)


@njit_cached  # type: ignore[untyped-decorator]  # numba has no types
def _list_near(
    low: Array, size: Array, counts: IntArray, start: Array, along: Array, radii: Array
) -> tuple[IntArray, IntArray]:
    """The numbers of near struts of all cells, and where those of each begin; found among those near a block of cells."""
    diagonal = np.sqrt((size**2).sum()) * (1 + 1e-9)
    n_cells = counts[0] * counts[1] * counts[2]
    begin, number = np.zeros(n_cells, np.int64), np.zeros(n_cells + 1, np.int64)
    found = np.empty(n_cells * 4 + len(start), np.int64)
    every, total = np.arange(len(start)), 0
    blocks = (counts + BLOCK_CELLS - 1) // BLOCK_CELLS
    for block in np.ndindex((blocks[0], blocks[1], blocks[2])):
        first = np.array(block) * BLOCK_CELLS
        last = np.minimum(first + BLOCK_CELLS, counts)
        # the distance changes by as much as the place: of centres in a block by half its diagonal at most, of both
        near = _select_near(low + 0.5 * (first + last) * size, BLOCK_CELLS * diagonal, every, start, along, radii)
        for i in range(first[0], last[0]):
            for j in range(first[1], last[1]):
                for k in range(first[2], last[2]):
                    cell = (i * counts[1] + j) * counts[2] + k
                    own = _select_near(low + (np.array([i, j, k]) + 0.5) * size, diagonal, near, start, along, radii)
                    while total + len(own) > len(found):
                        found = np.concatenate((found, np.empty(len(found), np.int64)))
                    found[total : total + len(own)] = own
                    begin[cell], number[cell + 1] = total, len(own)
                    total += len(own)
    limits = np.cumsum(number)
    members = np.empty(total, np.int64)
    for cell in range(n_cells):
        members[limits[cell] : limits[cell + 1]] = found[begin[cell] : begin[cell] + number[cell + 1]]
    return limits, members


@njit_cached  # type: ignore[untyped-decorator]  # numba has no types
def _select_near(
    point: Array, reach: float, among: IntArray, start: Array, along: Array, radii: Array
) -> IntArray:  # pragma: no cover - compiled
    """The struts `among` those given whose distance from a point exceeds the least one by `reach` at most."""
    distances = np.empty(len(among))
    for m in range(len(among)):
        s = among[m]
        dx, dy, dz = point[0] - start[s, 0], point[1] - start[s, 1], point[2] - start[s, 2]
        ax, ay, az = along[s, 0], along[s, 1], along[s, 2]
        t = _nearest_part(dx, dy, dz, ax, ay, az, radii[s, 0], radii[s, 1])
        dx, dy, dz = dx - t * ax, dy - t * ay, dz - t * az
        distances[m] = np.sqrt(dx * dx + dy * dy + dz * dz) - radii[s, 0] - t * (radii[s, 1] - radii[s, 0])
    return among[distances <= distances.min() + reach]


@njit_cached  # type: ignore[untyped-decorator]  # numba has no types
def measure_struts(
    points: Array,
    start: Array,
    along: Array,
    radii: Array,
    low: Array,
    size: Array,
    counts: IntArray,
    first: IntArray,
    members: IntArray,
) -> tuple[Array, Array]:
    """Values (n,) and gradients (n, 3) at points (n, 3)."""
    values, gradients = np.empty(len(points)), np.zeros((len(points), 3))
    for k in range(len(points)):
        x, y, z = points[k, 0], points[k, 1], points[k, 2]
        best, distance, nearest = np.inf, 0.0, -1
        i, j, m = (x - low[0]) / size[0], (y - low[1]) / size[1], (z - low[2]) / size[2]
        within = 0 <= i < counts[0] and 0 <= j < counts[1] and 0 <= m < counts[2]
        begin, end = 0, len(start)
        if within:
            cell = (int(i) * counts[1] + int(j)) * counts[2] + int(m)
            begin, end = first[cell], first[cell + 1]
        for each in range(begin, end):
            s = members[each] if within else each
            dx, dy, dz = x - start[s, 0], y - start[s, 1], z - start[s, 2]
            ax, ay, az = along[s, 0], along[s, 1], along[s, 2]
            t = _nearest_part(dx, dy, dz, ax, ay, az, radii[s, 0], radii[s, 1])
            dx, dy, dz = dx - t * ax, dy - t * ay, dz - t * az
            length = np.sqrt(dx * dx + dy * dy + dz * dz)
            value = length - radii[s, 0] - t * (radii[s, 1] - radii[s, 0])
            if value < best:
                best, distance, nearest = value, length, s
                gradients[k, 0], gradients[k, 1], gradients[k, 2] = dx, dy, dz
        values[k] = best
        if distance > 0:
            for c in range(3):
                gradients[k, c] /= distance
        else:  # any unit vector across
            axis = along[nearest]
            length = np.sqrt((axis**2).sum())
            least = 0
            for c in range(1, 3):
                if abs(axis[c]) < abs(axis[least]):
                    least = c
            part = axis[least] / length if length > 0 else 0.0
            for c in range(3):
                tilt = part * axis[c] / length if length > 0 else 0.0
                gradients[k, c] = ((1.0 if c == least else 0.0) - tilt) / np.sqrt(1 - part * part)
    return values, gradients
