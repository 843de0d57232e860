"""Planar caps: what the trimmed lattice leaves open in each plane of the tool, closed along the tool's own edges.

Each open edge runs round its cap with the solid on its left. Where such a run ends, it ends on a tool edge, and the solid lies
before or behind that point: in and out alternate along tool edges, and tool corners take their state from them. Without a hit
on any tool edge the outermost loops of a cap tell, or else the caller's `inside`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tpmscad.trimming import loops
from tpmscad.trimming.tool import Array, Ints, Tool, TrimmingError

PolylineOf = Callable[[Ints], Array]
"""Edges (n,) to points along them (n, m, 3): both ends, a point very near each, and some between."""


@dataclass(frozen=True, slots=True, eq=False)
class OpenEdges:
    """Edges to be capped: plane, edge number, +1 or -1 for the direction of the cap's use, first and last vertex that way."""

    plane: Ints
    edge: Ints
    sense: Ints
    start: Ints
    end: Ints


@dataclass(frozen=True, slots=True, eq=False)
class ToolPieces:
    """Pieces of tool edges that bound the solid: tool edge, span (arc length from its first corner), vertices.

    Vertex -1 - c stands for corner c of the tool.
    """

    tool_edge: Ints
    span: Array
    start: Ints
    end: Ints


def tool_pieces(
    tool: Tool,
    open_edges: OpenEdges,
    vertices: Array,
    on: Array,
    polylines: PolylineOf,
    inside: Callable[[Array], Array] | None,
) -> ToolPieces:
    """Which parts of the tool's edges lie in the solid."""
    k = len(tool.planes)
    balance = np.zeros((k, len(vertices)), np.int64)  # runs that start less runs that end
    np.add.at(balance, (open_edges.plane, open_edges.start), 1)
    np.add.at(balance, (open_edges.plane, open_edges.end), -1)
    if (np.abs(balance) > 1).any():
        raise TrimmingError("several runs of one cap end in a vertex")
    hits = []
    claimed = np.zeros_like(balance)
    for left, right in tool.edge_planes:
        v = np.flatnonzero((balance[left] != 0) & on[:, left] & on[:, right])
        if (balance[right, v] != -balance[left, v]).any():
            raise TrimmingError(f"the caps in planes {left} and {right} disagree along their common edge")
        claimed[left, v] += 1
        claimed[right, v] += 1
        hits.append((v, balance[left, v]))
    if (claimed != (balance != 0)).any():
        plane, v = np.argwhere(claimed != (balance != 0))[0]
        raise TrimmingError(f"the cap in plane {plane} does not close at {vertices[v].round(6)}, off every tool edge")

    # state[c]: whether corner c is in the solid; a run that ends on a tool edge (balance -1) has the solid behind it
    state: dict[int, bool] = {}
    plain: list[tuple[int, int]] = []
    sorted_hits = []
    for (a, b), (v, way) in zip(tool.edge_corners.tolist(), hits, strict=True):
        along = tool.corners[b] - tool.corners[a]
        x = (vertices[v] - tool.corners[a]) @ along / np.linalg.norm(along)
        order = np.argsort(x)
        v, way, x = v[order], way[order], x[order]
        if (way[1:] == way[:-1]).any() or (x < 0).any() or (x > np.linalg.norm(along)).any():
            raise TrimmingError("in and out do not alternate along a tool edge")
        sorted_hits.append((v, way, x))
        if len(v) == 0:
            plain.append((a, b))
            continue
        for corner, is_in in ((a, way[0] > 0), (b, way[-1] < 0)):
            if state.setdefault(corner, bool(is_in)) != is_in:
                raise TrimmingError(f"tool edges disagree on whether corner {tool.corners[corner]} is in the solid")
    if not state:
        state[0] = _some_corner(tool, open_edges, polylines, inside)
    for _ in range(len(tool.corners)):
        for a, b in plain:
            for p, q in ((a, b), (b, a)):
                if p in state and state.setdefault(q, state[p]) != state[p]:
                    raise TrimmingError(f"tool edges disagree on whether corner {tool.corners[q]} is in the solid")

    rows = []
    for e, (v, _, x) in enumerate(sorted_hits):
        a, b = tool.edge_corners[e].tolist()
        names = [-1 - a, *v.tolist(), -1 - b]
        stops = [0.0, *x.tolist(), float(np.linalg.norm(tool.corners[b] - tool.corners[a]))]
        begin = 0 if state[a] else 1
        rows += [(e, stops[i], stops[i + 1], names[i], names[i + 1]) for i in range(begin, len(names) - 1, 2)]
    table = np.array(rows).reshape(-1, 5)
    return ToolPieces(table[:, 0].astype(int), table[:, 1:3], table[:, 3].astype(int), table[:, 4].astype(int))


def _some_corner(
    tool: Tool, open_edges: OpenEdges, polylines: PolylineOf, inside: Callable[[Array], Array] | None
) -> bool:
    """Whether the tool's corners, alike all of them, are in the solid."""
    for plane in range(len(tool.planes)):
        at = np.flatnonzero(open_edges.plane == plane)
        if len(at):
            polygons = cap_loops(tool, plane, open_edges, at, polylines)[1]
            outermost = max(
                polygons, key=lambda p: p[:, 0].max()
            )  # no loop reaches further: a cap's or a hole's border
            return loops.area(outermost) < 0
    if inside is None:
        raise TrimmingError("no edge of the lattice meets the tool: pass `inside` to tell solid from void")
    return bool(np.asarray(inside(tool.corners[:1]))[0])


def cap_loops(
    tool: Tool, plane: int, open_edges: OpenEdges, at: Ints, polylines: PolylineOf
) -> tuple[list[list[int]], list[Array]]:
    """The loops of one cap as lists of members of `at`, and each as a polygon in the plane's (u, v)."""
    points = tool.planes[plane].parameters(polylines(open_edges.edge[at]))
    back = open_edges.sense[at] < 0
    points[back] = points[back, ::-1]

    def direction(i: int, at_end: bool) -> Array:
        return points[i, -1] - points[i, -2] if at_end else points[i, 1] - points[i, 0]

    chained = loops.chain(open_edges.start[at], open_edges.end[at], direction)
    return chained, [points[loop][:, :-1].reshape(-1, 2) for loop in chained]
