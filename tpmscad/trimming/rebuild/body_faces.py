"""The body's faces inside the lattice's solid: what the trimmed lattice leaves open on each, closed along the body's own edges.

Each open edge runs round its wall with the solid on its left. Where such a run ends, it ends on an edge of the body, and the
solid lies before or behind that point: in and out alternate along the body's edges, and its vertices take their state from them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.errors import TrimmingError
from tpmscad.trimming.classify.intersection_curves import list_face_corners
from tpmscad.trimming.intersect.body_edges import BodyEdgeIntersections
from tpmscad.trimming.operands.trimming_body import TrimmingBody

PROBE_FRACTIONS = (0.5, 0.21, 0.83)
"""Parts of a piece's span at which it may tell whether it is in the solid."""


@dataclass(frozen=True, slots=True, eq=False)
class CapBoundary:
    """Edges to be walled: the body's face, edge number, +1 or -1 for the direction of the wall's use, first and last vertex."""

    face: IntArray
    edge: IntArray
    sense: IntArray
    start: IntArray
    end: IntArray


@dataclass(frozen=True, slots=True, eq=False)
class BodySubEdges:
    """Pieces of the body's edges that bound the solid: edge, span, vertices; vertex -1 - w stands for vertex w of the body."""

    edge: IntArray
    span: Array
    start: IntArray
    end: IntArray


def select_body_edges(
    body: TrimmingBody,
    hits: BodyEdgeIntersections,
    open_edges: CapBoundary,
    vertices: Array,
    in_solid: Callable[[Array], BoolArray],
) -> BodySubEdges:
    """Which parts of the body's edges lie in the lattice's solid."""
    brep = body.brep
    way = brep.uses.sense * brep.faces.sense[body.face_of_use]  # round the face as seen from outside
    balance: dict[tuple[int, int], int] = {}  # by face and vertex, runs that start less runs that end
    for f, a, b in zip(open_edges.face.tolist(), open_edges.start.tolist(), open_edges.end.tolist(), strict=True):
        balance[f, a] = balance.get((f, a), 0) + 1
        balance[f, b] = balance.get((f, b), 0) - 1
    balance = {key: b for key, b in balance.items() if b}
    rows, first = _split_body_edges(body, hits)
    one: list[tuple[int, bool]] = []  # piece, whether it is in the solid
    same: list[tuple[int, int]] = []
    claimed = set()

    def turn(face: int, vertex: int | None, before: int, after: int) -> None:
        b = 0 if vertex is None else balance.get((face, vertex), 0)
        if vertex is not None:
            claimed.add((face, vertex))
        if abs(b) > 1:
            raise TrimmingError(f"several cuts of one face of the body end in {vertices[vertex].round(6)}")
        if b == 0:
            same.append((before, after))
        else:
            one.extend([(before, b > 0), (after, b < 0)])

    for e in range(len(body.curves)):
        for p in range(first[e], first[e + 1] - 1):
            for k in body.uses[e]:
                turn(int(body.face_of_use[k]), rows[p][4], *((p, p + 1) if way[k] > 0 else (p + 1, p)))
    for f, before, after, w in list_face_corners(body):
        i, j = (
            _find_end_piece(first, int(brep.uses.edge[use]), bool(brep.uses.sense[use] > 0) == at_end)
            for use, at_end in ((before, True), (after, False))
        )
        turn(f, hits.corner.get(w), *((i, j) if brep.faces.sense[f] > 0 else (j, i)))
    if balance.keys() - claimed:
        f, v = next(iter(balance.keys() - claimed))
        raise TrimmingError(
            f"the wall on face {f} of the body does not close at {vertices[v].round(6)}, off every edge"
        )

    n = len(rows)
    pairs = np.array(same, np.int64).reshape(-1, 2)
    links = coo_array((np.ones(len(pairs), bool), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    count, component = connected_components(links, directed=False)
    votes = np.zeros((count, 2), np.int64)
    for p, inside in one:
        votes[component[p], int(inside)] += 1
    torn = np.flatnonzero(votes.all(axis=1))
    if len(torn):
        p = int(np.flatnonzero(component == torn[0])[0])
        raise TrimmingError(
            f"in and out do not alternate along the body's edge at {body.curves[rows[p][0]](rows[p][1]).round(6)}"
        )
    for c in np.flatnonzero(~votes.any(axis=1)):
        own = [rows[p] for p in np.flatnonzero(component == c)]
        points = np.array([body.curves[e](low + x * (high - low)) for x in PROBE_FRACTIONS for e, low, high, *_ in own])
        votes[c, 1] = _classify_by_probe(in_solid, points)
    kept = [rows[p] for p in np.flatnonzero(votes[component, 1] > 0)]
    table = np.array([(e, a, b) for e, _, _, a, _, b in kept], np.int64).reshape(-1, 3)
    return BodySubEdges(
        table[:, 0], np.array([(low, high) for _, low, high, _, _, _ in kept]).reshape(-1, 2), table[:, 1], table[:, 2]
    )


def _split_body_edges(
    body: TrimmingBody, hits: BodyEdgeIntersections
) -> tuple[list[tuple[int, float, float, int, int | None, int]], IntArray]:
    """All pieces of the body's edges: edge, span, first vertex, the vertex (or None) between it and the next piece, last
    vertex; and where each edge's begin."""
    edges = body.brep.edges
    rows: list[tuple[int, float, float, int, int | None, int]] = []
    first = np.zeros(len(body.curves) + 1, np.int64)
    for e in range(len(body.curves)):
        own = np.flatnonzero(hits.edge == e)
        own = own[np.argsort(hits.t[own])]
        ends = [hits.corner.get(int(w), -1 - int(w)) for w in (edges.start[e], edges.end[e])]
        t = [float(edges.span[e, 0]), *hits.t[own].tolist(), float(edges.span[e, 1])]
        v = [ends[0], *hits.vertex[own].tolist(), ends[1]]
        if (np.diff(t) <= 0).any():
            raise TrimmingError(
                f"hits along the body's edge at {body.curves[e](t[0]).round(6)} do not follow each other"
            )
        rows += [(e, t[i], t[i + 1], v[i], v[i + 1] if i < len(own) else None, v[i + 1]) for i in range(len(own) + 1)]
        first[e + 1] = len(rows)
    return rows, first


def _find_end_piece(first: IntArray, edge: int, last: bool) -> int:
    return int(first[edge + 1] - 1 if last else first[edge])


def _classify_by_probe(in_solid: Callable[[Array], BoolArray], points: Array) -> bool:
    """Whether points, alike all of them, are in the solid: by the first one that tells."""
    failure = None
    for point in points:
        try:
            return bool(np.asarray(in_solid(point[None])).all())
        except TrimmingError as error:
            failure = failure or error
    raise TrimmingError(str(failure))
