"""Classification of the imprints' pieces: the face of the body on which each piece lies, or none.

Where an imprint passes a point of a body's edge, its direction tells into which face it continues. The label propagates from
piece to piece over all other vertices. A component that passes no such point lies on one face as a whole, or on none, and is
classified by points on it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.brep.linked_items import label_linked
from tpmscad.errors import TrimmingError
from tpmscad.trimming.intersect.arrangement import Arrangement
from tpmscad.trimming.intersect.curve_surface import evaluate_segments
from tpmscad.trimming.operands.trimming_body import TrimmingBody, list_face_corners

MIN_EDGE_ANGLE_SINE = 1e-5
"""Sine of the angle to an edge below which the direction of an imprint is undecided."""

MIN_BORDER_DISTANCE_FRACTION = 5e-5
"""Distance from a face's border, relative to the body, above which a point decides: polygons deviate by less."""

PROBE_FRACTIONS = np.array([0.19, 0.5, 0.77])
"""Fractions of a piece's span where it is probed; one point alone may touch an edge that the piece does not cross."""

PAIRS_PER_BATCH = 1_000_000
"""Pairs of a point and a polygon segment tested in one batch."""


@dataclass(frozen=True, slots=True, eq=False)
class FaceSector:
    """The sector of a face at a vertex: counter-clockwise from the edge that starts there to the edge that ends there."""

    face: int
    normal: Array
    start_direction: Array
    end_direction: Array


def classify_intersection_curves(a: Arrangement) -> Arrangement:
    """The arrangement with the faces of the imprints' pieces and of their vertices."""
    imprints, pieces = a.imprints, a.imprint_pieces
    surface = imprints.surface[pieces.segment]
    n, k = len(surface), len(a.operands.body.surfaces)
    sectors = _collect_face_sectors(a)
    keys = a.vertex_surface_key(np.column_stack([pieces.start, pieces.end]), surface[:, None])
    stops = np.array([v * k + s for v, s in sectors], np.int64)
    stopped = np.isin(keys, stops)
    joints, joint = np.unique(keys, return_inverse=True)
    joint = joint.reshape(keys.shape)
    piece, end = np.nonzero(~stopped)
    component = label_linked(n + len(joints), np.column_stack([piece, n + joint[piece, end]]))

    face_of_component: dict[int, int] = {}
    piece, end = np.nonzero(stopped)
    directions = _evaluate_end_directions(a, piece, end)
    for p, e, direction in zip(piece.tolist(), end.tolist(), directions, strict=True):
        vertex = int((pieces.start, pieces.end)[e][p])
        found = find_face_in_direction(sectors[vertex, int(surface[p])], direction)
        if found is not None and face_of_component.setdefault(int(component[p]), found) != found:
            raise TrimmingError(
                f"an intersection curve passes from face {face_of_component[int(component[p])]} of the body to face "
                f"{found} without crossing an edge"
            )
    face = np.full(int(component.max(initial=-1)) + 1, -2)
    face[list(face_of_component)] = list(face_of_component.values())
    undecided = np.flatnonzero(face[component[:n]] == -2)
    if len(undecided):
        low, high = pieces.span[undecided].T
        t = low[:, None] + (high - low)[:, None] * PROBE_FRACTIONS
        undecided = np.repeat(undecided, len(PROBE_FRACTIONS))
        points = evaluate_segments(a.curves, imprints.curve_segments, pieces.segment[undecided], t.ravel())
        for c, found in _classify_by_points(a, surface[undecided], component[undecided], points).items():
            face[c] = found
    vertex_face = {
        (int(key // k), int(key % k)): int(face[c])
        for key, c in zip(joints, component[n:], strict=True)
        if face[c] >= 0
    }
    on_body = np.array([v * k + s for v, s in (*vertex_face, *sectors)], np.int64)
    return replace(a, piece_face=face[component[:n]], vertex_face=vertex_face, keys_on_body=on_body)


def _collect_face_sectors(a: Arrangement) -> dict[tuple[int, int], list[FaceSector]]:
    """The sectors of faces at every point of the body's edges, by (vertex, surface)."""
    body, points = a.operands.body, a.body_edge_points
    brep = body.brep
    result: dict[tuple[int, int], list[FaceSector]] = {}
    for e, t, v in zip(points.edge.tolist(), points.edge_parameter.tolist(), points.vertex.tolist(), strict=True):
        tangent, place = body.curves[e](t, 1), body.curves[e](t)
        tangent = tangent / np.linalg.norm(tangent)
        for k in body.uses[e]:
            f, s = int(body.face_of_use[k]), int(brep.uses.sense[k])
            normal = np.asarray(body.carriers[f].gradient(place))
            sector = FaceSector(f, normal, s * tangent, -s * tangent)
            result.setdefault((v, int(body.surface_of_face[f])), []).append(sector)
    if points.vertex_of_body_vertex:
        for f, before, after, w in list_face_corners(body):
            if w in points.vertex_of_body_vertex:
                normal = np.asarray(body.carriers[f].gradient(brep.vertices[w]))
                start, end = _evaluate_use_direction(body, after), _evaluate_use_direction(body, before, at_end=True)
                key = points.vertex_of_body_vertex[w], int(body.surface_of_face[f])
                result.setdefault(key, []).append(FaceSector(f, normal, start, -end))
    return result


def _evaluate_use_direction(body: TrimmingBody, use: int, at_end: bool = False) -> Array:
    """The unit tangent (3,) of an edge use at its start or at its end."""
    edge, sense = body.brep.uses.edge[use], body.brep.uses.sense[use]
    low, high = body.brep.edges.span[edge]
    tangent = sense * body.curves[edge](high if (sense > 0) == at_end else low, 1)
    return np.asarray(tangent / np.linalg.norm(tangent))


def find_face_in_direction(sectors: list[FaceSector], direction: Array) -> int | None:
    """The face into which a unit direction leads; -1 for none, None along an edge."""
    for sector in sectors:
        side = np.cross(sector.normal, sector.start_direction)
        across = direction - (direction @ sector.normal) * sector.normal

        def angle(d: Array, sector: FaceSector = sector, side: Array = side) -> float:
            return float(np.arctan2(d @ side, d @ sector.start_direction) % (2 * np.pi))

        own, whole = angle(across), angle(sector.end_direction)
        if min(abs(own - whole), own, 2 * np.pi - own) < MIN_EDGE_ANGLE_SINE:
            return None
        if own < whole:
            return sector.face
    return -1


def _evaluate_end_directions(a: Arrangement, piece: IntArray, end: IntArray) -> Array:
    """Unit directions (n, 3) in which pieces leave their ends (0: start, 1: end)."""
    result = np.empty((len(piece), 3))
    segments, pieces = a.imprints.curve_segments, a.imprint_pieces
    for i, (p, e) in enumerate(zip(piece.tolist(), end.tolist(), strict=True)):
        segment = pieces.segment[p]
        tangent = segments.motion[segment].apply_to_vectors(a.curves[segments.curve[segment]](pieces.span[p, e], 1))
        result[i] = tangent / np.linalg.norm(tangent) * (1 if e == 0 else -1)
    return result


def _classify_by_points(a: Arrangement, surface: IntArray, component: IntArray, points: Array) -> dict[int, int]:
    """The face of each component, from its point that is farthest from the borders of all faces on the surface."""
    body = a.operands.body
    face = np.full(len(points), -1)
    apart = np.full(len(points), np.inf)
    for f, region in enumerate(a.operands.regions):
        at = np.flatnonzero(surface == body.surface_of_face[f])
        for rows in np.array_split(at, max(1, len(at) * len(region.segments) // PAIRS_PER_BATCH)):
            if len(rows):
                face[rows[region.contains(points[rows])]] = f
                apart[rows] = np.minimum(apart[rows], region.distance_to_border(points[rows]))
    result = {}
    order = np.lexsort((-apart, component))
    component, face, apart = component[order], face[order], apart[order]
    for i in np.flatnonzero(np.diff(component, prepend=-1)):
        if apart[i] < MIN_BORDER_DISTANCE_FRACTION * body.size:
            raise TrimmingError("a patch touches, or nearly touches, an edge of the body")
        result[int(component[i])] = int(face[i])
    return result
