"""Loops of a trimmed face in its parameter plane: chaining of directed edges, nesting of holes, area and containment.

A face lies on the left of its directed edges, so an outer loop runs counter-clockwise and a hole clockwise. Loops are found by
topology alone (each edge is followed by one that starts at the vertex where it ends); geometry decides only at vertices where
several edges leave, and in the nesting, where polygons stand for the loops.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from tpmscad._compiled_loops import njit_cached
from tpmscad._typing import Array, BoolArray, IntArray

EndDirection = Callable[[int, bool], Array]
"""The direction (2,) of edge i at its start or, with True, at its end."""

MIN_TURN_RADIANS = 1e-12
"""Turns clockwise by less than this are whole turns: the edge runs back along the one that arrived."""


class LoopError(ValueError):
    """Directed edges that bound no face; `index` is that of the edge or, in nesting, of the loop where it shows."""

    def __init__(self, message: str, index: int) -> None:
        super().__init__(message)
        self.index = index


def chain_loops(start: IntArray, end: IntArray, direction: EndDirection) -> list[list[int]]:
    """Loops of n directed edges with the face on their left, as edge indices, from their start and end vertices (n,).

    Where several edges leave a vertex, the loop continues with the first one clockwise from the edge it arrived by: sectors of
    the face that meet in a vertex become separate loops. Raises LoopError if an edge has no unused successor.
    """
    leaving: dict[int, list[int]] = {}
    for i, v in enumerate(start.tolist()):
        leaving.setdefault(v, []).append(i)
    ends = end.tolist()
    loops = []
    unused = dict.fromkeys(range(len(ends)))
    while unused:
        loop = [next(iter(unused))]
        del unused[loop[0]]
        while True:
            arrived = loop[-1]
            candidates = leaving.get(ends[arrived], [])
            if not candidates:
                raise LoopError("the border of a face is open", arrived)
            i = candidates[0] if len(candidates) == 1 else _first_clockwise(candidates, arrived, direction)
            if i == loop[0]:
                break
            if i not in unused:
                raise LoopError("the border of a face runs into itself", arrived)
            del unused[i]
            loop.append(i)
        loops.append(loop)
    return loops


def follow_paths(following: IntArray) -> tuple[IntArray, IntArray]:
    """The elements (n,) path by path, and where each path starts, and n.

    `following` (n,) gives of each element the one after it, or -1 where a path ends; no element follows two others. Open paths
    come first, each from its first element; then cycles, each from its least one.
    """
    begins = np.ones(len(following), bool)
    begins[following[following >= 0]] = False
    return _follow(np.ascontiguousarray(following, np.int64), np.argsort(~begins, kind="stable"))


@njit_cached
def _follow(following: IntArray, first: IntArray) -> tuple[IntArray, IntArray]:  # pragma: no cover - compiled
    """The elements path by path, paths from the elements of `first` on, and where each path starts."""
    order, starts, seen = np.empty_like(following), [0], np.zeros(len(following), np.bool_)
    count = 0
    for at in first:
        if seen[at]:
            continue
        while at >= 0 and not seen[at]:
            seen[at] = True
            order[count] = at
            count += 1
            at = following[at]
        starts.append(count)
    return order, np.array(starts)


def chain_faces(start: IntArray, end: IntArray, paths: Sequence[Array]) -> list[list[list[int]]]:
    """Faces as lists of loops of directed edges, on whose left they lie, by the points (m, 2) along each edge.

    start, end (n,): vertices of the edges. Raises LoopError if they bound no face.
    """

    def direction(i: int, at_end: bool) -> Array:
        return np.asarray(paths[i][-1] - paths[i][-2] if at_end else paths[i][1] - paths[i][0])

    loops = chain_loops(start, end, direction)
    nested = nest_loops([np.concatenate([paths[i] for i in loop]) for loop in loops])  # with steps along poles
    return [[loops[j] for j in members] for members in nested]


def _first_clockwise(candidates: list[int], arrived: int, direction: EndDirection) -> int:
    """The candidate with the smallest clockwise turn from the reversed direction in which edge `arrived` ends."""
    back = -direction(arrived, True)
    d = np.stack([direction(i, False) for i in candidates])
    angle = np.arctan2(back[0] * d[:, 1] - back[1] * d[:, 0], d @ back)
    return candidates[int(np.argmin(np.where(angle > -MIN_TURN_RADIANS, 2 * np.pi - angle, -angle)))]


def nest_loops(polygons: Sequence[Array]) -> list[list[int]]:
    """Faces as lists of loop indices: each counter-clockwise polygon (n, 2), then the clockwise ones directly inside it.

    Raises LoopError for a polygon without area and for a hole outside every outer loop. Containment is tested at the second
    point of a hole: its first one may be a vertex that the hole shares with the outer loop.
    """
    areas = np.array([signed_area(p) for p in polygons])
    if (areas == 0).any():
        raise LoopError("a loop of a face encloses no area", int(np.flatnonzero(areas == 0)[0]))
    outer = [int(i) for i in np.flatnonzero(areas > 0)]
    faces = {i: [i] for i in outer}
    for hole in np.flatnonzero(areas < 0).tolist():
        around = [i for i in outer if areas[i] > -areas[hole] and point_in_polygon(polygons[i], polygons[hole][1])]
        if not around:
            raise LoopError("a hole of a face lies in no outer loop", hole)
        faces[min(around, key=lambda i: areas[i])].append(hole)
    return list(faces.values())


def signed_area(polygon: Array) -> float:
    """Signed area of a closed polygon (n, 2), positive if it runs counter-clockwise."""
    x, y = (polygon - polygon[0]).T  # so that the segment which closes it adds nothing
    return 0.5 * float(x[:-1] @ y[1:] - y[:-1] @ x[1:])


def point_in_polygon(polygon: Array, point: Array) -> bool:
    """Whether a point (2,) lies in a closed polygon (n, 2)."""
    return bool(points_in_polygons(polygon, np.roll(polygon, -1, axis=0), point[None])[0])


def points_in_polygons(start: Array, end: Array, points: Array) -> BoolArray:
    """Whether points (n, 2) lie in the region bounded by segments from start to end (m, 2), by the even-odd rule: (n,).

    A ray from each point towards larger x is intersected with the segments that it may meet: those whose lower end is not above
    the point and whose upper end is. Holes are segments like others.
    """
    (x0, y0), (x1, y1), (x, y) = start.T, end.T, points.T
    segment, point = pair_with_intervals(y, np.minimum(y0, y1), np.maximum(y0, y1))
    crossing = x0[segment] + (y[point] - y0[segment]) * (x1 - x0)[segment] / (y1 - y0)[segment]
    return np.asarray(np.bincount(point[crossing > x[point]], minlength=len(points)) % 2 == 1)


def pair_with_intervals(values: Array, low: Array, high: Array) -> tuple[IntArray, IntArray]:
    """All pairs of half-open intervals [low, high) (m,) and values (n,) in them: numbers (k,) of intervals and of values."""
    order = np.argsort(values)
    first, last = np.searchsorted(values[order], np.stack([low, high]))
    count = last - first
    interval = np.repeat(np.arange(len(count)), count)
    return interval, order[np.arange(len(interval)) + np.repeat(last - np.cumsum(count), count)]
