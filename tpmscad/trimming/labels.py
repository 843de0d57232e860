"""Which face of the body each piece of a track lies on, if any.

Where a track passes a hit its direction tells on which side of the body's edge it goes on. That face is carried along from piece
to piece over all vertices that are no hits; a track that passes none lies altogether on one face, or on none, and a point tells.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from tpmscad.splines.bspline import Curve
from tpmscad.trimming.body import Body
from tpmscad.trimming.hits import Hits
from tpmscad.trimming.pieces import Pieces
from tpmscad.trimming.regions import Region
from tpmscad.trimming.strands import points_on
from tpmscad.trimming.tool import Array, Ints, TrimmingError
from tpmscad.trimming.tracks import Tracks

GLANCING = 1e-5
"""Sine of the angle to an edge below which a track does not tell to which side of it it goes."""

SURE = 5e-5
"""A point that tells lies farther from the face's border than this part of the body: farther than polygons are wrong."""

WHERE = np.array([0.19, 0.5, 0.77])
"""Parts of a piece's span where it is looked at; in the middle it may touch an edge that it does not cross."""


@dataclass(frozen=True, slots=True, eq=False)
class Sector:
    """A face of the body at a hit: from the edge that begins there, counter-clockwise, to the one that ends there."""

    face: int
    normal: Array
    begins: Array
    ends: Array


def sectors_at_hits(body: Body, hits: Hits) -> dict[tuple[int, int], list[Sector]]:
    """By vertex and surface: the faces about every hit."""
    complex = body.complex
    result: dict[tuple[int, int], list[Sector]] = {}
    for e, t, v in zip(hits.edge.tolist(), hits.t.tolist(), hits.vertex.tolist(), strict=True):
        along, place = body.curves[e](t, 1), body.curves[e](t)
        along = along / np.linalg.norm(along)
        for k in body.uses[e]:
            f, s = int(body.face_of_use[k]), int(complex.uses.sense[k])
            normal = np.asarray(body.carriers[f].gradient(place))
            result.setdefault((v, int(body.surface[f])), []).append(Sector(f, normal, s * along, -s * along))
    at_corner = {w: v for w, v in hits.corner.items()}
    if at_corner:
        for f, before, after, w in round_vertices(body):
            if w in at_corner:
                normal = np.asarray(body.carriers[f].gradient(complex.vertices[w]))
                sector = Sector(f, normal, _leaving(body, after), -_leaving(body, before, backwards=True))
                result.setdefault((at_corner[w], int(body.surface[f])), []).append(sector)
    return result


def round_vertices(body: Body) -> list[tuple[int, int, int, int]]:
    """Every corner of every face: face, the use that ends there, the use that begins there, vertex."""
    complex = body.complex
    faces, uses, edges = complex.faces, complex.uses, complex.edges
    result = []
    for f in range(len(faces)):
        for loop in range(faces.loop_start[f], faces.loop_start[f + 1]):
            own = range(faces.use_start[loop], faces.use_start[loop + 1])
            for i, k in enumerate(own):
                e = uses.edge[k]
                w = edges.start[e] if uses.sense[k] > 0 else edges.end[e]
                result.append((f, own[i - 1], k, int(w)))
    return result


def _leaving(body: Body, use: int, backwards: bool = False) -> Array:
    """The direction in which a use begins; or, backwards, the direction in which it ends."""
    edge, sense = body.complex.uses.edge[use], body.complex.uses.sense[use]
    low, high = body.complex.edges.span[edge]
    way = sense * body.curves[edge]((low if sense > 0 else high) if not backwards else (high if sense > 0 else low), 1)
    return np.asarray(way / np.linalg.norm(way))


def face_in_direction(sectors: list[Sector], way: Array) -> int | None:
    """The face into which a unit direction leads, -1 for none; None where it leads along a border."""
    for sector in sectors:
        side = np.cross(sector.normal, sector.begins)
        across = way - (way @ sector.normal) * sector.normal

        def angle(d: Array, sector: Sector = sector, side: Array = side) -> float:
            return float(np.arctan2(d @ side, d @ sector.begins) % (2 * np.pi))

        a, whole = angle(across), angle(sector.ends)
        if min(abs(a - whole), a, 2 * np.pi - a) < GLANCING:
            return None
        if a < whole:
            return sector.face
    return -1


def labels(
    body: Body,
    faces: list[Region],
    tracks: Tracks,
    pieces: Pieces,
    curves: Sequence[Curve],
    hits: Hits,
    n_vertices: int,
) -> tuple[Ints, dict[tuple[int, int], int]]:
    """The face of each piece of a track (-1: none), and by (vertex, surface) of each vertex that is no hit there."""
    surface = tracks.surface[pieces.strand]
    n, k = len(surface), len(body.levels)
    sectors = sectors_at_hits(body, hits)
    keys = np.column_stack([pieces.start, pieces.end]) * k + surface[:, None]
    stops = np.array([v * k + s for v, s in sectors], np.int64)
    stopped = np.isin(keys, stops)
    joints, joint = np.unique(keys, return_inverse=True)
    joint = joint.reshape(keys.shape)
    piece, end = np.nonzero(~stopped)
    links = coo_array((np.ones(len(piece), bool), (piece, n + joint[piece, end])), shape=(n + len(joints),) * 2)
    _, component = connected_components(links, directed=False)

    told: dict[int, int] = {}
    piece, end = np.nonzero(stopped)
    ways = _ways(curves, tracks, pieces, piece, end)
    for p, e, way in zip(piece.tolist(), end.tolist(), ways, strict=True):
        vertex = int((pieces.start, pieces.end)[e][p])
        found = face_in_direction(sectors[vertex, int(surface[p])], way)
        if found is not None and told.setdefault(int(component[p]), found) != found:
            raise TrimmingError(f"a cut leaves face {told[int(component[p])]} of the body, unseen, for face {found}")
    label = np.full(int(component.max(initial=-1)) + 1, -2)
    label[list(told)] = list(told.values())
    silent = np.flatnonzero(label[component[:n]] == -2)
    if len(silent):
        low, high = pieces.span[silent].T
        t = low[:, None] + (high - low)[:, None] * WHERE
        silent = np.repeat(silent, len(WHERE))
        points = points_on(curves, tracks.strands, pieces.strand[silent], t.ravel())
        for c, found in _by_points(body, faces, surface[silent], component[silent], points).items():
            label[c] = found
    of_vertex = {
        (int(key // k), int(key % k)): int(label[c])
        for key, c in zip(joints, component[n:], strict=True)
        if label[c] >= 0
    }
    return label[component[:n]], of_vertex


def _ways(curves: Sequence[Curve], tracks: Tracks, pieces: Pieces, piece: Ints, end: Ints) -> Array:
    """Unit directions in which pieces leave their ends (0: start, 1: end): (n, 3)."""
    result = np.empty((len(piece), 3))
    strands = tracks.strands
    for i, (p, e) in enumerate(zip(piece.tolist(), end.tolist(), strict=True)):
        strand = pieces.strand[p]
        way = strands.rotation[strand] @ curves[strands.curve[strand]](pieces.span[p, e], 1)
        result[i] = way / np.linalg.norm(way) * (1 if e == 0 else -1)
    return result


def _by_points(body: Body, faces: list[Region], surface: Ints, component: Ints, points: Array) -> dict[int, int]:
    """The face of each component, by the one of its points that is farthest from the borders of all faces on its surface."""
    face = np.full(len(points), -1)
    apart = np.full(len(points), np.inf)
    for f, region in enumerate(faces):
        at = np.flatnonzero(surface == body.surface[f])
        for rows in np.array_split(at, max(1, len(at) * len(region.segments) // 1_000_000)):
            if len(rows):
                face[rows[region.contains(points[rows])]] = f
                apart[rows] = np.minimum(apart[rows], region.to_border(points[rows]))
    result = {}
    order = np.lexsort((-apart, component))
    component, face, apart = component[order], face[order], apart[order]
    for i in np.flatnonzero(np.diff(component, prepend=-1)):
        if apart[i] < SURE * body.size:
            raise TrimmingError("a patch touches an edge of the body, or nearly")
        result[int(component[i])] = int(face[i])
    return result
