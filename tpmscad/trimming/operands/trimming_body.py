"""A body made ready to trim by: its surfaces as levels, and for each of its edges what tells that a curve crosses it.

Several faces may lie on one surface. A curve on the surface of a face crosses an edge of this face where the edge's *companion*
vanishes: the other face's surface, or, where the faces are tangent or of one surface, a *fence*, the surface that stands upright
on both along the edge: a plane along a line, a plane, cone or cylinder along a circle.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.brep.boundary_representation import Brep
from tpmscad.brep.carriers import Carrier, Circle, EdgeCurve, Plane, Quadric
from tpmscad.errors import InvalidRequest, TrimmingError
from tpmscad.rigid_motion import Motion
from tpmscad.splines.bspline import BSplineCurve, BSplineSurface
from tpmscad.trimming.operands.implicit_surfaces import CONE, CYLINDER, PLANE, ImplicitSurfaces, build_implicit_surfaces

MIN_FACE_ANGLE_SINE = 0.05
"""Sine of the angle between two faces above which they meet like crossing surfaces."""

NORMAL_SURFACE_TOL = 1e-6
"""How nearly a fence must stand upright on both faces, and hold the edge (in parts of the body)."""

EDGE_SAMPLE_FRACTIONS = np.linspace(0.02, 0.98, 9)
"""Where along an edge its faces are looked at, as parts of its span: not at its ends, where an apex may be."""

BOX_MARGIN_FRACTION = 0.05
"""Boxes about faces are found on samples, and enlarged by this part of their diagonal."""


@dataclass(frozen=True, slots=True, eq=False)
class TrimmingBody:
    """F faces on K surfaces, M edges with two uses each.

    `levels`: the K surfaces, then the fences. `carriers` (F): each face's own carrier, in place. `surface`, `sense` (F,): the
    level a face lies on, and +1 where the level grows out of the solid there, else -1; `turn` (F,): +1 where it grows along
    S_u x S_v. `curves` (M): the edges' curves, in place. `uses` (M, 2) in the complex; `companion` (M, 2): for each use the
    level that vanishes on the edge. `boxes` (F, 2, 3): opposite corners of boxes about the faces. `size`: of all.
    """

    brep: Brep
    levels: ImplicitSurfaces
    n_surfaces: int
    carriers: tuple[Plane | Quadric, ...]
    surface: IntArray
    sense: IntArray
    turn: IntArray
    curves: tuple[EdgeCurve, ...]
    uses: IntArray
    separating_surface: IntArray
    face_boxes: Array
    face_of_use: IntArray
    size: float


def prepare_trimming_body(brep: Brep) -> TrimmingBody:
    """The body ready to trim by; InvalidRequest if it is not closed, TrimmingError if its faces or edges are of other kinds."""
    faces, edges = brep.faces, brep.edges
    carriers = tuple(_place_carrier(brep.carriers[c], faces.motion[i]) for i, c in enumerate(faces.carrier))
    curves = tuple(_place_curve(brep.curves[c], edges.motion[i]) for i, c in enumerate(edges.curve))
    order = np.argsort(brep.uses.edge, kind="stable")
    face = brep.face_of_use
    outward = brep.uses.sense * faces.sense[face]
    count = np.bincount(brep.uses.edge, minlength=len(edges))
    if (count != 2).any() or np.bincount(brep.uses.edge, weights=outward, minlength=len(edges)).any():
        raise InvalidRequest("the body to trim by is not closed: every edge must join two faces")
    uses = order.reshape(-1, 2)

    n = len(faces)
    seen = build_implicit_surfaces(carriers).in_frames(Motion.identity(n))
    rounded = np.round(seen.axis, 9) + 0.0
    turn = np.where(seen.flat & (rounded[np.arange(n), (rounded != 0).argmax(axis=1)] < 0), -1, 1)
    seen = seen.flip_planes(turn)
    size = float(np.linalg.norm(np.ptp(brep.vertices, axis=0))) if len(brep.vertices) else 1.0
    size = max([size, *(float(getattr(c, "radius", 0.0)) for c in carriers)])
    _, first, label = np.unique(seen.key(size), axis=0, return_index=True, return_inverse=True)
    rank = np.argsort(np.argsort(first))
    levels, surface = seen.of(np.sort(first)), rank[label.ravel()]
    levels, companion = _choose_separating_surfaces(levels, surface[face[uses]], edges.span, curves, size)
    return TrimmingBody(
        brep=brep,
        levels=levels,
        n_surfaces=len(first),
        carriers=carriers,
        surface=surface,
        sense=faces.sense * turn,
        turn=turn,
        curves=curves,
        uses=uses,
        separating_surface=companion,
        face_boxes=_bound_faces(brep, carriers, curves),
        face_of_use=face,
        size=size,
    )


def _place_carrier(carrier: Carrier, motion: Motion) -> Plane | Quadric:
    if isinstance(carrier, BSplineSurface):
        raise TrimmingError("a face of the body lies on a B-spline surface, not on a plane or a quadric")
    if motion.is_identity():
        return carrier
    if motion.handedness < 0:
        raise TrimmingError("a face of the body is a mirrored copy")
    return carrier.moved(motion)


def _place_curve(curve: EdgeCurve, motion: Motion) -> EdgeCurve:
    if motion.is_identity():
        return curve
    return curve.moved(motion)


def _choose_separating_surfaces(
    levels: ImplicitSurfaces, surfaces: IntArray, spans: Array, curves: tuple[EdgeCurve, ...], size: float
) -> tuple[ImplicitSurfaces, IntArray]:
    """Levels with the fences added, and the companions (M, 2) of edges between `surfaces` (M, 2)."""
    companion = surfaces[:, ::-1].copy()
    fences: list[ImplicitSurfaces] = []
    for e, (curve, (low, high), pair) in enumerate(zip(curves, spans, surfaces, strict=True)):
        t = low + (high - low) * EDGE_SAMPLE_FRACTIONS
        points = curve(t)
        gradients = levels.of(pair).jet(np.broadcast_to(points, (2, *points.shape)), 1)[1]
        sine = np.linalg.norm(np.cross(*gradients), axis=1)
        if pair[0] != pair[1] and sine.min() > MIN_FACE_ANGLE_SINE:
            continue
        fence = _build_normal_surface(curve, points, curve(t, 1), gradients[0])
        if fence is not None:
            value, gradient = (j[0] for j in fence.jet(points[None], 1))
            upright = np.abs(np.einsum("snk,nk->sn", gradients, gradient)).max()
            if np.abs(value).max() < NORMAL_SURFACE_TOL * size and upright < max(
                NORMAL_SURFACE_TOL, 2 * MIN_FACE_ANGLE_SINE if sine.max() > NORMAL_SURFACE_TOL else 0.0
            ):
                companion[e] = len(levels) + len(fences)
                fences.append(fence)
                continue
        if pair[0] == pair[1] or sine.min() < NORMAL_SURFACE_TOL:
            raise TrimmingError(
                f"faces of the body are tangent along the edge at {points[4].round(6)}, no line nor circle"
            )
    rows = [levels, *fences]
    joined = ImplicitSurfaces(
        *(np.concatenate([getattr(r, name) for r in rows]) for name in ("kind", "point", "axis", "a", "b"))
    )
    return joined, companion


def _build_normal_surface(curve: EdgeCurve, points: Array, tangents: Array, normals: Array) -> ImplicitSurfaces | None:
    """The surface of the normals along a line or a circle; None along other curves."""
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
        across = np.cross(normals[4], tangents[4])
        across /= np.linalg.norm(across)
        return _build_surface_row(PLANE, np.zeros(3), across, -float(across @ points[4]))
    return None


def _build_surface_row(kind: int, point: Array, axis: Array, a: float) -> ImplicitSurfaces:
    return ImplicitSurfaces(np.array([kind]), point[None], axis[None], np.array([a]), np.zeros(1))


def _bound_faces(brep: Brep, carriers: tuple[Plane | Quadric, ...], curves: tuple[EdgeCurve, ...]) -> Array:
    faces, uses, edges = brep.faces, brep.uses, brep.edges
    result = np.empty((len(faces), 2, 3))
    for f, carrier in enumerate(carriers):
        own = range(face_use_range(brep, f)[0], face_use_range(brep, f)[1])
        points, uv = [], []
        for k in own:
            t = edges.span[uses.edge[k], 0] + np.ptp(edges.span[uses.edge[k]]) * np.linspace(0, 1, 17)
            points.append(curves[uses.edge[k]](t))
            if not isinstance(carrier, Plane):
                uv.append(brep.pcurves[uses.pcurve[k]](t))
        if uv:
            (u0, v0), (u1, v1) = np.concatenate(uv).min(axis=0), np.concatenate(uv).max(axis=0)
            u, v = np.meshgrid(np.linspace(u0, u1, 17), np.linspace(v0, v1, 17))
            points.append(carrier(u, v).reshape(-1, 3))
        low, high = np.concatenate(points).min(axis=0), np.concatenate(points).max(axis=0)
        swell = BOX_MARGIN_FRACTION * np.linalg.norm(high - low)
        result[f] = low - swell, high + swell
    return result


def face_use_range(brep: Brep, face: int) -> tuple[int, int]:
    """The uses of one face: from, to."""
    faces = brep.faces
    return int(faces.use_start[faces.loop_start[face]]), int(faces.use_start[faces.loop_start[face + 1]])
