"""Compiled loops over pairs of cells: which may hold places that face each other, and lower bounds of their distances.

Places p, q face each other if the segment between them is along both inward (or outward) normals, within `STRAIGHT`, or within
`MAX_TAPER` at one end where a sharp edge ends a side. The tests go from cheap to dear: balls, cones of normals, then the hulls of
the cells along a few directions. A direction w separates the cone of half angle a about an axis if w is at a right angle to the
cone's side: then w . (q - p) <= 0 for all segments within the cone.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tpmscad._compiled_loops import njit_cached
from tpmscad._typing import Array, BoolArray, IntArray

STRAIGHT = np.radians(0.25)
"""Angle within which a segment is along a normal: kinks of smooth joints, and the Newton steps that end there, are smaller."""

MAX_TAPER = np.radians(20.0)
"""Greatest angle between the segment and one of its normals where a sharp edge ends a side."""


class CellBounds(NamedTuple):
    """What the loops read of n cells: a named tuple, which compiled functions take.

    Attributes
    ----------
    nets, pad : (n, 4, 4, 3), (n,)
        Poles, and how far the surface is from their patch at most.
    center, radius : (n, 3), (n,)
        Balls that contain the cells.
    axis, angle : (n, 3), (n,)
        Cones of the outward normals.
    solid, group : (n,), (n,)
        Solid and smooth group of each cell.
    edge_row : (n,)
        Row of each cell in `edge_keys` and `more_edges`, -1 where no sharp edge is near.
    edge_keys : (m, k)
        Numbers of the sharp edges near, -1 for none.
    more_edges : (m,)
        Whether there may be others.
    """

    nets: Array
    pad: Array
    center: Array
    radius: Array
    axis: Array
    angle: Array
    solid: IntArray
    group: IntArray
    edge_row: IntArray
    edge_keys: IntArray
    more_edges: BoolArray


@njit_cached
def select_facing(
    cells: CellBounds,
    parents: IntArray,
    first: IntArray,
    value: float,
    through: float,
    n_groups: int,
    pairs: IntArray,
    low: Array,
) -> int:  # pragma: no cover - compiled
    """Fill in the pairs of parts that may face each other nearer than `value`, and lower bounds of their distances.

    The parts of parent i are cells first[i] to first[i + 1] - 1; parents (m, 2) are pairs of parents. pairs (k, 2) and low (k,)
    have room for all. Returns how many were filled in.
    """
    found = 0
    way, direction = np.empty(3), np.empty(3)
    for k in range(len(parents)):
        one, two = parents[k, 0], parents[k, 1]
        for i in range(first[one], first[one + 1]):
            for j in range(first[two], first[two + 1]):
                if one == two and j < i:
                    continue
                bound = _bound_distance(cells, i, j, value, through, n_groups, way, direction)
                if bound < value:
                    pairs[found, 0], pairs[found, 1], low[found] = i, j, bound
                    found += 1
    return found


@njit_cached
def _bound_distance(
    cells: CellBounds, i: int, j: int, value: float, through: float, n_groups: int, way: Array, direction: Array
) -> float:  # pragma: no cover - compiled
    """A lower bound of the distance of places of two cells that face each other, inf if there are none nearer than `value`."""
    square = 0.0
    for c in range(3):
        way[c] = cells.center[j, c] - cells.center[i, c]
        square += way[c] ** 2
    reach, one_solid = cells.radius[i] + cells.radius[j], cells.solid[i] == cells.solid[j]
    if square >= (value + reach) ** 2 or not (one_solid or through > 0.0):
        return np.inf
    apart = max(np.sqrt(square), 1e-300)
    if one_solid:
        taper = MAX_TAPER if ends_at_edge(cells, i, j, n_groups, False) else STRAIGHT
        turn = np.arccos(min(max(_dot(cells.axis[i], cells.axis[j]), -1.0), 1.0))
        if turn + cells.angle[i] + cells.angle[j] < np.pi - taper:
            return np.inf
        spread = np.arcsin(reach / apart) if apart > reach else np.pi
        along_i, along_j = through * _dot(way, cells.axis[i]) / apart, -through * _dot(way, cells.axis[j]) / apart
        tilt_i = np.arccos(min(max(along_i, -1.0), 1.0)) - spread - cells.angle[i]
        tilt_j = np.arccos(min(max(along_j, -1.0), 1.0)) - spread - cells.angle[j]
        if min(tilt_i, tilt_j) > STRAIGHT or max(tilt_i, tilt_j) > taper:
            return np.inf
        for k, sign in ((i, through), (j, -through)):
            if _lie_outside_cone(cells, i, j, sign, cells.axis[k], cells.angle[k] + taper, way, direction):
                return np.inf
    pad, low = cells.pad[i] + cells.pad[j], 0.0
    for choice in range(4):
        for c in range(3):
            out_i, out_j = through * cells.axis[i, c], -through * cells.axis[j, c]
            direction[c] = (out_i, out_j, way[c], out_i + out_j)[choice]
        length = np.sqrt(_dot(direction, direction))
        if length > 0.0:
            nearest, _ = _heights(cells, i, j, direction)
            low = max(low, nearest / length - pad)
            if low >= value:
                return np.inf
    return low


@njit_cached
def _lie_outside_cone(
    cells: CellBounds, i: int, j: int, sign: float, axis: Array, angle: float, way: Array, direction: Array
) -> bool:  # pragma: no cover - compiled
    """Whether no segment from the first cell to the second is in the cone about sign * axis: one of two planes separates them."""
    if angle >= 0.5 * np.pi:
        return False
    pad = cells.pad[i] + cells.pad[j]
    nearest, farthest = _heights(cells, i, j, axis)
    if sign * (farthest if sign > 0.0 else nearest) < -pad:
        return True
    along, square = _dot(way, axis), 0.0
    for c in range(3):
        direction[c] = way[c] - along * axis[c]
        square += direction[c] ** 2
    if square == 0.0:
        return False
    for c in range(3):
        direction[c] = np.cos(angle) * direction[c] / np.sqrt(square) - np.sin(angle) * sign * axis[c]
    nearest, _ = _heights(cells, i, j, direction)
    return nearest > pad


@njit_cached
def _heights(cells: CellBounds, i: int, j: int, direction: Array) -> tuple[float, float]:  # pragma: no cover - compiled
    """Least and greatest component along a direction of the segments from poles of the first cell to those of the second."""
    x, y, z = direction[0], direction[1], direction[2]
    low_i, high_i, low_j, high_j = np.inf, -np.inf, np.inf, -np.inf
    for a in range(4):
        for b in range(4):
            p, q = cells.nets[i, a, b], cells.nets[j, a, b]
            height = x * p[0] + y * p[1] + z * p[2]
            low_i, high_i = min(low_i, height), max(high_i, height)
            height = x * q[0] + y * q[1] + z * q[2]
            low_j, high_j = min(low_j, height), max(high_j, height)
    return low_j - high_i, high_j - low_i


@njit_cached
def ends_at_edge(cells: CellBounds, i: int, j: int, n_groups: int, surely: bool) -> bool:  # pragma: no cover - compiled
    """Whether a sharp edge that is not one between both sides may end (surely: ends) one of them in its cell."""
    one, two = cells.group[i], cells.group[j]
    between = min(one, two) * n_groups + max(one, two)
    for k in (cells.edge_row[i], cells.edge_row[j]):
        if k < 0:
            continue
        for m in range(cells.edge_keys.shape[1]):
            if cells.edge_keys[k, m] >= 0 and cells.edge_keys[k, m] != between:
                return True
        if cells.more_edges[k] and not surely:
            return True
    return False


@njit_cached
def _dot(a: Array, b: Array) -> float:  # pragma: no cover - compiled
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
