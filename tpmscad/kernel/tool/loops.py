"""What uses laid out in a face's parameters bound: loops chained by vertices, and which of them are holes in which."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tpmscad.kernel.tool.body import SAME_ANGLE, Body, Face, Refused, Use, area, pole_way, polygon, trace
from tpmscad.patches.complex import Array


def regions(body: Body, face: Face, uses: list[Use]) -> list[Face]:
    """The faces that uses laid out in (u, v) bound, each region on its uses' left."""
    loops = _loops(body, face, uses)
    polygons = [polygon(body, face, loop) for loop in loops]
    areas = np.array([area(p) for p in polygons])
    outer = [i for i in np.argsort(areas).tolist() if areas[i] > 0]
    held: dict[int, list[int]] = {i: [i] for i in outer}
    for hole in np.flatnonzero(areas <= 0).tolist():
        around = [i for i in outer if _inside(polygons[hole][0], polygons[i])]
        if not around:
            raise Refused("falls apart when it is cut")
        held[around[0]].append(hole)
    return [replace(face, loops=tuple(loops[i] for i in members)) for members in held.values()]


def _loops(body: Body, face: Face, uses: list[Use]) -> list[tuple[Use, ...]]:
    """The uses chained by their vertices, and where these are not enough by (u, v)."""
    ends = {id(use): trace(body, face, use)[[0, -1]] for use in uses}
    waiting = list(uses)
    loops = []
    while waiting:
        loop = [waiting.pop(0)]
        first = _vertices(body, loop[0])[0]
        while True:
            vertex, end = _vertices(body, loop[-1])[1], ends[id(loop[-1])][1]
            following = [u for u in waiting if _vertices(body, u)[0] == vertex]
            options = {id(u): _gap(body, face, u, end, ends[id(u)][0]) for u in following}
            closing = _gap(body, face, loop[0], end, ends[id(loop[0])][0]) if vertex == first else np.inf
            best = min(following, key=lambda u: options[id(u)], default=None)
            if best is None or closing < options[id(best)]:
                if not np.isfinite(closing):
                    raise Refused("has a border that does not close")
                break
            loop.append(best)
            waiting.remove(best)
        loops.append(tuple(loop))
    return loops


def _vertices(body: Body, use: Use) -> tuple[int, int]:
    edge = body.edges[use.edge]
    return (edge.start, edge.end) if use.sense > 0 else (edge.end, edge.start)


def _gap(body: Body, face: Face, use: Use, end: Array, begin: Array) -> float:
    """How far a use begins from where another ends: in (u, v), or along a pole in the way that keeps the face on the left."""
    way = pole_way(body, face, use)
    if not way:
        return float(np.abs(begin - end).max())
    step = (begin[0] - end[0]) * way
    return float(step) if step > SAME_ANGLE else np.inf


def _inside(point: Array, around: Array) -> bool:
    """Whether a polygon holds a point, by the parity of crossings."""
    (x0, y0), (x1, y1) = around.T, np.roll(around, -1, axis=0).T
    over = (y0 > point[1]) != (y1 > point[1])
    x = x0[over] + (point[1] - y0[over]) / (y1[over] - y0[over]) * (x1[over] - x0[over])
    return bool(np.count_nonzero(x > point[0]) % 2)
