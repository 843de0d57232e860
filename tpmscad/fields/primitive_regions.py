"""Regions as exact signed distances, negative inside: boxes, half-spaces, spheres, cylinders. Gradients are unit vectors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tpmscad._typing import Array
from tpmscad.errors import InvalidRequest
from tpmscad.fields.evaluation import FieldJet, Triple, as_positive, as_triple
from tpmscad.fields.field import Field

Direction = str | Sequence[float]


@dataclass(frozen=True, slots=True)
class BoxRegion(Field):
    """Signed distance to an axis-parallel box; edges may be infinite."""

    lo: Triple
    hi: Triple

    def at(self, x: Array, y: Array, z: Array) -> Array:
        return _corner_distance(*self._excess(x, y, z))

    def jet(self, x: Array, y: Array, z: Array) -> FieldJet:
        excess = self._excess(x, y, z)
        value = _corner_distance(*excess)
        # outside: direction to the nearest point of the box; inside: the nearest face's normal, the first of several
        a, b, c = excess
        outside = (a > 0) | (b > 0) | (c > 0)
        length = np.where(outside, value, 1.0)
        first = (a >= b) & (a >= c)
        second = ~first & (b >= c)
        nearest = first, second, ~first & ~second
        middle = [_slab_midpoint(lo, hi) for lo, hi in zip(self.lo, self.hi, strict=True)]
        slopes = [
            np.where(t >= m, 1.0, -1.0) * np.where(outside, np.maximum(e, 0.0) / length, near.astype(float))
            for t, m, e, near in zip((x, y, z), middle, excess, nearest, strict=True)
        ]
        return value, slopes[0], slopes[1], slopes[2]

    def _excess(self, *coordinates: Array) -> tuple[Array, Array, Array]:
        """How far beyond its slab each coordinate is (negative: how deep inside)."""
        a, b, c = (np.maximum(lo - t, t - hi) for t, lo, hi in zip(coordinates, self.lo, self.hi, strict=True))
        return a, b, c


@dataclass(frozen=True, slots=True)
class HalfSpaceRegion(Field):
    """Signed distance to the plane (p - point) . normal = 0, negative on the side the normal leaves."""

    point: Triple
    normal: Triple

    def at(self, x: Array, y: Array, z: Array) -> Array:
        (px, py, pz), (nx, ny, nz) = self.point, self.normal
        return (x - px) * nx + (y - py) * ny + (z - pz) * nz

    def jet(self, x: Array, y: Array, z: Array) -> FieldJet:
        one = np.ones((1,) * x.ndim)
        return self.at(x, y, z), self.normal[0] * one, self.normal[1] * one, self.normal[2] * one


@dataclass(frozen=True, slots=True)
class SphereRegion(Field):
    """Signed distance to a sphere; at the center, where no gradient exists, it is given as (1, 0, 0)."""

    center: Triple
    radius: float

    def at(self, x: Array, y: Array, z: Array) -> Array:
        cx, cy, cz = self.center
        return np.sqrt((x - cx) ** 2 + (y - cy) ** 2 + (z - cz) ** 2) - self.radius

    def jet(self, x: Array, y: Array, z: Array) -> FieldJet:
        dx, dy, dz = (t - c for t, c in zip((x, y, z), self.center, strict=True))
        distance = np.sqrt(dx**2 + dy**2 + dz**2)
        safe, at_center = np.where(distance > 0, distance, 1.0), distance == 0
        return distance - self.radius, np.where(at_center, 1.0, dx / safe), dy / safe, dz / safe


@dataclass(frozen=True, slots=True)
class CylinderRegion(Field):
    """Signed distance to a cylinder around center + t axis; infinitely long, or |t| <= height / 2."""

    center: Triple
    axis: Triple
    radius: float
    height: float | None

    def at(self, x: Array, y: Array, z: Array) -> Array:
        along, _, distance = self._parts(x, y, z)
        if self.height is None:
            return distance - self.radius
        return _corner_distance(distance - self.radius, np.abs(along) - self.height / 2)

    def jet(self, x: Array, y: Array, z: Array) -> FieldJet:
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
        slopes = [share * r + lift * n for r, n in zip(radial, self.axis, strict=True)]
        return value, slopes[0], slopes[1], slopes[2]

    def _parts(self, x: Array, y: Array, z: Array) -> tuple[Array, tuple[Array, Array, Array], Array]:
        """Along the axis, the vector from the axis, and its length."""
        (nx, ny, nz), (cx, cy, cz) = self.axis, self.center
        dx, dy, dz = x - cx, y - cy, z - cz
        along = dx * nx + dy * ny + dz * nz
        wx, wy, wz = dx - along * nx, dy - along * ny, dz - along * nz
        return along, (wx, wy, wz), np.sqrt(wx**2 + wy**2 + wz**2)


def box(lo: Sequence[float], hi: Sequence[float]) -> BoxRegion:
    """The box between two corners. Coordinates may be infinite: box((0.4, -inf, -inf), (0.6, inf, inf)) is a slab."""
    low, high = np.asarray(lo, float), np.asarray(hi, float)
    if low.shape != (3,) or high.shape != (3,) or not (low < high).all():
        raise InvalidRequest(f"box from {lo!r} to {hi!r}: two corners (x, y, z) are needed, each lo below its hi")
    if np.isinf(low).all() and np.isinf(high).all():
        raise InvalidRequest("the box is all of space: at least one of its faces must be finite")
    return BoxRegion(tuple(map(float, low)), tuple(map(float, high)))  # type: ignore[arg-type]


def halfspace(point: Sequence[float], normal: Direction) -> HalfSpaceRegion:
    """The half-space behind the plane through `point`: solid where (p - point) . normal < 0.

    normal: a vector of any length, or "x", "-y", ...
    """
    return HalfSpaceRegion(as_triple(point, "point"), as_unit_vector(normal, "normal"))


def sphere(center: Sequence[float], radius: float) -> SphereRegion:
    """The ball of that center and radius."""
    return SphereRegion(as_triple(center, "center"), as_positive(radius, "radius"))


def cylinder(
    center: Sequence[float], radius: float, axis: Direction = "z", height: float | None = None
) -> CylinderRegion:
    """The cylinder around the line through `center` along `axis`; of that height, half on each side of center, or infinite."""
    length = None if height is None else as_positive(height, "height")
    return CylinderRegion(
        as_triple(center, "center"), as_unit_vector(axis, "axis"), as_positive(radius, "radius"), length
    )


def as_unit_vector(value: Any, name: str) -> Triple:
    """The unit vector of "x", "-x", "y", ... or of a vector of any length."""
    if isinstance(value, str):
        sign, letter = (-1.0, value[1:]) if value.startswith("-") else (1.0, value)
        if letter not in ("x", "y", "z"):
            raise InvalidRequest(f"{name} {value!r}: give x, y, z, -x, -y, -z or a vector")
        return tuple(sign if letter == axis else 0.0 for axis in "xyz")  # type: ignore[return-value]
    vector = np.array(as_triple(value, name))
    length = float(np.linalg.norm(vector))
    if length == 0:
        raise InvalidRequest(f"{name} {value!r} has no direction: its length is zero")
    return tuple(map(float, vector / length))  # type: ignore[return-value]


def _corner_distance(*excess: Array) -> Array:
    """Signed distance to the corner {all excess <= 0} of perpendicular half-spaces."""
    inside = excess[0]
    outside = np.maximum(excess[0], 0.0) ** 2
    for e in excess[1:]:
        inside = np.maximum(inside, e)
        outside = outside + np.maximum(e, 0.0) ** 2
    return np.where(inside > 0, np.sqrt(outside), inside)


def _slab_midpoint(lo: float, hi: float) -> float:
    """Where the nearer of two faces changes; with one face infinite, beyond every coordinate on that side."""
    return (lo + hi) / 2 if np.isfinite(lo) or np.isfinite(hi) else 0.0


def _perpendicular_unit_vector(axis: Triple) -> Triple:
    """A unit vector across an axis, for the points on it."""
    least = int(np.argmin(np.abs(axis)))
    across = np.cross(axis, np.eye(3)[least])
    return tuple(map(float, across / np.linalg.norm(across)))  # type: ignore[return-value]
