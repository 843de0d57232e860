"""Overhang of solids: the area of their faces that lean outwards by more than an angle from the build direction.

The angle of a point of a face is that between the tangent plane and the build direction, arcsin(-n . b): 0 on a vertical wall and
90 degrees under a horizontal ceiling. The area beyond a limit is integrated on the exact faces over the parameters of a
triangulation; triangles that the limit crosses are subdivided, and what remains is cut by the straight line between the points
at the limit.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from tpmscad._typing import Array
from tpmscad.kernel.export.solid_mesh import ParametricMesh, mesh_parametrically
from tpmscad.kernel.measure.mass_properties import face_moments
from tpmscad.kernel.occt.bounding_boxes import box_diagonal
from tpmscad.kernel.occt.exploration import orientation_sign, unwrap
from tpmscad.kernel.occt.geometry_evaluators import SurfaceEvaluator, face_evaluator

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
    meshes = mesh_parametrically(shape, MESH_DEVIATION_DIAGONALS * box_diagonal(unwrap(shape)), MESH_ANGLE)
    points = np.concatenate([mesh.mesh.points for mesh in meshes])
    height = points @ build_direction
    plate = float(height.min()) + PLATE_DIAGONALS * float(np.linalg.norm(np.ptp(points, axis=0)))
    found = [_measure_solid(mesh, build_direction, np.sin(np.radians(limit)) + LIMIT_SINE, plate) for mesh in meshes]
    steepest = max(found, key=lambda one: one.angle)
    return Overhang(
        sum(one.area for one in found), steepest.angle, steepest.place, sum(one.plate_area for one in found)
    )


class _FaceSlope:
    """Sine of the overhang angle and area density on one face, at parameters (n, 2)."""

    def __init__(self, surface: SurfaceEvaluator, sign: int, build_direction: Array) -> None:
        self.surface, self.sign, self.build_direction = surface, sign, build_direction

    def __call__(self, uv: Array) -> tuple[Array, Array]:
        """Sines (n,), 0 where the face is singular, and densities (n,)."""
        _, along_u, along_v = self.surface(uv)
        cross = np.cross(along_u, along_v)
        density = np.linalg.norm(cross, axis=1)
        down = -self.sign * (cross @ self.build_direction)
        return np.divide(down, density, out=np.zeros(len(uv)), where=density > 0.0), density

    def at_corners(self, uv: Array) -> Array:
        """Sines at the corners of triangles (m, 3, 2), a little inside, where no face is singular: (m, 3)."""
        inside = uv + CORNER_INSET * (uv.mean(axis=1, keepdims=True) - uv)
        return self(inside.reshape(-1, 2))[0].reshape(-1, 3)

    def areas(self, uv: Array) -> Array:
        """Areas of the face over triangles (m, 3, 2): (m,)."""
        a, b = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
        _, density = self(np.einsum("qk,mkd->mqd", QUADRATURE, uv).reshape(-1, 2))
        return 0.5 * np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) * density.reshape(-1, len(QUADRATURE)).mean(axis=1)


def _measure_solid(mesh: ParametricMesh, build_direction: Array, sine: float, plate: float) -> Overhang:
    """Overhang of one solid; `plate` is the height up to which faces stand on the build plate."""
    face = mesh.mesh.face
    order = np.argsort(face, kind="stable")
    members = np.split(order, np.flatnonzero(np.diff(face[order])) + 1)
    height = mesh.mesh.points @ build_direction
    on_plate = height[mesh.mesh.triangles].max(axis=1) <= plate
    beyond, standing = np.zeros(len(mesh.faces)), np.zeros(len(mesh.faces))
    steepest: list[tuple[float, int, Array]] = []
    for triangles in members:
        number = int(face[triangles[0]])
        slope = _FaceSlope(face_evaluator(mesh.faces[number]), orientation_sign(mesh.faces[number]), build_direction)
        uv = mesh.uv[triangles]
        corner, area, stands = slope.at_corners(uv), slope.areas(uv), on_plate[triangles]
        total = float(area.sum())
        if not total:
            continue
        standing[number] = area[stands & (corner.max(axis=1) > 0.0)].sum() / total
        free = ~stands
        beyond[number] = _integrate_beyond(slope, uv[free], corner[free], area[free], sine) / total
        steep = np.argsort(-np.where(free, corner.max(axis=1), -1.0))[:STEEPEST_CANDIDATES]
        steepest += [(float(corner[i].max()), number, uv[i]) for i in steep.tolist() if free[i]]
    needed = np.flatnonzero((beyond > 0.0) | (standing > 0.0))
    exact = np.zeros(len(mesh.faces))
    exact[needed] = face_moments([mesh.faces[i] for i in needed.tolist()])[:, 0]
    angle, place = _find_steepest(steepest, mesh, build_direction)
    return Overhang(float(beyond @ exact), angle, place, float(standing @ exact))


def _integrate_beyond(slope: _FaceSlope, uv: Array, corner: Array, area: Array, sine: float) -> float:
    """Area beyond the limit over triangles (m, 3, 2) with sines at their corners (m, 3) and areas (m,)."""
    total = 0.0
    for level in range(SUBDIVISIONS + 1):
        margin = np.ptp(corner, axis=1)  # the extreme of a curved face may lie between the corners
        cut = (corner.min(axis=1) <= sine + margin) & (corner.max(axis=1) > sine - margin)
        total += float(area[~cut & (corner.min(axis=1) > sine)].sum())
        uv, corner, area = uv[cut], corner[cut], area[cut]
        if level == SUBDIVISIONS or not len(uv):
            break
        a, b, c = uv.swapaxes(0, 1)
        ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
        uv = np.concatenate([np.stack(t, axis=1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])
        corner, area = slope.at_corners(uv), slope.areas(uv)
    return total + float((area * _fraction_above(corner - sine)).sum())


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


def _find_steepest(
    triangles: list[tuple[float, int, Array]], mesh: ParametricMesh, build_direction: Array
) -> tuple[float, Array]:
    """Greatest overhang angle in degrees, and its place, from triangles with their greatest sine at a corner and their face."""
    best, place = 0.0, mesh.mesh.points[0]
    for _, number, uv in sorted(triangles, key=lambda one: -one[0])[:STEEPEST_CANDIDATES]:
        surface = face_evaluator(mesh.faces[number])
        slope = _FaceSlope(surface, orientation_sign(mesh.faces[number]), build_direction)
        at, value = maximise_on_triangle(lambda x, slope=slope: slope(x)[0], uv)  # type: ignore[misc]
        if value > best:
            best, place = value, surface(at[None])[0][0]
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
