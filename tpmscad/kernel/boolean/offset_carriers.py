"""The surfaces on which the boundary of an eroded body lies: where the depth below the body's faces is exactly the skin.

A body of planes and quadrics has offsets of the same kinds. Round a concave edge the points of equal depth form a tube, a
cylinder for a straight edge and a torus for a circular one; round a concave corner they form a sphere. So they do round the edge
between a face with a skin and an open face that joins it smoothly or at an obtuse angle. Each surface is cut to a rectangle of
its parameters, extended beside an edge that needs a tube and has none: there the offset faces meet in a mitre.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tpmscad._typing import Array
from tpmscad.brep.boundary_representation import Brep
from tpmscad.brep.carriers import (
    Circle,
    ConicalSurface,
    CylindricalSurface,
    Plane,
    Quadric,
    SphericalSurface,
    ToroidalSurface,
)
from tpmscad.errors import KernelError
from tpmscad.splines.bspline import is_segment

Box = tuple[tuple[float, float], tuple[float, float]]

MITRE_MARGIN = 1.3
"""In skins: by how much the rectangle of a face is extended beside a concave edge without a tube. Mitres of up to 1.45 skins
need 1.05 skins."""

SMOOTH_SINE = 1e-6
"""Sine of the angle at an edge below which its faces count as tangent."""

RIM_OVERHANG = 0.2
"""Radians by which a tube round the edge of an open face reaches beyond that face, so that the two surfaces cross."""

OPEN_RIM_COSINE = 0.72
"""Cosine of the angle between the normals of a face with skin and an open face above which the skin ends in a tube round their
edge; below it the offset face is extended to the open face, where the skin is at most 1.45 times as thick."""

SAME_REL_TOL = 1e-9
"""In body sizes: distance within which two surfaces count as one."""

SAMPLES = 65
"""Points per edge for the extents of faces; 9 of them for the angles at the edge."""

MIN_GAP = 0.1
"""Radians: a smaller gap in the range of an angle is closed."""


@dataclass(frozen=True, slots=True, eq=False)
class CarrierPiece:
    """A rectangle of the parameters of a plane or quadric, and by how much (model units) it is to be extended.

    `sense` is the sign of the outward normal against S_u x S_v.
    """

    carrier: Plane | Quadric
    box: Box
    sense: int
    margin: float


def offset_pieces(
    body: Brep, is_open: NDArray[np.bool_], skin: float, margin: float, mitres: bool = True
) -> list[CarrierPiece]:
    """Pieces of all surfaces on which the boundary of {depth > skin} lies, but for spheres round corners.

    body: planes and quadrics only. is_open (F,): faces from which the depth is not measured; they bound the result themselves.
    margin: by how much, in skins, each piece exceeds its face or edge. Without a margin neighbours that join smoothly end on each
    other; with one they cross. mitres: whether offset faces may meet where a concave edge between faces with a skin has no tube;
    else KernelError.
    """
    tol = SAME_REL_TOL * float(np.linalg.norm(np.ptp(body.vertices, axis=0)))
    tubes, mitred = _make_tubes(body, is_open, skin, margin, mitres)
    pieces = []
    for face in range(len(body.faces)):
        carrier, sense = body.carriers[body.faces.carrier[face]], int(body.faces.sense[face])
        assert isinstance(carrier, Plane | Quadric)
        moved = carrier if is_open[face] else _offset(carrier, sense, skin)
        if moved is None:
            continue
        box = _cut_at_apex(moved, _parameter_box(body, face, moved))
        if box is not None:
            pieces.append(CarrierPiece(moved, box, sense, (MITRE_MARGIN if face in mitred else margin) * skin))
    faces = [_extend_face(face) for face in _merge_same_surfaces(pieces, tol)]
    return faces + [_extend_tube(tube) for tube in _merge_same_surfaces(tubes, tol)]


def _offset(carrier: Plane | Quadric, sense: int, skin: float) -> Plane | Quadric | None:
    """The surface at the distance `skin` against the outward normal; None if it vanishes or crosses itself."""
    by = -sense * skin
    if isinstance(carrier, Plane):
        return replace(carrier, origin=carrier.origin + by * carrier.normal)
    if isinstance(carrier, ConicalSurface):
        return replace(carrier, radius=carrier.radius + by / np.cos(carrier.angle))
    if isinstance(carrier, ToroidalSurface):
        minor = carrier.minor + by
        return replace(carrier, minor=minor) if 0 < minor < carrier.major else None
    radius = carrier.radius + by
    return replace(carrier, radius=radius) if radius > 0 else None


def _parameter_box(body: Brep, face: int, carrier: Plane | Quadric) -> Box:
    """Ranges of u and v of a face; angles are unrolled."""
    loops = body.faces.loop_start[face : face + 2]
    uses = range(*body.faces.use_start[loops].tolist())
    pieces = []
    for use in uses:
        edge, pcurve = body.uses.edge[use], body.uses.pcurve[use]
        t = np.linspace(body.edges.span[edge, 0], body.edges.span[edge, 1], SAMPLES)
        if pcurve >= 0:
            pieces.append(body.pcurves[pcurve](t))
        else:
            pieces.append(carrier.parameters(body.curves[body.edges.curve[edge]](t)))
    low, high = np.concatenate(pieces).min(axis=0), np.concatenate(pieces).max(axis=0)
    return (float(low[0]), float(high[0])), (float(low[1]), float(high[1]))


def _make_tubes(
    body: Brep, is_open: NDArray[np.bool_], skin: float, margin: float, mitres: bool
) -> tuple[list[CarrierPiece], set[int]]:
    """Cylinders and tori round straight and circular concave edges, and the faces at edges that need extension instead."""
    tubes, mitred = [], set()
    for edge in find_edges_with_tubes(body, is_open):
        opened = is_open[list(edge.faces)]
        cosine = float((edge.normals[0] * edge.normals[1]).sum(axis=1).max())
        tube = _tube(body, edge, opened, skin, margin) if edge.concave or cosine > OPEN_RIM_COSINE else None
        if tube is not None:
            tubes.append(tube)
        elif edge.smooth:
            x, y, z = edge.points[len(edge.points) // 2]
            raise KernelError(
                "offset by the skin",
                f"an open face joins a face with a skin smoothly along an edge about ({x:.4g}, {y:.4g}, {z:.4g}) that is neither "
                f"straight nor an arc of a radius above the skin, {skin:g}: the skin has no rim to end at",
            )
        elif edge.concave and not opened.any() and not mitres:
            x, y, z = edge.points[len(edge.points) // 2]
            raise KernelError("offset by the skin", f"no exact tube round the edge about ({x:.4g}, {y:.4g}, {z:.4g})")
        else:
            mitred |= set(edge.faces)
    return tubes, mitred


def find_edges_with_tubes(body: Brep, is_open: NDArray[np.bool_]) -> Iterator[FaceJoint]:
    """Joints round which points may be nearer to the edge than to what its faces with a skin are the interior of.

    They are the concave edges, and those between a face with a skin and an open one at more than a right angle.
    """
    for edge in find_face_joints(body):
        opened = is_open[list(edge.faces)]
        if opened.all():
            continue
        cosine = float((edge.normals[0] * edge.normals[1]).sum(axis=1).max())
        if edge.concave or (opened.any() and cosine > 0):
            yield edge


def _tube(body: Brep, edge: FaceJoint, opened: NDArray[np.bool_], skin: float, margin: float) -> CarrierPiece | None:
    """The sector of a tube between the offsets of both faces of an edge, or from an offset to an open face.

    None if the edge is neither straight nor an arc of a radius above the skin.
    """
    curve, span, points = body.curves[body.edges.curve[edge.index]], body.edges.span[edge.index], edge.points
    margin /= 3
    directions = -edge.normals
    if opened.any():
        closed, beyond = int(np.flatnonzero(~opened)[0]), int(np.flatnonzero(opened)[0])
        along = np.cos(RIM_OVERHANG) * edge.inward[beyond] + np.sin(RIM_OVERHANG) * edge.normals[beyond]
        between = directions[beyond:][:1] if edge.concave else directions[closed:][:1]
        directions = np.concatenate([directions[closed:][:1], between, along[None]])
    if isinstance(curve, Circle) and curve.radius > skin:
        torus = ToroidalSurface(curve.origin, curve.x_axis, curve.normal, curve.radius, skin)
        arm = points - curve.origin
        radial = arm / np.linalg.norm(arm, axis=1, keepdims=True)
        sector = _sector(directions, radial, np.broadcast_to(curve.normal, radial.shape), margin)
        return CarrierPiece(torus, ((float(span[0]), float(span[1])), sector), 1, 3 * margin * skin)
    if is_segment(curve):
        length = float(np.linalg.norm(points[-1] - points[0]))
        x_axis = directions[0, 0]
        tube = CylindricalSurface(points[0], x_axis, (points[-1] - points[0]) / length, skin)
        frame = np.broadcast_to(x_axis, points.shape), np.broadcast_to(tube.y_axis, points.shape)
        return CarrierPiece(tube, (_sector(directions, *frame, margin), (0.0, length)), 1, 3 * margin * skin)
    return None


@dataclass(frozen=True, slots=True, eq=False)
class FaceJoint:
    """An edge between two faces, and how they meet.

    points, tangents (n, 3): along its curve. normals (2, n, 3): outward normals of its faces. inward (2, n, 3): unit vectors
    across the edge into its faces. smooth: tangent all along it. concave: somewhere along it.
    """

    index: int
    faces: tuple[int, int]
    points: Array
    tangents: Array
    normals: Array
    inward: Array
    smooth: bool
    concave: bool


def find_face_joints(body: Brep) -> Iterator[FaceJoint]:
    """The edges of a closed body."""
    owner = body.face_of_use
    order = np.argsort(body.uses.edge, kind="stable")
    for one, two in order.reshape(-1, 2).tolist():
        edge = int(body.uses.edge[one])
        t = np.linspace(body.edges.span[edge, 0], body.edges.span[edge, 1], SAMPLES)[:: SAMPLES // 8]
        curve = body.curves[body.edges.curve[edge]]
        points, tangents = curve(t), curve(t, 1)
        tangents = tangents / np.linalg.norm(tangents, axis=1, keepdims=True)
        faces = int(owner[one]), int(owner[two])
        normals = np.array([body.faces.sense[f] * _gradient(body, f, points) for f in faces])
        inward = np.array(
            [np.cross(_gradient(body, owner[use], points), body.uses.sense[use] * tangents) for use in (one, two)]
        )
        rise = (inward[0] * normals[1]).sum(axis=1)
        smooth, concave = bool(np.abs(rise).max() <= SMOOTH_SINE), bool(rise.max() > SMOOTH_SINE)
        yield FaceJoint(edge, faces, points, tangents, normals, inward, smooth, concave)


def _gradient(body: Brep, face: int, points: Array) -> Array:
    """S_u x S_v, normalised, of a face's carrier at points (n, 3)."""
    carrier = body.carriers[body.faces.carrier[face]]
    assert isinstance(carrier, Plane | Quadric)
    return carrier.gradient(points)


def _sector(directions: Array, x_axis: Array, y_axis: Array, margin: float) -> tuple[float, float]:
    """Range of angles of families of directions (k, n, 3) in frames (n, 3), (n, 3), and a margin.

    Each family is less than half a turn from the one before it.
    """
    angle = np.arctan2((directions * y_axis).sum(axis=2), (directions * x_axis).sum(axis=2))
    angle[0] = angle[0, 0] + np.angle(np.exp(1j * (angle[0] - angle[0, 0])))
    angle = np.unwrap(angle, axis=0)
    return float(angle.min() - margin), float(angle.max() + margin)


def _merge_same_surfaces(pieces: Sequence[CarrierPiece], tol: float) -> list[CarrierPiece]:
    """Pieces of one surface and side as pieces that do not overlap."""
    groups: list[list[CarrierPiece]] = []
    for piece in pieces:
        own = next((g for g in groups if _is_same_surface(g[0], piece, tol)), None)
        if own is None:
            groups.append([piece])
        else:
            own.append(piece)
    merged = []
    for group in groups:
        carrier, sense = group[0].carrier, group[0].sense
        boxes = [piece.box if piece is group[0] else _box_on(carrier, piece) for piece in group]
        v_range = _cover([b[1] for b in boxes], carrier.period[1])
        along_u = [b[0] for b in boxes]
        ranges = _arcs(along_u, carrier.period[0]) if carrier.period[0] else [_cover(along_u, 0.0)]
        margin = max(piece.margin for piece in group)
        merged += [CarrierPiece(carrier, (u_range, v_range), sense, margin) for u_range in ranges]
    return merged


def _is_same_surface(one: CarrierPiece, two: CarrierPiece, tol: float) -> bool:
    """Whether two pieces lie on one surface with the same outward side."""
    a, b = one.carrier, two.carrier
    if type(a) is not type(b):
        return False
    if any(abs(getattr(a, name, 0.0) - getattr(b, name, 0.0)) > tol for name in ("major", "minor")):
        return False
    points = b(*_box_grid(two.box))
    outward = one.sense * a.gradient(points), two.sense * b.gradient(points)
    same_side = bool((outward[0] * outward[1]).sum(axis=-1).min() > 0.5)
    return same_side and bool(np.abs(a.distance(points)).max() <= tol)


def _box_grid(box: Box) -> tuple[Array, Array]:
    """Parameters on a grid of a box: (9, 9) each."""
    u, v = np.meshgrid(*(np.linspace(*side, 9) for side in box), indexing="ij")
    return u, v


def _box_on(carrier: Plane | Quadric, piece: CarrierPiece) -> Box:
    """Ranges of the parameters of a piece on another carrier of the same surface."""
    uv = carrier.parameters(piece.carrier(*_box_grid(piece.box)))
    sides = []
    for axis in (0, 1):
        values = uv[..., axis]
        if carrier.period[axis]:
            values = np.unwrap(np.unwrap(values, axis=0), axis=1)
        sides.append((float(values.min()), float(values.max())))
    return sides[0], sides[1]


def _cover(ranges: Sequence[tuple[float, float]], period: float) -> tuple[float, float]:
    """One range that covers all."""
    if period:
        arcs = _arcs(ranges, period)
        return arcs[0] if len(arcs) == 1 else (0.0, period)
    return min(low for low, _ in ranges), max(high for _, high in ranges)


def _arcs(ranges: Sequence[tuple[float, float]], period: float) -> list[tuple[float, float]]:
    """The union of ranges of an angle as disjoint ranges, or one full turn from 0."""
    placed = sorted((low % period, low % period + min(high - low, period)) for low, high in ranges)
    arcs = [placed[0]]
    for low, high in placed[1:]:
        if low <= arcs[-1][1] + MIN_GAP:
            arcs[-1] = arcs[-1][0], max(arcs[-1][1], high)
        else:
            arcs.append((low, high))
    if len(arcs) > 1 and arcs[0][0] + period <= arcs[-1][1] + MIN_GAP:
        arcs[0] = arcs[-1][0] - period, max(arcs[0][1], arcs[-1][1] - period)
        arcs.pop()
    if len(arcs) == 1 and arcs[0][1] - arcs[0][0] >= period - MIN_GAP:
        return [(0.0, period)]
    return arcs


def _extend_face(piece: CarrierPiece) -> CarrierPiece:
    """The piece with a rectangle larger by its margin, but not beyond apex, pole or a full turn."""
    carrier, (u, v), margin = piece.carrier, piece.box, piece.margin
    if isinstance(carrier, Plane):
        return replace(piece, box=((u[0] - margin, u[1] + margin), (v[0] - margin, v[1] + margin)))
    if isinstance(carrier, SphericalSurface):
        return replace(piece, box=((0.0, 2 * np.pi), (-np.pi / 2, np.pi / 2)))
    if isinstance(carrier, ToroidalSurface):
        return replace(piece, box=(_widen(u, margin / carrier.major), _widen(v, margin / carrier.minor)))
    box, radius = _cut_at_apex(carrier, (u, (v[0] - margin, v[1] + margin))), carrier.radius
    assert box is not None
    if isinstance(carrier, ConicalSurface):
        radius += np.sin(carrier.angle) * (v[0] + v[1]) / 2
    return replace(piece, box=(_widen(u, margin / radius), box[1]))


def _cut_at_apex(carrier: Plane | Quadric, box: Box) -> Box | None:
    """The part of a rectangle that lies on the cone's own nappe; None if there is none."""
    if not isinstance(carrier, ConicalSurface):
        return box
    u, (low, high) = box
    slope = np.sin(carrier.angle)
    apex = float(-carrier.radius / slope)
    low, high = (max(low, apex), high) if slope > 0 else (low, min(high, apex))
    return (u, (low, high)) if low < high else None


def _extend_tube(piece: CarrierPiece) -> CarrierPiece:
    """The tube longer by its margin at both ends."""
    carrier, (u, v), margin = piece.carrier, piece.box, piece.margin
    if isinstance(carrier, ToroidalSurface):
        return replace(piece, box=(_widen(u, margin / carrier.major), v))
    return replace(piece, box=(u, (v[0] - margin, v[1] + margin)))


def _widen(side: tuple[float, float], by: float) -> tuple[float, float]:
    """A range of an angle widened at both ends, or a full turn from 0."""
    low, high = side[0] - by, side[1] + by
    return (low, high) if high - low < 2 * np.pi - MIN_GAP else (0.0, 2 * np.pi)
