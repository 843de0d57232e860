"""Round solids as boundary representations made by hand: solids of revolution in half-turns, and a block with an oblique hole."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import make_interp_spline

from tests.shapes.box_shapes import CORNERS, SIDES
from tpmscad._typing import Array
from tpmscad.brep.boundary_representation import Brep, Edges, EdgeUses, Faces
from tpmscad.brep.carriers import (
    Circle,
    ConicalSurface,
    CylindricalSurface,
    Ellipse,
    Plane,
    SphericalSurface,
    ToroidalSurface,
)
from tpmscad.rigid_motion import Motion
from tpmscad.splines.bspline import BSplineCurve, line_segment

Z = np.array([0.0, 0.0, 1.0])

SURFACE_KINDS = {
    Plane: "plane",
    CylindricalSurface: "cylinder",
    ConicalSurface: "cone",
    SphericalSurface: "sphere",
    ToroidalSurface: "torus",
}
"""The everyday name of each kind of surface: the tag of a revolved face."""


@dataclass(frozen=True)
class To:
    """A straight piece of the profile, to (r, z)."""

    r: float
    z: float


@dataclass(frozen=True)
class Arc:
    """An arc of the profile about (r, z), from the last point by `turn` radians, counter-clockwise positive."""

    r: float
    z: float
    turn: float


def revolved(
    start: tuple[float, float],
    pieces: list[To | Arc],
    rotation: Array | None = None,
    translation: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Brep:
    """The profile, the solid on its left in the half-plane (r, z), turned about z, then moved; a mirror will do.

    It begins and ends on the axis, or it is a loop off the axis.
    """
    rotation = np.eye(3) if rotation is None else rotation
    profile = [np.array(start, float)]
    for piece in pieces:
        last = profile[-1]
        if isinstance(piece, To):
            profile.append(np.array([piece.r, piece.z]))
        else:
            c, s = np.cos(piece.turn), np.sin(piece.turn)
            arm = last - [piece.r, piece.z]
            profile.append(np.array([piece.r + c * arm[0] - s * arm[1], piece.z + s * arm[0] + c * arm[1]]))
    loop = np.allclose(profile[0], profile[-1]) and profile[0][0] > 1e-12
    points = profile[:-1] if loop else profile
    count = len(points)

    def direction(side: int) -> Array:
        return np.array([1.0 - 2.0 * (side % 2), 0.0, 0.0])

    vertices: list[Array] = []
    at: dict[tuple[int, int], int] = {}
    for i, (r, z) in enumerate(points):
        for side in (0, 1):
            if side == 0 or r > 1e-12:
                vertices.append(max(r, 0.0) * direction(side) + z * Z)
            at[i, side] = len(vertices) - 1

    curves, spans, ends = [], [], []

    def edge(curve, span, a: int, b: int) -> int:
        curves.append(curve)
        spans.append(span)
        ends.append((a, b))
        return len(curves) - 1

    parallels = {}
    for i, (r, z) in enumerate(points):
        if r > 1e-12:
            for half in (0, 1):
                circle = Circle(z * Z, direction(0), Z, r)
                span = (half * np.pi, (half + 1) * np.pi)
                parallels[i, half] = edge(circle, span, at[i, half], at[i, 1 - half])

    carriers, uses, senses, use_start, loop_start, pcurves, tag = [], [], [], [0], [0], [], []
    tags = tuple(SURFACE_KINDS.values())

    def use(index: int, sense: int, ends: tuple | None) -> None:
        if ends is not None:
            pcurves.append(line_segment(*ends, domain=spans[index]))
        uses.append((index, sense, -1 if ends is None else len(pcurves) - 1))

    for j, piece in enumerate(pieces):
        a, b = j, (j + 1) % count
        (r0, z0), (r1, z1) = points[a], points[b]
        along = np.array([r1 - r0, z1 - z0])
        if isinstance(piece, Arc):
            v0 = float(np.arctan2(z0 - piece.z, r0 - piece.r))
            v1 = v0 + piece.turn
            up = 1 if piece.turn > 0 else -1
            radius = float(np.hypot(z0 - piece.z, r0 - piece.r))
            frame = piece.z * Z, direction(0), Z
            carrier = SphericalSurface(*frame, radius) if piece.r == 0 else ToroidalSurface(*frame, piece.r, radius)
        else:
            length = float(np.linalg.norm(along))
            up = 1 if z1 >= z0 else -1
            if z0 == z1:
                carrier = Plane(z0 * Z, direction(0), Z if r1 < r0 else -Z)
                v0, v1 = 0.0, length
            elif abs(r1 - r0) < 1e-12:
                carrier, v0, v1 = CylindricalSurface(0 * Z, direction(0), Z, r0), z0, z1
            else:
                carrier = ConicalSurface(z0 * Z, direction(0), Z, r0, float(np.arcsin(up * (r1 - r0) / length)))
                v0, v1 = 0.0, up * length
        planar = isinstance(carrier, Plane)
        meridians = []
        for side in (0, 1):
            if isinstance(piece, Arc):
                curve = Circle(
                    piece.r * direction(side) + piece.z * Z, direction(side), np.cross(direction(side), Z), radius
                )
            else:
                low, high = (a, b) if up > 0 else (b, a)
                curve = line_segment(vertices[at[low, side]], vertices[at[high, side]], (min(v0, v1), max(v0, v1)))
            low, high = (a, b) if up > 0 else (b, a)
            meridians.append(edge(curve, (min(v0, v1), max(v0, v1)), at[low, side], at[high, side]))
        for half in (0, 1):
            u0, u1 = half * np.pi, (half + 1) * np.pi
            sides = []  # along the outward normal's left: start parallel, meridian at u1, end parallel back, meridian at u0 back
            if (a, half) in parallels:
                sides.append((parallels[a, half], 1, ((u0, v0), (u1, v0))))
            sides.append((meridians[1 - half], up, ((u1, min(v0, v1)), (u1, max(v0, v1)))))
            if (b, half) in parallels:
                sides.append((parallels[b, half], -1, ((u0, v1), (u1, v1))))
            sides.append((meridians[half], -up, ((u0, min(v0, v1)), (u0, max(v0, v1)))))
            sense = 1 if planar else up
            for index, way, ends_uv in sides if sense > 0 else reversed(sides):
                use(index, way * sense, None if planar else ends_uv)
            use_start.append(len(uses))
            loop_start.append(len(use_start) - 1)
            carriers.append(carrier)
            senses.append(sense)
            tag.append(tags.index(SURFACE_KINDS[type(carrier)]))
    n, f = len(curves), len(carriers)
    table = np.array(uses)
    turn = round(np.linalg.det(rotation))
    return Brep(
        carriers=tuple(carriers),
        curves=tuple(curves),
        pcurves=tuple(pcurves),
        vertices=np.array(vertices) @ rotation.T + translation,
        edges=Edges(
            np.arange(n),
            Motion(np.tile(rotation, (n, 1, 1)), np.tile(translation, (n, 1)).astype(float)),
            np.array(spans),
            np.array(ends)[:, 0],
            np.array(ends)[:, 1],
            np.zeros(n),
        ),
        uses=EdgeUses(*table.T),
        faces=Faces(
            np.arange(f),
            Motion(np.tile(rotation, (f, 1, 1)), np.tile(translation, (f, 1)).astype(float)),
            turn * np.array(senses),
            np.array(tag),
            np.array(loop_start),
            np.array(use_start),
        ),
        tags=tags,
    )


def cylinder(radius: float, height: float, **place) -> Brep:
    """A cylinder on the xy plane."""
    return revolved((0, 0), [To(radius, 0), To(radius, height), To(0, height)], **place)


def frustum(bottom: float, top: float, height: float, **place) -> Brep:
    """A truncated cone on the xy plane."""
    return revolved((0, 0), [To(bottom, 0), To(top, height), To(0, height)], **place)


def cone(radius: float, height: float, **place) -> Brep:
    """A cone, before it is placed."""
    return revolved((0, 0), [To(radius, 0), To(0, height)], **place)


def sphere(radius: float, **place) -> Brep:
    """A sphere, before it is placed."""
    return revolved((0, -radius), [Arc(0, 0, np.pi)], **place)


def torus(major: float, minor: float, **place) -> Brep:
    """A torus, before it is placed."""
    return revolved((major + minor, 0), [Arc(major, 0, np.pi), Arc(major, 0, np.pi)], **place)


def flask(**place) -> Brep:
    """A round bottle: ball, fillet, neck, rounded lip, bored from above to a conical tip."""
    ball, neck, fillet, bore = 3.0, 1.0, 0.5, 0.6
    rise = float(np.sqrt((ball + fillet) ** 2 - (neck + fillet) ** 2))
    tilt = float(np.arctan2(rise, neck + fillet))
    return revolved(
        (0, -ball),
        [
            Arc(0, 0, np.pi / 2 + tilt),
            Arc(neck + fillet, rise, -tilt),
            To(neck, 6.0),
            Arc((neck + bore) / 2, 6.0, np.pi),
            To(bore, 1.0),
            To(0.0, 0.25),
        ],
        **place,
    )


def pierced_block(size: tuple[float, float, float] = (4.0, 3.0, 2.0), radius: float = 0.8, tilt: float = 0.4) -> Brep:
    """A block about the origin with a hole from below upwards, leaning towards x: elliptic rims, a wall in two halves."""
    half = np.array(size) / 2
    axis, across = np.array([np.sin(tilt), 0.0, np.cos(tilt)]), np.array([np.cos(tilt), 0.0, -np.sin(tilt)])
    corners = (2 * CORNERS - 1) * half
    curves, spans, ends, uses, use_start, loop_start, carriers, pcurves = [], [], [], [], [0], [0], [], []
    known: dict[tuple[int, int], int] = {}
    rim = {}
    vertices = list(corners)
    wall = CylindricalSurface(np.zeros(3), across, axis, radius)
    for z in (-half[2], half[2]):  # the parameter of rim and wall is the angle about the wall's axis
        ellipse = Ellipse(np.array([z * np.tan(tilt), 0.0, z]), np.array([1.0, 0, 0]), Z, radius / np.cos(tilt), radius)
        first = len(vertices)
        vertices += [ellipse(0.0), ellipse(np.pi)]
        for k in (0, 1):
            rim[z > 0, k] = len(curves)
            curves.append(ellipse)
            spans.append((k * np.pi, (k + 1) * np.pi))
            ends.append((first + k, first + 1 - k))
    for k in (0, 1):
        a, b = vertices[8 + k], vertices[10 + k]
        low, high = wall.parameters(a)[1], wall.parameters(b)[1]
        rim["post", k] = len(curves)
        curves.append(line_segment(a, b, (low, high)))
        spans.append((low, high))
        ends.append((8 + k, 10 + k))
    for side in SIDES:
        a, b, _, d = corners[side]
        x, y = (b - a) / np.linalg.norm(b - a), (d - a) / np.linalg.norm(d - a)
        carriers.append(Plane(a, x, np.cross(x, y)))
        for i, j in zip(side, np.roll(side, -1), strict=True):
            key = (min(i, j), max(i, j))
            if key not in known:
                known[key] = len(curves)
                curves.append(line_segment(corners[key[0]], corners[key[1]]))
                spans.append((0.0, 1.0))
                ends.append(key)
            uses.append((known[key], 1 if (i, j) == key else -1, -1))
        use_start.append(len(uses))
        if abs(carriers[-1].normal[2]) > 0.5:
            top = carriers[-1].normal[2] > 0
            uses += [(rim[top, k], -1 if top else 1, -1) for k in ((1, 0) if top else (0, 1))]
            use_start.append(len(uses))
        loop_start.append(len(use_start) - 1)

    def pcurve(curve: BSplineCurve) -> int:
        pcurves.append(curve)
        return len(pcurves) - 1

    for k in (0, 1):
        carriers.append(wall)
        t = np.linspace(k * np.pi, (k + 1) * np.pi, 65)
        rims = []
        for top in (False, True):
            points = curves[rim[top, k]](t)
            fit = make_interp_spline(t, np.column_stack([t, (points @ axis)]), 7)
            rims.append(pcurve(BSplineCurve(fit.c, fit.t, 7)))
        posts = []
        for u, post in ((k * np.pi, k), ((k + 1) * np.pi, 1 - k)):
            low, high = spans[rim["post", post]]
            posts.append(pcurve(line_segment((u, low), (u, high), (low, high))))
        uses += [
            (rim[False, k], 1, rims[0]),
            (rim["post", 1 - k], 1, posts[1]),
            (rim[True, k], -1, rims[1]),
            (rim["post", k], -1, posts[0]),
        ]
        use_start.append(len(uses))
        loop_start.append(len(use_start) - 1)
    n, f = len(curves), len(carriers)
    return Brep(
        carriers=tuple(carriers),
        curves=tuple(curves),
        pcurves=tuple(pcurves),
        vertices=np.array(vertices),
        edges=Edges(np.arange(n), Motion.identity(n), np.array(spans),
                    np.array(ends)[:, 0], np.array(ends)[:, 1], np.zeros(n)),
        uses=EdgeUses(*np.array(uses).T),
        faces=Faces(np.arange(f), Motion.identity(f), np.array([1] * 6 + [-1] * 2),
                    np.array([0] * 6 + [1] * 2), np.array(loop_start), np.array(use_start)),
        tags=("side", "hole"),
    )  # fmt: skip
