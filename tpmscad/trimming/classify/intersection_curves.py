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

from tpmscad._typing import Array, IntArray
from tpmscad.errors import TrimmingError
from tpmscad.splines.bspline import BSplineCurve
from tpmscad.trimming.intersect.body_edges import BodyEdgeIntersections
from tpmscad.trimming.intersect.curve_surface import SubSegments, evaluate_segments
from tpmscad.trimming.intersect.patch_surface import IntersectionCurves
from tpmscad.trimming.operands.face_regions import FaceRegion
from tpmscad.trimming.operands.trimming_body import TrimmingBody

MIN_EDGE_ANGLE_SINE = 1e-5
"""Sine of the angle to an edge below which a track does not tell to which side of it it goes."""

MIN_BORDER_DISTANCE_FRACTION = 5e-5
"""A point that tells lies farther from the face's border than this part of the body: farther than polygons are wrong."""

PROBE_FRACTIONS = np.array([0.19, 0.5, 0.77])
"""Parts of a piece's span where it is looked at; in the middle it may touch an edge that it does not cross."""


@dataclass(frozen=True, slots=True, eq=False)
class FaceSector:
    """A face of the body at a hit: from the edge that begins there, counter-clockwise, to the one that ends there."""

    face: int
    normal: Array
    start_direction: Array
    ends: Array


def collect_face_sectors(body: TrimmingBody, hits: BodyEdgeIntersections) -> dict[tuple[int, int], list[FaceSector]]:
    """By vertex and surface: the faces about every hit."""
    brep = body.brep
    result: dict[tuple[int, int], list[FaceSector]] = {}
    for e, t, v in zip(hits.edge.tolist(), hits.t.tolist(), hits.vertex.tolist(), strict=True):
        along, place = body.curves[e](t, 1), body.curves[e](t)
        along = along / np.linalg.norm(along)
        for k in body.uses[e]:
            f, s = int(body.face_of_use[k]), int(brep.uses.sense[k])
            normal = np.asarray(body.carriers[f].gradient(place))
            result.setdefault((v, int(body.surface[f])), []).append(FaceSector(f, normal, s * along, -s * along))
    at_corner = {w: v for w, v in hits.corner.items()}
    if at_corner:
        for f, before, after, w in list_face_corners(body):
            if w in at_corner:
                normal = np.asarray(body.carriers[f].gradient(brep.vertices[w]))
                sector = FaceSector(
                    f,
                    normal,
                    _evaluate_use_direction(body, after),
                    -_evaluate_use_direction(body, before, backwards=True),
                )
                result.setdefault((at_corner[w], int(body.surface[f])), []).append(sector)
    return result


def list_face_corners(body: TrimmingBody) -> list[tuple[int, int, int, int]]:
    """Every corner of every face: face, the use that ends there, the use that begins there, vertex."""
    brep = body.brep
    faces, uses, edges = brep.faces, brep.uses, brep.edges
    result = []
    for f in range(len(faces)):
        for loop in range(faces.loop_start[f], faces.loop_start[f + 1]):
            own = range(faces.use_start[loop], faces.use_start[loop + 1])
            for i, k in enumerate(own):
                e = uses.edge[k]
                w = edges.start[e] if uses.sense[k] > 0 else edges.end[e]
                result.append((f, own[i - 1], k, int(w)))
    return result


def _evaluate_use_direction(body: TrimmingBody, use: int, backwards: bool = False) -> Array:
    """The direction in which a use begins; or, backwards, the direction in which it ends."""
    edge, sense = body.brep.uses.edge[use], body.brep.uses.sense[use]
    low, high = body.brep.edges.span[edge]
    way = sense * body.curves[edge]((low if sense > 0 else high) if not backwards else (high if sense > 0 else low), 1)
    return np.asarray(way / np.linalg.norm(way))


def find_face_in_direction(sectors: list[FaceSector], way: Array) -> int | None:
    """The face into which a unit direction leads, -1 for none; None where it leads along a border."""
    for sector in sectors:
        side = np.cross(sector.normal, sector.start_direction)
        across = way - (way @ sector.normal) * sector.normal

        def angle(d: Array, sector: FaceSector = sector, side: Array = side) -> float:
            return float(np.arctan2(d @ side, d @ sector.start_direction) % (2 * np.pi))

        a, whole = angle(across), angle(sector.ends)
        if min(abs(a - whole), a, 2 * np.pi - a) < MIN_EDGE_ANGLE_SINE:
            return None
        if a < whole:
            return sector.face
    return -1


def classify_intersection_curves(
    body: TrimmingBody,
    faces: list[FaceRegion],
    tracks: IntersectionCurves,
    pieces: SubSegments,
    curves: Sequence[BSplineCurve],
    hits: BodyEdgeIntersections,
    n_vertices: int,
) -> tuple[IntArray, dict[tuple[int, int], int]]:
    """The face of each piece of a track (-1: none), and by (vertex, surface) of each vertex that is no hit there."""
    surface = tracks.surface[pieces.segment]
    n, k = len(surface), len(body.levels)
    sectors = collect_face_sectors(body, hits)
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
    ways = _evaluate_end_directions(curves, tracks, pieces, piece, end)
    for p, e, way in zip(piece.tolist(), end.tolist(), ways, strict=True):
        vertex = int((pieces.start, pieces.end)[e][p])
        found = find_face_in_direction(sectors[vertex, int(surface[p])], way)
        if found is not None and told.setdefault(int(component[p]), found) != found:
            raise TrimmingError(f"a cut leaves face {told[int(component[p])]} of the body, unseen, for face {found}")
    label = np.full(int(component.max(initial=-1)) + 1, -2)
    label[list(told)] = list(told.values())
    silent = np.flatnonzero(label[component[:n]] == -2)
    if len(silent):
        low, high = pieces.span[silent].T
        t = low[:, None] + (high - low)[:, None] * PROBE_FRACTIONS
        silent = np.repeat(silent, len(PROBE_FRACTIONS))
        points = evaluate_segments(curves, tracks.curve_segments, pieces.segment[silent], t.ravel())
        for c, found in _classify_by_points(body, faces, surface[silent], component[silent], points).items():
            label[c] = found
    of_vertex = {
        (int(key // k), int(key % k)): int(label[c])
        for key, c in zip(joints, component[n:], strict=True)
        if label[c] >= 0
    }
    return label[component[:n]], of_vertex


def _evaluate_end_directions(
    curves: Sequence[BSplineCurve], tracks: IntersectionCurves, pieces: SubSegments, piece: IntArray, end: IntArray
) -> Array:
    """Unit directions in which pieces leave their ends (0: start, 1: end): (n, 3)."""
    result = np.empty((len(piece), 3))
    strands = tracks.curve_segments
    for i, (p, e) in enumerate(zip(piece.tolist(), end.tolist(), strict=True)):
        strand = pieces.segment[p]
        way = strands.motion[strand].apply_to_vectors(curves[strands.curve[strand]](pieces.span[p, e], 1))
        result[i] = way / np.linalg.norm(way) * (1 if e == 0 else -1)
    return result


def _classify_by_points(
    body: TrimmingBody, faces: list[FaceRegion], surface: IntArray, component: IntArray, points: Array
) -> dict[int, int]:
    """The face of each component, by the one of its points that is farthest from the borders of all faces on its surface."""
    face = np.full(len(points), -1)
    apart = np.full(len(points), np.inf)
    for f, region in enumerate(faces):
        at = np.flatnonzero(surface == body.surface[f])
        for rows in np.array_split(at, max(1, len(at) * len(region.segments) // 1_000_000)):
            if len(rows):
                face[rows[region.contains(points[rows])]] = f
                apart[rows] = np.minimum(apart[rows], region.distance_to_border(points[rows]))
    result = {}
    order = np.lexsort((-apart, component))
    component, face, apart = component[order], face[order], apart[order]
    for i in np.flatnonzero(np.diff(component, prepend=-1)):
        if apart[i] < MIN_BORDER_DISTANCE_FRACTION * body.size:
            raise TrimmingError("a patch touches an edge of the body, or nearly")
        result[int(component[i])] = int(face[i])
    return result
