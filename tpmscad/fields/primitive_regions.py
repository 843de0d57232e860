"""Boxes, half-spaces, spheres and cylinders as exact signed distances, negative inside; gradients are unit vectors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array
from tpmscad.errors import InvalidRequest
from tpmscad.fields.evaluation import FieldJet, Triple
from tpmscad.fields.field import Field
from tpmscad.fields.periods_and_directions import Direction, as_unit_vector
from tpmscad.public_calls import public


@dataclass(frozen=True, slots=True)
class BoxRegion(Field):
    """Signed distance to the surface of an axis-parallel box, whose coordinates may be infinite."""

    lo: Triple
    hi: Triple

    def at(self, x: Array, y: Array, z: Array) -> Array:
        """Values at coordinates that broadcast."""
        return _corner_distance(*self._excess(x, y, z))

    def jet(self, x: Array, y: Array, z: Array) -> FieldJet:
        """Value and partial derivatives at coordinates that broadcast."""
        excess = self._excess(x, y, z)
        value = _corner_distance(*excess)
        # outside: direction from the nearest point of the box; inside: normal of the nearest face, the first of several
        a, b, c = excess
        outside = (a > 0) | (b > 0) | (c > 0)
        length = np.where(outside, value, 1.0)
        first = (a >= b) & (a >= c)
        second = ~first & (b >= c)
        nearest = first, second, ~first & ~second
        middle = [_slab_midpoint(lo, hi) for lo, hi in zip(self.lo, self.hi, strict=True)]
        gradient = [
            np.where(t >= m, 1.0, -1.0) * np.where(outside, np.maximum(e, 0.0) / length, near.astype(float))
            for t, m, e, near in zip((x, y, z), middle, excess, nearest, strict=True)
        ]
        return value, gradient[0], gradient[1], gradient[2]

    def _excess(self, *coordinates: Array) -> tuple[Array, Array, Array]:
        """Signed distance of each coordinate to its interval, negative inside."""
        a, b, c = (np.maximum(lo - t, t - hi) for t, lo, hi in zip(coordinates, self.lo, self.hi, strict=True))
        return a, b, c


@dataclass(frozen=True, slots=True)
class HalfSpaceRegion(Field):
    """Signed distance to the plane (p - point) . normal = 0, negative behind it: an affine function of unit slope."""

    point: Triple
    normal: Triple

    def at(self, x: Array, y: Array, z: Array) -> Array:
        """Values at coordinates that broadcast."""
        (px, py, pz), (nx, ny, nz) = self.point, self.normal
        return (x - px) * nx + (y - py) * ny + (z - pz) * nz

    def jet(self, x: Array, y: Array, z: Array) -> FieldJet:
        """Value and partial derivatives at coordinates that broadcast."""
        one = np.ones((1,) * x.ndim)
        return self.at(x, y, z), self.normal[0] * one, self.normal[1] * one, self.normal[2] * one


@dataclass(frozen=True, slots=True)
class SphereRegion(Field):
    """Signed distance to a sphere; at the center, where no gradient exists, (1, 0, 0) is returned."""

    center: Triple
    radius: float

    def at(self, x: Array, y: Array, z: Array) -> Array:
        """Values at coordinates that broadcast."""
        cx, cy, cz = self.center
        return np.sqrt((x - cx) ** 2 + (y - cy) ** 2 + (z - cz) ** 2) - self.radius

    def jet(self, x: Array, y: Array, z: Array) -> FieldJet:
        """Value and partial derivatives at coordinates that broadcast."""
        dx, dy, dz = (t - c for t, c in zip((x, y, z), self.center, strict=True))
        distance = np.sqrt(dx**2 + dy**2 + dz**2)
        safe, at_center = np.where(distance > 0, distance, 1.0), distance == 0
        return distance - self.radius, np.where(at_center, 1.0, dx / safe), dy / safe, dz / safe


@dataclass(frozen=True, slots=True)
class CylinderRegion(Field):
    """Signed distance to a cylinder about the line center + t axis; infinitely long, or |t| <= height / 2."""

    center: Triple
    axis: Triple
    radius: float
    height: float | None

    def at(self, x: Array, y: Array, z: Array) -> Array:
        """Values at coordinates that broadcast."""
        along, _, distance = self._parts(x, y, z)
        if self.height is None:
            return distance - self.radius
        return _corner_distance(distance - self.radius, np.abs(along) - self.height / 2)

    def jet(self, x: Array, y: Array, z: Array) -> FieldJet:
        """Value and partial derivatives at coordinates that broadcast."""
        along, across, distance = self._parts(x, y, z)
        safe = np.where(distance > 0, distance, 1.0)
        aside = _perpendicular_unit_vector(self.axis)
        radial = [np.where(distance > 0, w / safe, a) for w, a in zip(across, aside, strict=True)]
        if self.height is None:
            return distance - self.radius, radial[0], radial[1], radial[2]
        a, b = distance - self.radius, np.abs(along) - self.height / 2
        value = _corner_distance(a, b)
        outside = (a > 0) | (b > 0)
        length = np.where(outside, value, 1.0)
        share = np.where(outside, np.maximum(a, 0.0) / length, (a >= b).astype(float))
        lift = np.where(along >= 0, 1.0, -1.0) * np.where(outside, np.maximum(b, 0.0) / length, (a < b).astype(float))
        gradient = [share * r + lift * n for r, n in zip(radial, self.axis, strict=True)]
        return value, gradient[0], gradient[1], gradient[2]

    def _parts(self, x: Array, y: Array, z: Array) -> tuple[Array, tuple[Array, Array, Array], Array]:
        """Coordinate along the axis, vector from the axis, and its length."""
        (nx, ny, nz), (cx, cy, cz) = self.axis, self.center
        dx, dy, dz = x - cx, y - cy, z - cz
        along = dx * nx + dy * ny + dz * nz
        wx, wy, wz = dx - along * nx, dy - along * ny, dz - along * nz
        return along, (wx, wy, wz), np.sqrt(wx**2 + wy**2 + wz**2)


@public()
def box(lo: Triple, hi: Triple) -> BoxRegion:
    """Return the axis-parallel box between two corners.

    Parameters
    ----------
    lo, hi : (x, y, z)
        Corners, in model units; each coordinate of `lo` is below that of `hi`. Coordinates may be infinite:
        box((0.4, -inf, -inf), (0.6, inf, inf)) is a slab.

    Returns
    -------
    BoxRegion
        The signed distance, negative inside.

    Raises
    ------
    InvalidRequest
        If the box is empty or all of space.

    Examples
    --------
    >>> from tpmscad import fields
    >>> float(fields.box((0, 0, 0), (2, 2, 2))((1.0, 1.0, 1.5)))
    -0.5
    """
    if not all(a < b for a, b in zip(lo, hi, strict=True)):
        raise InvalidRequest(f"box from {lo} to {hi}: two corners (x, y, z) are needed, each lo below its hi")
    if np.isinf(lo).all() and np.isinf(hi).all():
        raise InvalidRequest("the box is all of space: at least one of its faces must be finite")
    return BoxRegion(lo, hi)


@public()
def halfspace(point: Triple, normal: Direction) -> HalfSpaceRegion:
    """Return the half-space behind a plane.

    Parameters
    ----------
    point : (x, y, z)
        Point of the plane, in model units.
    normal : str or (x, y, z)
        Outward normal: "x", "-y", ... or a vector of any length.

    Returns
    -------
    HalfSpaceRegion
        The signed distance (p - point) . n, negative behind the plane.

    Raises
    ------
    InvalidRequest
        If the normal has no direction or the point is not finite.

    Examples
    --------
    >>> from tpmscad import fields
    >>> float(fields.halfspace((0, 0, 1), "z")((0.0, 0.0, 3.0)))
    2.0
    """
    return HalfSpaceRegion(point, as_unit_vector(normal))


@public()
def sphere(center: Triple, radius: float) -> SphereRegion:
    """Return the ball with a center and a radius.

    Parameters
    ----------
    center : (x, y, z)
        Center, in model units.
    radius : float
        Radius, positive.

    Returns
    -------
    SphereRegion
        The signed distance, negative inside.

    Raises
    ------
    InvalidRequest
        If the radius is not positive or the center is not finite.

    Examples
    --------
    >>> from tpmscad import fields
    >>> float(fields.sphere((0, 0, 0), 2.0)((0.0, 3.0, 4.0)))
    3.0
    """
    return SphereRegion(center, radius)


@public()
def cylinder(center: Triple, radius: float, axis: Direction = "z", height: float | None = None) -> CylinderRegion:
    """Return a circular cylinder.

    Parameters
    ----------
    center : (x, y, z)
        Middle of the axis, in model units.
    radius : float
        Radius, positive.
    axis : str or (x, y, z)
        Direction: "x", "y", "z" or a vector of any length.
    height : float, optional
        Height, half of it on each side of the center; infinite by default.

    Returns
    -------
    CylinderRegion
        The signed distance, negative inside.

    Raises
    ------
    InvalidRequest
        If the radius or height is not positive, or the axis has no direction.

    Examples
    --------
    >>> from tpmscad import fields
    >>> float(fields.cylinder((0, 0, 0), 2.0, "z")((3.0, 4.0, 9.0)))
    3.0
    """
    return CylinderRegion(center, as_unit_vector(axis), radius, height)


def _corner_distance(*excess: Array) -> Array:
    """Signed distance to the intersection {all excess <= 0} of perpendicular half-spaces."""
    inside = excess[0]
    outside = np.maximum(excess[0], 0.0) ** 2
    for e in excess[1:]:
        inside = np.maximum(inside, e)
        outside = outside + np.maximum(e, 0.0) ** 2
    return np.where(inside > 0, np.sqrt(outside), inside)


def _slab_midpoint(lo: float, hi: float) -> float:
    """Coordinate at which the nearer of two faces changes, infinite if one of the faces is."""
    return (lo + hi) / 2 if np.isfinite(lo) or np.isfinite(hi) else 0.0


def _perpendicular_unit_vector(axis: Triple) -> Triple:
    """A unit vector perpendicular to an axis, the radial direction of points on the axis."""
    least = int(np.argmin(np.abs(axis)))
    across = np.cross(axis, np.eye(3)[least])
    return tuple(map(float, across / np.linalg.norm(across)))  # type: ignore[return-value]
