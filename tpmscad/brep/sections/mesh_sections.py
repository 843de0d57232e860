"""Sections of a closed triangle mesh by horizontal planes: closed contours, joined by the sides of triangles, and their areas.

A point counts as above a plane if it lies in it, so that no case is special; each point of a contour is computed once, from the
ends of a side in a fixed order.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from tpmscad._compiled_loops import njit_cached
from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.brep.sections.layer_contours import LayerContours
from tpmscad.brep.sections.polygon_regions import choose_points
from tpmscad.errors import TrimmingError


def cut_mesh(points: Array, triangles: IntArray, levels: Array, error: float) -> LayerContours:
    """The sections of a mesh at ascending heights (l,), with fewer points, all others within `error` of the chords.

    TrimmingError if the mesh is open at one of them.
    """
    found = LayerContours(*_cut_triangles(points, triangles, levels, error))
    if (found.areas != found.areas).any():
        raise TrimmingError("the triangles are open in the plane of a layer")
    return found


@njit_cached
def measure_sections(points: Array, triangles: IntArray, levels: Array) -> Any:
    """The areas (l,) of the sections of a closed mesh at ascending heights (l,)."""
    areas = np.zeros(len(levels))
    for t in range(len(triangles)):
        first, last = _list_levels(points, triangles[t], levels)
        for at in range(first, last):
            x0, y0, x1, y1, _, _ = _cross_triangle(points, triangles[t], levels[at])
            areas[at] += 0.5 * (x0 * y1 - x1 * y0)
    return areas


@njit_cached
def _list_levels(points: Array, corners: IntArray, levels: Array) -> Any:
    """The range of the levels that cross a triangle."""
    a, b, c = points[corners[0], 2], points[corners[1], 2], points[corners[2], 2]
    return np.searchsorted(levels, min(a, b, c), "right"), np.searchsorted(levels, max(a, b, c), "right")


@njit_cached
def _cross_triangle(points: Array, corners: IntArray, level: float) -> Any:
    """Start and end of the section of a triangle, the solid on its left, and the keys of the sides that they lie on."""
    x0, y0, x1, y1, start, end = 0.0, 0.0, 0.0, 0.0, 0, 0
    for k in range(3):
        i, j = corners[k], corners[(k + 1) % 3]
        falls = points[i, 2] >= level
        if falls == (points[j, 2] >= level):
            continue
        a, b = min(i, j), max(i, j)
        share = (level - points[a, 2]) / (points[b, 2] - points[a, 2])
        x = points[a, 0] + share * (points[b, 0] - points[a, 0])
        y = points[a, 1] + share * (points[b, 1] - points[a, 1])
        key = np.int64(a) * len(points) + b
        if falls:
            x0, y0, start = x, y, key
        else:
            x1, y1, end = x, y, key
    return x0, y0, x1, y1, start, end


@njit_cached
def _cut_triangles(points: Array, triangles: IntArray, levels: Array, error: float) -> Any:
    """The fields of `LayerContours`; the area of a level at which the mesh is open is not a number."""
    crossing, begins = _sort_by_level(points, triangles, levels)
    contours, starts, of, total = np.empty((len(crossing), 2)), [0], [0], 0
    areas, perimeters = np.zeros(len(levels)), np.zeros(len(levels))
    for at in range(len(levels)):
        xy, following = _link_sections(points, triangles[crossing[begins[at] : begins[at + 1]]], levels[at])
        n = len(xy)
        if n > 0 and following[0] < 0:
            areas[at] = np.nan
            continue
        path, seen = np.empty((n + 1, 2)), np.zeros(n, np.bool_)
        for first in range(n):
            if seen[first]:
                continue
            length = _follow_contour(xy, following, first, seen, path)
            area = 0.0
            for k in range(length):
                area += 0.5 * (path[k, 0] * path[k + 1, 1] - path[k + 1, 0] * path[k, 1])
                perimeters[at] += np.hypot(path[k + 1, 0] - path[k, 0], path[k + 1, 1] - path[k, 1])
            areas[at] += area
            kept = choose_points(path[: length + 1], error)
            if kept.sum() < 3:
                continue
            for k in range(length):
                if kept[k]:
                    contours[total] = path[k]
                    total += 1
            starts.append(total)
            of.append(at)
    return contours[:total].copy(), np.array(starts), np.array(of)[1:], areas, perimeters


@njit_cached
def _sort_by_level(points: Array, triangles: IntArray, levels: Array) -> Any:
    """The triangles that cross each level, level after level, and where each begins, with the end (l + 1,)."""
    counts = np.zeros(len(levels) + 1, np.int64)
    for t in range(len(triangles)):
        first, last = _list_levels(points, triangles[t], levels)
        for at in range(first, last):
            counts[at + 1] += 1
    begins = np.cumsum(counts)
    crossing, filled = np.empty(begins[-1], np.int32), begins[:-1].copy()
    for t in range(len(triangles)):
        first, last = _list_levels(points, triangles[t], levels)
        for at in range(first, last):
            crossing[filled[at]] = t
            filled[at] += 1
    return crossing, begins


@njit_cached
def _link_sections(points: Array, triangles: IntArray, level: float) -> Any:
    """Where the sections of triangles (n, 3) that cross a level start, (n, 2), and the one that follows each, (n,).

    The first one is -1 if the mesh is open there.
    """
    n, size = len(triangles), 4
    xy, following = np.empty((n, 2)), np.empty(n, np.int64)
    start, end = np.empty(n, np.int64), np.empty(n, np.int64)
    while size < 2 * n:
        size *= 2
    table = np.full(size, -1)  # sections by the side that they start on, with open addressing
    for s in range(n):
        xy[s, 0], xy[s, 1], _, _, start[s], end[s] = _cross_triangle(points, triangles[s], level)
        slot = _hash(start[s], size)
        while table[slot] >= 0:
            slot = (slot + 1) % size
        table[slot] = s
    taken = np.zeros(n, np.bool_)
    for s in range(n):
        slot = _hash(end[s], size)
        while table[slot] >= 0 and (start[table[slot]] != end[s] or taken[table[slot]]):
            slot = (slot + 1) % size
        if table[slot] < 0:
            following[0] = -1
            break
        following[s] = table[slot]
        taken[table[slot]] = True
    return xy, following


@njit_cached
def _follow_contour(xy: Array, following: IntArray, first: int, seen: BoolArray, path: Array) -> int:
    """The number of points of the contour from a section on, which are written to `path`, with the first one again at the end."""
    length, s = 0, first
    while not seen[s]:
        seen[s] = True
        if length == 0 or xy[s, 0] != path[length - 1, 0] or xy[s, 1] != path[length - 1, 1]:
            path[length] = xy[s]
            length += 1
        s = following[s]
    path[length] = path[0]
    return length


@njit_cached
def _hash(key: int, size: int) -> Any:
    word = np.uint64(key)
    word = (word ^ (word >> np.uint64(33))) * np.uint64(0xFF51AFD7ED558CCD)
    return np.int64((word ^ (word >> np.uint64(33))) % np.uint64(size))
