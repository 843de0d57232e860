"""Directed edges chained into loops by their vertices, and loops sorted into faces with holes."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.errors import TrimmingError

EndDirection = Callable[[int, bool], Array]
"""The direction (2,) in which edge i runs at its start, or (True) at its end."""


def chain_loops(start: IntArray, end: IntArray, direction: EndDirection) -> list[list[int]]:
    """Loops of n directed edges with the face on their left, from the vertices where they start and end.

    Where several edges leave a vertex, the loop takes the first one clockwise from where it came: sectors of a face that
    touch in a vertex become separate loops. TrimmingError where an edge has no successor.
    """
    out: dict[int, list[int]] = {}
    for i, v in enumerate(start.tolist()):
        out.setdefault(v, []).append(i)
    ends = end.tolist()
    loops = []
    unused = dict.fromkeys(range(len(ends)))
    while unused:
        loop = [next(iter(unused))]
        del unused[loop[0]]
        while True:
            candidates = out.get(ends[loop[-1]], [])
            if not candidates:
                raise TrimmingError("the border of a trimmed face is open")
            i = candidates[0] if len(candidates) == 1 else _select_clockwise_successor(candidates, loop[-1], direction)
            if i == loop[0]:
                break
            if i not in unused:
                raise TrimmingError("the border of a trimmed face runs into itself")
            del unused[i]
            loop.append(i)
        loops.append(loop)
    return loops


def _select_clockwise_successor(candidates: list[int], arrived: int, direction: EndDirection) -> int:
    """The candidate that comes first, turning clockwise from where the edge `arrived` came."""
    back = -direction(arrived, True)
    d = np.stack([direction(i, False) for i in candidates])
    angle = np.arctan2(back[0] * d[:, 1] - back[1] * d[:, 0], d @ back)
    return candidates[int(np.argmin(np.where(angle > -1e-12, 2 * np.pi - angle, -angle)))]


def signed_area(polygon: Array) -> float:
    """Signed area of a closed polygon (n, 2), positive counter-clockwise."""
    x, y = (polygon - polygon[0]).T
    return 0.5 * float(x @ np.roll(y, -1) - y @ np.roll(x, -1))


def point_in_polygon(polygon: Array, point: Array) -> bool:
    """Whether a point lies in a closed polygon, by parity."""
    (x0, y0), (x1, y1) = polygon.T, np.roll(polygon, -1, axis=0).T
    straddles = (y0 > point[1]) != (y1 > point[1])
    with np.errstate(divide="ignore", invalid="ignore"):
        x = x0 + (point[1] - y0) * (x1 - x0) / (y1 - y0)
    return bool(np.count_nonzero(straddles & (x > point[0])) % 2)


def nest_loops(polygons: Sequence[Array]) -> list[list[int]]:
    """Faces as lists of loops: each counter-clockwise loop with the clockwise ones directly in it."""
    areas = np.array([signed_area(p) for p in polygons])
    if (areas == 0).any():
        raise TrimmingError("a loop of a trimmed face encloses nothing")
    outer = [int(i) for i in np.flatnonzero(areas > 0)]
    faces = {i: [i] for i in outer}
    for hole in np.flatnonzero(areas < 0).tolist():
        around = [i for i in outer if areas[i] > -areas[hole] and point_in_polygon(polygons[i], polygons[hole][1])]
        if not around:
            raise TrimmingError("a hole of a trimmed face lies in no outer loop")
        faces[min(around, key=lambda i: areas[i])].append(hole)
    return list(faces.values())
