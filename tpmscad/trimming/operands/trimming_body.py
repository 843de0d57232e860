"""The trimming body prepared for intersection: its implicit surfaces and, for each of its edges, two separating surfaces.

Several faces may lie on one surface. A curve on the surface of a face crosses an edge of this face where the *separating surface*
of the edge vanishes. This is the surface of the adjacent face if the two faces meet at an angle. If they are tangent or lie on
one surface, it is the *normal surface*: the ruled surface of the faces' normals along the edge. Along lines and circles of planes
and quadrics it is a plane, a cylinder or a cone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.brep.boundary_representation import Brep
from tpmscad.brep.carriers import Carrier, Circle, EdgeCurve, Plane
from tpmscad.brep.free_form_surface import BodyCarrier, FreeFormSurface
from tpmscad.errors import InvalidRequest, TrimmingError
from tpmscad.rigid_motion import Motion
from tpmscad.splines.bspline import BSplineCurve, BSplineSurface
from tpmscad.trimming.operands.edge_normals import ACROSS_SAMPLES, build_edge_normals
from tpmscad.trimming.operands.quadric_table import (
    CONE,
    CYLINDER,
    PLANE,
    QuadricTable,
    build_edge_normal_row,
    build_implicit_surfaces,
    group_rows,
)

MIN_FACE_ANGLE_SINE = 0.05
"""Sine of the angle between two faces above which their surfaces separate each other."""

NORMAL_SURFACE_TOL = 1e-6
"""Largest cosine between a normal surface's normal and a face's, and largest distance from the edge relative to the body."""

EDGE_SAMPLE_FRACTIONS = np.linspace(0.02, 0.98, 9)
"""Fractions of an edge's span where its faces are compared; the ends are avoided, since an apex may lie there."""

MIDDLE_SAMPLE = 4
"""Index of the middle one of `EDGE_SAMPLE_FRACTIONS`."""

BOX_SAMPLES = 17
"""Samples along each edge, and along u and v of each curved face, from which bounding boxes are found."""

BOX_MARGIN_FRACTION = 0.05
"""Enlargement of the sampled bounding boxes, relative to their diagonals."""


@dataclass(frozen=True, slots=True, eq=False)
class TrimmingBody:
    """A closed body of F faces on K implicit surfaces, with M edges of two uses each.

    `surfaces`: the K surfaces, then the normal surfaces. `carriers` (F): the carriers of the faces, in global coordinates.
    `surface_of_face` (F,): the surface of each face. `sense` (F,): +1 if the distance from it grows out of the solid, else -1.
    `curves` (M): the edges' curves, in global coordinates. `uses` (M, 2): the edge uses of each edge in `brep`.
    `separating_surface` (M, 2): for each use, the surface that vanishes on the edge. `face_boxes` (F, 2, 3): bounding boxes, low
    and high corner. `face_of_use`: the face of every edge use. `size`: diagonal of the body's bounding box, or a larger radius.
    """

    brep: Brep
    surfaces: QuadricTable
    n_surfaces: int
    carriers: tuple[BodyCarrier, ...]
    surface_of_face: IntArray
    sense: IntArray
    curves: tuple[EdgeCurve, ...]
    uses: IntArray
    separating_surface: IntArray
    face_boxes: Array
    face_of_use: IntArray
    size: float


def prepare_trimming_body(brep: Brep, free_form: Mapping[int, FreeFormSurface] | None = None) -> TrimmingBody:
    """The trimming body of a boundary representation; `free_form` has the distances of its spline carriers, by their numbers.

    InvalidRequest if it is not closed, TrimmingError if a face lies on a spline surface without a distance, or two quadrics are
    tangent along an edge that is neither a line nor a circle.
    """
    faces, edges = brep.faces, brep.edges
    forms = free_form or {}
    placed_carriers = ((forms.get(c, brep.carriers[c]), faces.motion[i]) for i, c in enumerate(faces.carrier.tolist()))
    carriers = tuple(_place_carrier(carrier, motion) for carrier, motion in placed_carriers)
    placed = ((brep.curves[c], edges.motion[i]) for i, c in enumerate(edges.curve))
    curves = tuple(curve if motion.is_identity() else curve.moved(motion) for curve, motion in placed)
    order = np.argsort(brep.uses.edge, kind="stable")
    face = brep.face_of_use
    outward = brep.uses.sense * faces.sense[face]
    count = np.bincount(brep.uses.edge, minlength=len(edges))
    if (count != 2).any() or np.bincount(brep.uses.edge, weights=outward, minlength=len(edges)).any():
        raise InvalidRequest("the body to trim by is not closed: every edge must join two faces")
    uses = order.reshape(-1, 2)

    n = len(faces)
    of_face = build_implicit_surfaces(carriers).in_frames(Motion.identity(n))
    flip = np.where(of_face.is_plane & (of_face.leading_coordinate() < 0), -1, 1)
    of_face = of_face.flip_planes(flip)
    size = float(np.linalg.norm(np.ptp(brep.vertices, axis=0))) if len(brep.vertices) else 1.0
    size = max([size, *(float(getattr(c, "radius", 0.0)) for c in carriers)])
    first, label = group_rows(of_face.congruence_key(size))
    rank = np.argsort(np.argsort(first))
    surfaces, surface_of_face = of_face.take(np.sort(first)), rank[label]
    surfaces, separating = _choose_separating_surfaces(surfaces, surface_of_face[face[uses]], edges.span, curves, size)
    return TrimmingBody(
        brep=brep,
        surfaces=surfaces,
        n_surfaces=len(first),
        carriers=carriers,
        surface_of_face=surface_of_face,
        sense=faces.sense * flip,
        curves=curves,
        uses=uses,
        separating_surface=separating,
        face_boxes=_bound_faces(brep, carriers, curves),
        face_of_use=face,
        size=size,
    )


def _place_carrier(carrier: Carrier | FreeFormSurface, motion: Motion) -> BodyCarrier:
    if isinstance(carrier, BSplineSurface):
        raise TrimmingError(
            "a face of the body lies on a B-spline surface, which has no distance: make it a free-form one"
        )
    if motion.is_identity():
        return carrier
    if motion.handedness < 0:
        raise TrimmingError("a face of the body is a mirrored copy")
    return carrier.moved(motion)


def _choose_separating_surfaces(
    surfaces: QuadricTable, pairs: IntArray, spans: Array, curves: tuple[EdgeCurve, ...], size: float
) -> tuple[QuadricTable, IntArray]:
    """The surfaces with normal surfaces appended, and the separating surfaces (M, 2) of edges between `pairs` (M, 2) of them."""
    separating = pairs[:, ::-1].copy()
    appended: list[QuadricTable] = []
    for e, (curve, (low, high), pair) in enumerate(zip(curves, spans, pairs, strict=True)):
        t = low + (high - low) * EDGE_SAMPLE_FRACTIONS
        points = curve(t)
        gradients = surfaces.take(pair).jet(np.broadcast_to(points, (2, *points.shape)), 1)[1]
        sine = np.linalg.norm(np.cross(*gradients), axis=1)
        if pair[0] != pair[1] and sine.min() > MIN_FACE_ANGLE_SINE:
            continue
        normal_surface = _build_normal_surface(curve, points, curve(t, 1), gradients[0])
        if normal_surface is not None:
            value, gradient = (j[0] for j in normal_surface.jet(points[None], 1))
            cosine = np.abs(np.einsum("snk,nk->sn", gradients, gradient)).max()
            if np.abs(value).max() < NORMAL_SURFACE_TOL * size and cosine < max(
                NORMAL_SURFACE_TOL, 2 * MIN_FACE_ANGLE_SINE if sine.max() > NORMAL_SURFACE_TOL else 0.0
            ):
                separating[e] = len(surfaces) + len(appended)
                appended.append(normal_surface)
                continue
        if surfaces.is_free_form[pair].any():
            separating[e] = len(surfaces) + len(appended)
            appended.append(_build_free_form_normals(surfaces.row(int(pair[0])), curve, (float(low), float(high))))
            continue
        if pair[0] == pair[1] or sine.min() < NORMAL_SURFACE_TOL:
            raise TrimmingError(
                f"two faces of the body are tangent along the edge at {points[MIDDLE_SAMPLE].round(6)}, "
                "which is neither a line nor a circle"
            )
    return QuadricTable.concatenate([surfaces, *appended]), separating


def _build_free_form_normals(surface: QuadricTable, curve: EdgeCurve, span: tuple[float, float]) -> QuadricTable:
    """The ruled surface of the normals of a surface (a table of one row) along an edge."""
    t = np.linspace(*span, ACROSS_SAMPLES)
    normals = surface.jet(curve(t)[None], 1)[1][0]
    return build_edge_normal_row(build_edge_normals(curve, span, t, normals))


def _build_normal_surface(curve: EdgeCurve, points: Array, tangents: Array, normals: Array) -> QuadricTable | None:
    """The ruled surface of the normals along a line or a circle; None along other curves."""
    if isinstance(curve, Circle):
        arm = points[0] - curve.origin
        out, up = float(normals[0] @ arm) / curve.radius, float(normals[0] @ curve.normal)
        if abs(up) < NORMAL_SURFACE_TOL:
            return _build_surface_row(PLANE, np.zeros(3), curve.normal, -float(curve.normal @ curve.origin))
        if abs(out) < NORMAL_SURFACE_TOL:
            return _build_surface_row(CYLINDER, curve.origin, curve.normal, curve.radius)
        height = -curve.radius * up / out
        return _build_surface_row(
            CONE, curve.origin + height * curve.normal, -np.sign(height) * curve.normal, float(np.arctan(abs(out / up)))
        )
    if isinstance(curve, BSplineCurve) and curve.degree == 1 and len(curve.poles) == 2:
        across = np.cross(normals[MIDDLE_SAMPLE], tangents[MIDDLE_SAMPLE])
        across /= np.linalg.norm(across)
        return _build_surface_row(PLANE, np.zeros(3), across, -float(across @ points[MIDDLE_SAMPLE]))
    return None


def _build_surface_row(kind: int, point: Array, axis: Array, a: float) -> QuadricTable:
    return QuadricTable(np.array([kind]), point[None], axis[None], np.array([a]), np.zeros(1))


def _bound_faces(brep: Brep, carriers: tuple[BodyCarrier, ...], curves: tuple[EdgeCurve, ...]) -> Array:
    """Bounding boxes (F, 2, 3) of the faces, from samples."""
    uses, edges = brep.uses, brep.edges
    result = np.empty((len(brep.faces), 2, 3))
    for f, carrier in enumerate(carriers):
        points, uv = [], []
        for k in range(*face_use_range(brep, f)):
            span = edges.span[uses.edge[k]]
            t = span[0] + np.ptp(span) * np.linspace(0, 1, BOX_SAMPLES)
            points.append(curves[uses.edge[k]](t))
            if not isinstance(carrier, Plane):
                uv.append(brep.pcurves[uses.pcurve[k]](t))
        if uv:
            (u0, v0), (u1, v1) = np.concatenate(uv).min(axis=0), np.concatenate(uv).max(axis=0)
            u, v = np.meshgrid(np.linspace(u0, u1, BOX_SAMPLES), np.linspace(v0, v1, BOX_SAMPLES))
            points.append(carrier(u, v).reshape(-1, 3))
        low, high = np.concatenate(points).min(axis=0), np.concatenate(points).max(axis=0)
        margin = BOX_MARGIN_FRACTION * np.linalg.norm(high - low)
        result[f] = low - margin, high + margin
    return result


def face_use_range(brep: Brep, face: int) -> tuple[int, int]:
    """The first edge use of a face, and the one after its last."""
    faces = brep.faces
    return int(faces.use_start[faces.loop_start[face]]), int(faces.use_start[faces.loop_start[face + 1]])


def list_face_corners(body: TrimmingBody) -> list[tuple[int, int, int, int]]:
    """Every corner of every face: the face, the use that ends there, the use that starts there, and the vertex."""
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
