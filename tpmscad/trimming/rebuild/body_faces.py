"""The parts of the body's edges inside the lattice's solid: together with the cap boundary they bound the body's faces there.

The trimmed lattice is used once along each edge of the cap boundary, and a face of the body must use it the other way. These
edges run round the part of the face with the solid on their left. Where such a run ends, it ends on an edge of the body, and the
solid lies before or behind that point. So in and out alternate along the body's edges, and propagate over its vertices.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.errors import TrimmingError
from tpmscad.trimming.classify.propagation import InsideVotes
from tpmscad.trimming.intersect.arrangement import Arrangement
from tpmscad.trimming.operands.trimming_body import list_face_corners

InLattice = Callable[[Array], BoolArray]
"""The points (n, 3) that lie in a domain: (n,). Evaluated only for parts of the body's edges that meet no lattice face."""

PROBE_FRACTIONS = (0.5, 0.21, 0.83)
"""Fractions of a piece's span at which it may be probed against the lattice's solid."""


@dataclass(frozen=True, slots=True, eq=False)
class CapBoundary:
    """The edges that the body's faces must close: the face, the edge, +1 or -1 for its direction, first and last vertex."""

    face: IntArray
    edge: IntArray
    sense: IntArray
    start: IntArray
    end: IntArray


@dataclass(frozen=True, slots=True, eq=False)
class BodySubEdges:
    """Pieces of the body's edges: edge, span (n, 2), start and end vertex; vertex w of the body has the number V + w."""

    edge: IntArray
    span: Array
    start: IntArray
    end: IntArray


def select_body_edges(a: Arrangement, boundary: CapBoundary, in_lattice: InLattice) -> BodySubEdges:
    """The pieces of the body's edges that lie in the lattice's solid."""
    body, brep, points = a.operands.body, a.operands.body.brep, a.body_edge_points
    balance = _balance_runs(boundary)
    pieces, first = _split_body_edges(a)
    links: list[tuple[int, int]] = []
    known: list[tuple[int, bool]] = []
    visited = set()

    def pass_vertex(face: int, vertex: int | None, before: int, after: int) -> None:
        """Link two consecutive pieces round a face, or classify both where a run of the boundary starts or ends."""
        b = 0 if vertex is None else balance.get((face, vertex), 0)
        if vertex is not None:
            visited.add((face, vertex))
        if abs(b) > 1:
            at = a.vertices[vertex].round(6)
            raise TrimmingError(f"several intersection curves on face {face} of the body end at {at}")
        if b == 0:
            links.append((before, after))
        else:
            known.extend([(before, b > 0), (after, b < 0)])

    direction = brep.uses.sense * brep.faces.sense[body.face_of_use]  # round the face as seen from outside
    for e in range(len(body.curves)):
        for p in range(first[e], first[e + 1] - 1):
            for k in body.uses[e]:
                order = (p, p + 1) if direction[k] > 0 else (p + 1, p)
                pass_vertex(int(body.face_of_use[k]), int(pieces.end[p]), *order)
    for f, before, after, w in list_face_corners(body):
        i = _find_end_piece(first, int(brep.uses.edge[before]), bool(brep.uses.sense[before] > 0))
        j = _find_end_piece(first, int(brep.uses.edge[after]), bool(brep.uses.sense[after] < 0))
        order = (i, j) if brep.faces.sense[f] > 0 else (j, i)
        pass_vertex(f, points.vertex_of_body_vertex.get(w), *order)
    if balance.keys() - visited:
        f, v = next(iter(balance.keys() - visited))
        raise TrimmingError(f"the cap on face {f} of the body is open at {a.vertices[v].round(6)}, off every edge")

    votes = InsideVotes.of_links(len(pieces.edge), np.array(links, np.int64).reshape(-1, 2))
    for p, inside in known:
        votes.add(p, inside)
    torn = votes.find_contradiction()
    if torn is not None:
        at = body.curves[pieces.edge[torn]](pieces.span[torn, 0]).round(6)
        raise TrimmingError(f"in and out do not alternate along the body's edge at {at}")
    for c in votes.undecided_components():
        own = np.flatnonzero(votes.component == c)
        probes = [
            body.curves[pieces.edge[p]](pieces.span[p, 0] + x * (pieces.span[p, 1] - pieces.span[p, 0]))
            for x in PROBE_FRACTIONS
            for p in own
        ]
        votes.count[c, 1] = _classify_by_probe(in_lattice, np.array(probes))
    kept = votes.inside()
    return BodySubEdges(pieces.edge[kept], pieces.span[kept], pieces.start[kept], pieces.end[kept])


def _balance_runs(boundary: CapBoundary) -> dict[tuple[int, int], int]:
    """By (face, vertex): runs of the cap boundary that start there less runs that end there, where these differ."""
    face = boundary.face.tolist()
    balance = Counter(zip(face, boundary.start.tolist(), strict=True))
    balance.subtract(zip(face, boundary.end.tolist(), strict=True))
    return {key: b for key, b in balance.items() if b}


def _split_body_edges(a: Arrangement) -> tuple[BodySubEdges, IntArray]:
    """All pieces of the body's edges, and the first piece of each edge."""
    body, points = a.operands.body, a.body_edge_points
    edges = body.brep.edges
    spans: list[Array] = []
    ends: list[Array] = []
    first = np.zeros(len(body.curves) + 1, np.int64)
    for e in range(len(body.curves)):
        own = np.flatnonzero(points.edge == e)
        own = own[np.argsort(points.edge_parameter[own])]
        corners = [
            points.vertex_of_body_vertex.get(int(w), len(a.vertices) + int(w)) for w in (edges.start[e], edges.end[e])
        ]
        t = np.array([edges.span[e, 0], *points.edge_parameter[own], edges.span[e, 1]])
        v = np.array([corners[0], *points.vertex[own], corners[1]], np.int64)
        if (np.diff(t) <= 0).any():
            at = body.curves[e](float(t[0])).round(6)
            raise TrimmingError(f"intersections along the body's edge at {at} are not in ascending order")
        spans.append(np.column_stack([t[:-1], t[1:]]))
        ends.append(np.column_stack([v[:-1], v[1:]]))
        first[e + 1] = first[e] + len(own) + 1
    start, end = np.concatenate([np.zeros((0, 2), np.int64), *ends]).T
    edge = np.repeat(np.arange(len(body.curves)), np.diff(first))
    return BodySubEdges(edge, np.concatenate([np.zeros((0, 2)), *spans]), start, end), first


def _find_end_piece(first: IntArray, edge: int, last: bool) -> int:
    return int(first[edge + 1] - 1 if last else first[edge])


def _classify_by_probe(in_lattice: InLattice, points: Array) -> bool:
    """Whether points, all inside or all outside, lie in the solid, from the first one that can be classified."""
    failure = None
    for point in points:
        try:
            return bool(in_lattice(point[None]).all())
        except TrimmingError as error:
            failure = failure or error
    raise TrimmingError(str(failure))
