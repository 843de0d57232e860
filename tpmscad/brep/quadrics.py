"""Cylinders, cones, spheres and tori as carriers of faces; the torus, of order four, is counted among the quadrics.

Each is a surface of revolution in a right-handed frame: origin, axis, x_axis orthogonal to the axis, y_axis = axis x x_axis. With
e(u) = cos u x_axis + sin u y_axis the points are, as in STEP and in OCC,

    Cylinder    origin + radius e(u) + v axis
    Cone        origin + (radius + v sin angle) e(u) + v cos angle axis        the nappe where radius + v sin angle >= 0
    Sphere      origin + radius (cos v e(u) + sin v axis)
    Torus       origin + (major + minor cos v) e(u) + minor sin v axis         where major + minor cos v >= 0

S_u x S_v points away from the axis (on a torus: away from the circle in its middle), and signed distances are positive on that
side. At the poles of a sphere and the apex of a cone S_u = 0: each is one point for a whole line v = const of parameters.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike

from tpmscad._typing import Array
from tpmscad.brep.conics import TWO_PI, cosine_derivative, cross_single
from tpmscad.rigid_motion import Motion

MIN_POLE_STEP_ANGLE = 1e-3
"""Radians of u, or turns of a spline surface in 2 pi, from which two consecutive uses of a loop meet at a pole; elsewhere their u
agree, up to an edge's 1e-7 divided by the distance from the axis."""

MIN_RADIUS = 1e-150
"""Smallest divisor: on the axis of a quadric directions are undefined, but must stay finite."""


@dataclass(frozen=True, slots=True, eq=False)
class _SurfaceOfRevolution:
    """origin + r(v) e(u) + z(v) axis, for a profile (r, z) in the half-plane r >= 0 that the subclasses give."""

    origin: Array
    x_axis: Array
    axis: Array
    _lengths: ClassVar[tuple[str, ...]] = ("radius",)

    @property
    def y_axis(self) -> Array:
        """The direction at u = pi / 2: axis x x_axis."""
        return cross_single(self.axis, self.x_axis)

    @property
    def period(self) -> tuple[float, float]:
        """Periods of u and v; 0 means none."""
        return TWO_PI, 0.0

    def __call__(self, u: ArrayLike, v: ArrayLike, du: int = 0, dv: int = 0) -> Array:
        """Points, or the mixed derivative of orders (du, dv), at the pairs (u, v), broadcast: (..., 3)."""
        u, v = np.broadcast_arrays(np.asarray(u, float)[..., None], np.asarray(v, float)[..., None])
        r, z = self._profile_point(v, dv)
        across = r * (cosine_derivative(u, du) * self.x_axis + cosine_derivative(u, du - 1) * self.y_axis)
        if du:
            return np.asarray(across)
        return np.asarray(across + z * self.axis + (0.0 if dv else self.origin))

    def jet(self, u: Array, v: Array) -> tuple[Array, Array, Array]:
        """Points and derivatives by u and by v at parameters (n,), (n,): (n, 3) each; three calls take three times as long."""
        u, v = u[:, None], v[:, None]
        (r, z), (by_r, by_z) = self._profile_point(v, 0), self._profile_point(v, 1)
        cosine, sine, y_axis = np.cos(u), np.sin(u), self.y_axis
        away = cosine * self.x_axis + sine * y_axis
        return (
            self.origin + r * away + z * self.axis,
            r * (cosine * y_axis - sine * self.x_axis),
            by_r * away + by_z * self.axis,
        )

    def normal(self, u: ArrayLike, v: ArrayLike) -> Array:
        """S_u x S_v at the pairs (u, v), not normalised: (..., 3)."""
        return np.cross(self(u, v, 1, 0), self(u, v, 0, 1))

    def parameters(self, points: ArrayLike) -> Array:
        """(u, v) of the orthogonal projections of points (..., 3), angles in [-pi, pi]: (..., 2)."""
        r, z, e = self._cylindrical_coordinates(points)
        return np.stack([np.arctan2(e @ self.y_axis, e @ self.x_axis), self._profile_parameter(r, z)], axis=-1)

    def distance(self, points: ArrayLike) -> Array:
        """Signed distance of points (..., 3), positive on the side of S_u x S_v: (...).

        Behind the apex of a cone it is the distance from the cone extended beyond the apex, an underestimate.
        """
        r, z, _ = self._cylindrical_coordinates(points)
        return self._profile_distance(r, z)

    def gradient(self, points: ArrayLike) -> Array:
        """Gradient of the distance, unit vectors: (..., 3)."""
        r, z, e = self._cylindrical_coordinates(points)
        by_r, by_z = self._distance_gradient(r, z)
        return by_r[..., None] * e + by_z[..., None] * self.axis

    def moved(self, motion: Motion) -> Self:
        """The surface after a rigid motion, with its sides; a mirror reverses the parameter u."""
        x_axis, axis = motion.apply_to_vectors(self.x_axis), motion.apply_to_vectors(self.axis)
        return replace(self, origin=motion.apply(self.origin), x_axis=x_axis, axis=axis)

    def scaled(self, factor: float) -> Self:
        """The surface scaled about the origin of space."""
        return replace(self, **{name: factor * getattr(self, name) for name in ("origin", *self._lengths)})

    def _cylindrical_coordinates(self, points: ArrayLike) -> tuple[Array, Array, Array]:
        """Cylindrical coordinates of points: radius, height, and the unit radial direction (x_axis on the axis itself)."""
        arm = np.asarray(points, float) - self.origin
        z = arm @ self.axis
        arm = arm - z[..., None] * self.axis
        r = np.linalg.norm(arm, axis=-1)
        away = np.where(r[..., None] > MIN_RADIUS, arm / np.maximum(r, MIN_RADIUS)[..., None], self.x_axis)
        return r, z, away

    def _profile_point(self, v: Array, order: int) -> tuple[Array, Array]:
        """Coordinates r and z of the profile at v, or their derivatives of the given order."""
        raise NotImplementedError

    def _profile_parameter(self, r: Array, z: Array) -> Array:
        """Parameter v of the point of the profile nearest to (r, z)."""
        raise NotImplementedError

    def _profile_distance(self, r: Array, z: Array) -> Array:
        """Signed distance of (r, z) from the profile in the half-plane."""
        raise NotImplementedError

    def _distance_gradient(self, r: Array, z: Array) -> tuple[Array, Array]:
        """Partial derivatives of the distance with respect to r and z."""
        raise NotImplementedError


@dataclass(frozen=True, slots=True, eq=False)
class CylindricalSurface(_SurfaceOfRevolution):
    """A cylinder of a radius about the axis; v is the height along the axis."""

    radius: float

    def _profile_point(self, v: Array, order: int) -> tuple[Array, Array]:
        return _linear_derivative(v, self.radius, 0.0, order), _linear_derivative(v, 0.0, 1.0, order)

    def _profile_parameter(self, r: Array, z: Array) -> Array:
        return z

    def _profile_distance(self, r: Array, z: Array) -> Array:
        return r - self.radius

    def _distance_gradient(self, r: Array, z: Array) -> tuple[Array, Array]:
        return np.ones_like(r), np.zeros_like(r)


@dataclass(frozen=True, slots=True, eq=False)
class ConicalSurface(_SurfaceOfRevolution):
    """A cone of `radius` at the origin and half-angle `angle` (radians, within +- pi/2); v is the length along its generators."""

    radius: float
    angle: float

    def _profile_point(self, v: Array, order: int) -> tuple[Array, Array]:
        return _linear_derivative(v, self.radius, np.sin(self.angle), order), _linear_derivative(
            v, 0.0, np.cos(self.angle), order
        )

    def _profile_parameter(self, r: Array, z: Array) -> Array:
        return (r - self.radius) * np.sin(self.angle) + z * np.cos(self.angle)

    def _profile_distance(self, r: Array, z: Array) -> Array:
        return (r - self.radius) * np.cos(self.angle) - z * np.sin(self.angle)

    def _distance_gradient(self, r: Array, z: Array) -> tuple[Array, Array]:
        return np.full_like(r, np.cos(self.angle)), np.full_like(r, -np.sin(self.angle))


@dataclass(frozen=True, slots=True, eq=False)
class ToroidalSurface(_SurfaceOfRevolution):
    """The points at distance `minor` from a circle of radius `major` about the axis; v is the angle around that circle."""

    major: float
    minor: float
    _lengths: ClassVar[tuple[str, ...]] = ("major", "minor")

    @property
    def period(self) -> tuple[float, float]:
        """Periods of u and v."""
        return TWO_PI, TWO_PI

    def _profile_point(self, v: Array, order: int) -> tuple[Array, Array]:
        return self.minor * cosine_derivative(v, order) + (
            0.0 if order else self.major
        ), self.minor * cosine_derivative(v, order - 1)

    def _profile_parameter(self, r: Array, z: Array) -> Array:
        return np.arctan2(z, r - self.major)

    def _profile_distance(self, r: Array, z: Array) -> Array:
        return np.hypot(r - self.major, z) - self.minor

    def _distance_gradient(self, r: Array, z: Array) -> tuple[Array, Array]:
        reach = np.maximum(np.hypot(r - self.major, z), MIN_RADIUS)
        return (r - self.major) / reach, z / reach


@dataclass(frozen=True, slots=True, eq=False)
class SphericalSurface(_SurfaceOfRevolution):
    """A sphere; v is the latitude, with poles at +- pi/2."""

    radius: float

    def _profile_point(self, v: Array, order: int) -> tuple[Array, Array]:
        return self.radius * cosine_derivative(v, order), self.radius * cosine_derivative(v, order - 1)

    def _profile_parameter(self, r: Array, z: Array) -> Array:
        return np.arctan2(z, r)

    def _profile_distance(self, r: Array, z: Array) -> Array:
        return np.hypot(r, z) - self.radius

    def _distance_gradient(self, r: Array, z: Array) -> tuple[Array, Array]:
        reach = np.maximum(np.hypot(r, z), MIN_RADIUS)
        return r / reach, z / reach


def _linear_derivative(v: Array, constant: float, slope: float, order: int) -> Array:
    """The derivative of the given order of constant + slope v."""
    return constant + slope * v if order == 0 else np.full_like(v, slope if order == 1 else 0.0)
