"""Overhang of solids: the area of their faces that lean outwards by more than an angle from the build direction.

The angle of a point of a face is that between the tangent plane and the build direction, arcsin(-n . b): 0 on a vertical wall and
90 degrees under a horizontal ceiling. The area beyond a limit is integrated on the exact faces over the parameters of a
triangulation; triangles that the limit crosses are subdivided, and what remains is cut by the straight line between the points
at the limit.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from OCP.TopoDS import TopoDS_Face

from tpmscad._typing import Array, IntArray
from tpmscad.kernel.export.edge_division import explore_faces
from tpmscad.kernel.export.solid_mesh import FaceTriangulation, triangulate_outlines
from tpmscad.kernel.measure.mass_properties import face_moments
from tpmscad.kernel.occt.bounding_boxes import box_diagonal
from tpmscad.kernel.occt.exploration import faces_of, orientation_sign, solids_of, unwrap

MESH_ANGLE = 0.25
"""Radians between neighbouring facets of the triangulation that carries the quadrature."""

MESH_DEVIATION_DIAGONALS = 1e-3
"""Distance of the triangulation from the faces in diagonals of the shape; the angle decides on curved faces."""

LIMIT_SINE = 1e-9
"""Added to the sine of the limit: a face that leans by the limit itself keeps it, whatever the round-off."""

SUBDIVISIONS = 3
"""Times that a triangle is divided in four where the limit crosses it."""

PLATE_DIAGONALS = 1e-5
"""In diagonals of the shape: what lies within this of the lowest point stands on the build plate."""

STEEPEST_CANDIDATES = 24
"""Triangles in which the steepest place is sought."""

SEARCH_STEPS = 30
"""Halvings of the search for the steepest place."""

CORNER_INSET = 1e-6
"""Fraction of the way from the corner of a triangle to its middle."""

QUADRATURE = np.array([[2 / 3, 1 / 6, 1 / 6], [1 / 6, 2 / 3, 1 / 6], [1 / 6, 1 / 6, 2 / 3]])
"""Barycentric nodes of equal weight of the rule of degree 2."""


@dataclass(frozen=True, slots=True, eq=False)
class Overhang:
    """Area of faces beyond the limit, the greatest angle from the build direction (degrees) and its place (3,).

    Angle and place are those of the whole surface without the bottom on the build plate, whose area is `plate_area`; the angle
    is that of the steepest place even where it is below the limit, and 0 if no face looks down.
    """

    area: float
    angle: float
    place: Array
    plate_area: float


def measure_overhang(shape: Any, build_direction: Array, limit: float) -> Overhang:
    """Overhang of the solids of a shape beyond a limit in degrees, for a unit build direction (3,).

    Raises KernelError if OCCT cannot triangulate the shape.
    """
    deviation = MESH_DEVIATION_DIAGONALS * box_diagonal(unwrap(shape))
    outlines = [explore_faces([faces_of(solid)]) for solid in solids_of(unwrap(shape))]
    meshes = [(triangulate_outlines(each, deviation, MESH_ANGLE), each.sources) for each in outlines]
    points = np.concatenate([found.mesh.points for found, _ in meshes])
    height = points @ build_direction
    plate = float(height.min()) + PLATE_DIAGONALS * float(np.linalg.norm(np.ptp(points, axis=0)))
    sine = np.sin(np.radians(limit)) + LIMIT_SINE
    found = [_measure_solid(mesh, faces, build_direction, sine, plate) for mesh, faces in meshes]
    steepest = max(found, key=lambda one: one.angle)
    return Overhang(
        sum(one.area for one in found), steepest.angle, steepest.place, sum(one.plate_area for one in found)
    )


class _Slopes:
    """Sine of the overhang angle and area density on triangulated faces, at parameters (n, 2) of faces (n,)."""

    def __init__(self, found: FaceTriangulation, faces: Sequence[TopoDS_Face], build_direction: Array) -> None:
        self.surfaces = found.surfaces
        self.sign = np.array([orientation_sign(face) for face in faces])
        self.build_direction = build_direction

    def __call__(self, face: IntArray, uv: Array) -> tuple[Array, Array]:
        """Sines (n,), 0 where the face is singular, and densities (n,)."""
        _, along_u, along_v = self.surfaces(face, uv)
        cross = np.cross(along_u, along_v)
        density = np.linalg.norm(cross, axis=1)
        down = -self.sign[face] * (cross @ self.build_direction)
        return np.divide(down, density, out=np.zeros(len(uv)), where=density > 0.0), density

    def at_corners(self, face: IntArray, uv: Array) -> Array:
        """Sines at the corners of triangles (m, 3, 2), a little inside, where no face is singular: (m, 3)."""
        inside = uv + CORNER_INSET * (uv.mean(axis=1, keepdims=True) - uv)
        return self(np.repeat(face, 3), inside.reshape(-1, 2))[0].reshape(-1, 3)

    def areas(self, face: IntArray, uv: Array) -> Array:
        """Areas of the faces over triangles (m, 3, 2): (m,)."""
        a, b = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
        nodes = np.einsum("qk,mkd->mqd", QUADRATURE, uv).reshape(-1, 2)
        density = self(np.repeat(face, len(QUADRATURE)), nodes)[1].reshape(-1, len(QUADRATURE)).mean(axis=1)
        return 0.5 * np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) * density


def _measure_solid(
    found: FaceTriangulation, faces: Sequence[TopoDS_Face], build_direction: Array, sine: float, plate: float
) -> Overhang:
    """Overhang of one solid; `plate` is the height up to which faces stand on the build plate."""
    slope, mesh, count = _Slopes(found, faces, build_direction), found.mesh, len(faces)
    face, uv = mesh.face, mesh.uv[mesh.triangles]
    on_plate = (mesh.points @ build_direction)[mesh.triangles].max(axis=1) <= plate
    corner, area = slope.at_corners(face, uv), slope.areas(face, uv)
    total, free = np.bincount(face, area, count), np.flatnonzero(~on_plate)
    stands = np.bincount(face, area * (on_plate & (corner.max(axis=1) > 0.0)), count)
    leans = _integrate_beyond(slope, face[free], uv[free], corner[free], area[free], sine)
    needed = np.flatnonzero((total > 0.0) & ((leans > 0.0) | (stands > 0.0)))
    exact = face_moments([faces[i] for i in needed.tolist()])[:, 0] / total[needed]
    steepest = free[np.argsort(-corner[free].max(axis=1), kind="stable")[:STEEPEST_CANDIDATES]]
    angle, place = _find_steepest(slope, face[steepest], uv[steepest], mesh.points[0])
    return Overhang(float(leans[needed] @ exact), angle, place, float(stands[needed] @ exact))


def _integrate_beyond(slope: _Slopes, face: IntArray, uv: Array, corner: Array, area: Array, sine: float) -> Array:
    """Area beyond the limit on each face, over triangles (m, 3, 2) with sines at their corners (m, 3) and areas (m,)."""
    total = np.zeros(len(slope.sign))
    for level in range(SUBDIVISIONS + 1):
        margin = np.ptp(corner, axis=1)  # the extreme of a curved face may lie between the corners
        cut = (corner.min(axis=1) <= sine + margin) & (corner.max(axis=1) > sine - margin)
        total += np.bincount(face, area * (~cut & (corner.min(axis=1) > sine)), len(total))
        face, uv, corner, area = face[cut], uv[cut], corner[cut], area[cut]
        if level == SUBDIVISIONS or not len(uv):
            break
        a, b, c = uv.swapaxes(0, 1)
        ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
        uv = np.concatenate([np.stack(t, axis=1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])
        face = np.tile(face, 4)
        corner, area = slope.at_corners(face, uv), slope.areas(face, uv)
    return total + np.bincount(face, area * _fraction_above(corner - sine), len(total))


def _fraction_above(value: Array) -> Array:
    """Fraction of triangles on which the linear function with values (m, 3) at the corners is positive: (m,)."""
    value = np.sort(value, axis=1)
    positive = (value > 0.0).sum(axis=1)
    result = np.where(positive == 3, 1.0, 0.0)
    for count, odd, others in ((1, 2, (0, 1)), (2, 0, (1, 2))):
        some = positive == count
        tip = value[some, odd]
        corner = tip**2 / ((tip - value[some, others[0]]) * (tip - value[some, others[1]]))
        result[some] = corner if count == 1 else 1.0 - corner
    return result


def _find_steepest(slope: _Slopes, face: IntArray, uv: Array, place: Array) -> tuple[float, Array]:
    """Greatest overhang angle in degrees and its place, in triangles (m, 3, 2) of faces (m,); else 0 and the given place."""
    best = 0.0
    for own, corners in zip(face[:, None], uv, strict=True):
        at, value = maximise_on_triangle(lambda x, f=own: slope(np.repeat(f, len(x)), x)[0], corners)  # type: ignore[misc]
        if value > best:
            best, place = value, slope.surfaces(own, at[None])[0][0]
    return float(np.degrees(np.arcsin(min(best, 1.0)))), place


def maximise_on_triangle(function: Callable[[Array], Array], uv: Array) -> tuple[Array, float]:
    """Parameters (2,) and value of a local maximum of a smooth function of parameters (n, 2) on a triangle (3, 2)."""
    weights = np.concatenate([np.eye(3), np.full((1, 3), 1.0 / 3.0)])
    values = function(weights @ uv)
    best, value = weights[values.argmax()], float(values.max())
    step = 0.5
    for _ in range(SEARCH_STEPS):
        around = best + step * PATTERN
        around = around[(around >= 0.0).all(axis=1)]
        found = function(around @ uv) if len(around) else np.array([-np.inf])
        if found.max() > value:
            best, value = around[found.argmax()], float(found.max())
        else:
            step *= 0.5
    return best @ uv, value


PATTERN = np.array([[1, -1, 0], [-1, 1, 0], [1, 0, -1], [-1, 0, 1], [0, 1, -1], [0, -1, 1]])
"""Directions of the search in barycentric coordinates."""
