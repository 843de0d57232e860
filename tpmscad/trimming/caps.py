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
from tpmscad.trimming.tool import Array, Flags, Ints, Tool, TrimmingError

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
    on: Flags,
    polylines: PolylineOf,
    inside: Callable[[Array], Array] | None,
) -> ToolPieces:
    """Which parts of the tool's edges lie in the solid."""
    balance = np.zeros((len(tool.planes), len(vertices)), np.int64)  # runs that start less runs that end
    np.add.at(balance, (open_edges.plane, open_edges.start), 1)
    np.add.at(balance, (open_edges.plane, open_edges.end), -1)
    if (np.abs(balance) > 1).any():
        raise TrimmingError("several runs of one cap end in a vertex")
    at_corner = _vertices_at_corners(tool, on)
    hits = [_hits(tool, edge, balance, vertices, on, at_corner) for edge in range(len(tool.edge_planes))]
    claimed = np.zeros_like(balance)
    for (left, right), (v, _, _) in zip(tool.edge_planes, hits, strict=True):
        claimed[left, v] += 1
        claimed[right, v] += 1
    claimed[:, [v for v in at_corner if v >= 0]] = np.abs(balance[:, [v for v in at_corner if v >= 0]])
    if (claimed != (balance != 0)).any():
        plane, v = np.argwhere(claimed != (balance != 0))[0]
        raise TrimmingError(f"the cap in plane {plane} does not close at {vertices[v].round(6)}, off every tool edge")

    inside_at = _end_states(tool, hits, balance, at_corner)
    if not inside_at:
        some = _some_corner(tool, open_edges, polylines, inside)
        inside_at = dict.fromkeys([(e, i) for e in range(len(hits)) for i in (0, 1)], some)
    rows = []
    for e, (v, _, x) in enumerate(hits):
        names = [at_corner[c] if at_corner[c] >= 0 else -1 - c for c in tool.edge_corners[e]]
        names[1:1] = v.tolist()
        stops = [0.0, *x.tolist(), tool.length(e)]
        rows += [
            (e, stops[i], stops[i + 1], names[i], names[i + 1])
            for i in range(0 if inside_at[e, 0] else 1, len(names) - 1, 2)
        ]
    table = np.array(rows).reshape(-1, 5)
    return ToolPieces(table[:, 0].astype(int), table[:, 1:3], table[:, 3].astype(int), table[:, 4].astype(int))


def _vertices_at_corners(tool: Tool, on: Flags) -> list[int]:
    """For every corner of the tool the vertex that lies on all its planes, or -1."""
    result = []
    for corner in range(len(tool.corners)):
        planes = np.unique(tool.edge_planes[(tool.edge_corners == corner).any(axis=1)])
        found = np.flatnonzero(on[:, planes].all(axis=1))
        if len(found) > 1:
            raise TrimmingError(f"several vertices lie at the tool's corner {tool.corners[corner]}")
        result.append(int(found[0]) if len(found) else -1)
    return result


def _hits(
    tool: Tool, edge: int, balance: Ints, vertices: Array, on: Flags, at_corner: list[int]
) -> tuple[Ints, Ints, Array]:
    """Vertices inside a tool edge where the solid begins (+1: runs of its left cap end) or ends (-1), and how far along."""
    (left, right), (a, b) = tool.edge_planes[edge], tool.edge_corners[edge]
    v = np.flatnonzero((balance[left] != 0) & on[:, left] & on[:, right])
    v = v[~np.isin(v, [at_corner[a], at_corner[b]])]
    if (balance[right, v] != -balance[left, v]).any():
        raise TrimmingError(f"the caps in planes {left} and {right} disagree along their common edge")
    x = (vertices[v] - tool.corners[a]) @ (tool.corners[b] - tool.corners[a]) / tool.length(edge)
    order = np.argsort(x)
    v, x = v[order], x[order]
    way = -balance[left, v]
    if (way[1:] == way[:-1]).any() or (x < 0).any() or (x > tool.length(edge)).any():
        raise TrimmingError("in and out do not alternate along a tool edge")
    return v, way, x


def _end_states(
    tool: Tool, hits: list[tuple[Ints, Ints, Array]], balance: Ints, at_corner: list[int]
) -> dict[tuple[int, int], bool]:
    """Whether the solid is at end 0, 1 of each tool edge; empty if nothing tells.

    Along an edge without hits both ends agree, and so do the ends that meet in a corner. In a corner that is a vertex of the
    lattice a cap's runs balance with the edges before and after the corner, counter-clockwise round the cap.
    """
    known: dict[tuple[int, int], bool] = {}
    same: list[tuple[tuple[int, int], tuple[int, int]]] = []

    def learn(end: tuple[int, int], value: bool) -> None:
        if known.setdefault(end, value) != value:
            corner = tool.corners[tool.edge_corners[end]]
            raise TrimmingError(f"tool edges disagree on whether {corner} is in the solid")

    for e, (_, way, _) in enumerate(hits):
        if len(way):
            learn((e, 0), bool(way[0] < 0))
            learn((e, 1), bool(way[-1] > 0))
        else:
            same.append(((e, 0), (e, 1)))
    for corner, vertex in enumerate(at_corner):
        for plane in range(len(tool.planes)):
            before, after = _round_corner(tool, plane, corner)
            if before is None or after is None:
                continue
            runs = balance[plane, vertex] if vertex >= 0 else 0
            if runs == 0:
                same.append((before, after))
            else:
                learn(before, bool(runs > 0))
                learn(after, bool(runs < 0))
    if not known:
        return {}
    changed = True
    while changed:
        size = len(known)
        for p, q in same:
            if p in known:
                learn(q, known[p])
            elif q in known:
                learn(p, known[q])
        changed = len(known) > size
    return known


def _round_corner(tool: Tool, plane: int, corner: int) -> tuple[tuple[int, int] | None, tuple[int, int] | None]:
    """The ends (tool edge, 0 or 1) at a corner before and after it, counter-clockwise round a plane's face."""
    before = after = None
    for e, (sides, ends) in enumerate(zip(tool.edge_planes, tool.edge_corners, strict=True)):
        for side, order in ((0, (0, 1)), (1, (1, 0))):
            if sides[side] == plane and ends[order[1]] == corner:
                before = (e, order[1])
            if sides[side] == plane and ends[order[0]] == corner:
                after = (e, order[0])
    return before, after


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
