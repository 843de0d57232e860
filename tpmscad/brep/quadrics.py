"""Cylinders, cones, spheres and tori as carriers of faces; a torus, of order four, is counted among the quadrics.

Each has a right-handed frame: origin, axis, and x_axis across it; y = axis x x_axis. With e(u) = cos u x_axis + sin u y_axis its
points are, as in STEP and in OCC,

    Cylinder    origin + radius e(u) + v axis
    Cone        origin + (radius + v sin angle) e(u) + v cos angle axis        the nappe where radius + v sin angle >= 0
    Sphere      origin + radius (cos v e(u) + sin v axis)
    Torus       origin + (major + minor cos v) e(u) + minor sin v axis         where major + minor cos v >= 0

and S_u x S_v points away from the axis (of a torus: from the circle in its middle). Signed distances are positive on that side.
A sphere's two poles and a cone's apex are each a whole line of parameters, v = const, on which S_u = 0.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from tpmscad._typing import Array
from tpmscad.brep.conics import TWO_PI, cosine_derivative, cross_single
from tpmscad.rigid_motion import Motion

MIN_RADIUS = 1e-150
"""Lengths below it are taken for it where they divide: on a quadric's axis, where directions are undefined but finite."""


@dataclass(frozen=True, slots=True, eq=False)
class _SurfaceOfRevolution:
    """What the quadrics share: points are origin + r(v) e(u) + z(v) axis, for a profile (r, z) in the half-plane r >= 0."""

    origin: Array
    x_axis: Array
    axis: Array

    @property
    def y_axis(self) -> Array:
        return cross_single(self.axis, self.x_axis)

    @property
    def period(self) -> tuple[float, float]:
        """Of u and of v; 0 where there is none."""
        return TWO_PI, 0.0

    def __call__(self, u: ArrayLike, v: ArrayLike, du: int = 0, dv: int = 0) -> Array:
        """Points, or the mixed derivative of orders (du, dv), at the pairs (u, v), broadcast: (..., 3)."""
        u, v = np.broadcast_arrays(np.asarray(u, float)[..., None], np.asarray(v, float)[..., None])
        r, z = self._profile(v, dv)
        across = r * (cosine_derivative(u, du) * self.x_axis + cosine_derivative(u, du - 1) * self.y_axis)
        if du:
            return np.asarray(across)
        return np.asarray(across + z * self.axis + (0.0 if dv else self.origin))

    def normal(self, u: ArrayLike, v: ArrayLike) -> Array:
        """S_u x S_v at the pairs (u, v), not normalised: (..., 3)."""
        return np.cross(self(u, v, 1, 0), self(u, v, 0, 1))

    def parameters(self, points: ArrayLike) -> Array:
        """(u, v) of the points' feet, angles in [-pi, pi]: (..., 2)."""
        r, z, e = self._polar(points)
        return np.stack([np.arctan2(e @ self.y_axis, e @ self.x_axis), self._along(r, z)], axis=-1)

    def distance(self, points: ArrayLike) -> Array:
        """Signed, positive where S_u x S_v points: (...). Behind an apex it is that of the cone prolonged, too short."""
        r, z, _ = self._polar(points)
        return self._profile_distance(r, z)

    def gradient(self, points: ArrayLike) -> Array:
        """Of the distance, unit vectors: (..., 3)."""
        r, z, e = self._polar(points)
        by_r, by_z = self._slope(r, z)
        return by_r[..., None] * e + by_z[..., None] * self.axis

    def hessian(self, points: ArrayLike) -> Array:
        """Of the distance: (..., 3, 3)."""
        r, z, e = self._polar(points)
        by_r, by_z = self._slope(r, z)
        bend = self._bend(r, z)
        across = by_z[..., None] * e - by_r[..., None] * self.axis  # along the profile
        around = np.cross(self.axis, e)
        return (
            bend[..., None, None] * across[..., :, None] * across[..., None, :]
            + (by_r / np.maximum(r, MIN_RADIUS))[..., None, None] * around[..., :, None] * around[..., None, :]
        )

    def moved(self, motion: Motion) -> Self:
        """The points moved, with their sides; under a mirror the parameter u turns round."""
        x_axis, axis = motion.apply_to_vectors(self.x_axis), motion.apply_to_vectors(self.axis)
        return replace(self, origin=motion.apply(self.origin), x_axis=x_axis, axis=axis)

    def _polar(self, points: ArrayLike) -> tuple[Array, Array, Array]:
        """Distance from the axis, height along it, and the direction away from it (x_axis where there is none)."""
        arm = np.asarray(points, float) - self.origin
        z = arm @ self.axis
        arm = arm - z[..., None] * self.axis
        r = np.linalg.norm(arm, axis=-1)
        away = np.where(r[..., None] > MIN_RADIUS, arm / np.maximum(r, MIN_RADIUS)[..., None], self.x_axis)
        return r, z, away

    def _profile(self, v: Array, order: int) -> tuple[Array, Array]:
        """r and z, or their derivatives."""
        raise NotImplementedError

    def _along(self, r: Array, z: Array) -> Array:
        """v of the profile's point next to (r, z)."""
        raise NotImplementedError

    def _profile_distance(self, r: Array, z: Array) -> Array:
        raise NotImplementedError

    def _slope(self, r: Array, z: Array) -> tuple[Array, Array]:
        """Derivatives of the distance by r and by z."""
        raise NotImplementedError

    def _bend(self, r: Array, z: Array) -> Array:
        """Second derivative of the distance along its level line in the half-plane."""
        raise NotImplementedError


@dataclass(frozen=True, slots=True, eq=False)
class CylindricalSurface(_SurfaceOfRevolution):
    """v is the height along the axis."""

    radius: float

    def scaled(self, factor: float) -> CylindricalSurface:
        return replace(self, origin=factor * self.origin, radius=factor * self.radius)

    def _profile(self, v: Array, order: int) -> tuple[Array, Array]:
        return _linear_derivative(v, self.radius, 0.0, order), _linear_derivative(v, 0.0, 1.0, order)

    def _along(self, r: Array, z: Array) -> Array:
        return z

    def _profile_distance(self, r: Array, z: Array) -> Array:
        return r - self.radius

    def _slope(self, r: Array, z: Array) -> tuple[Array, Array]:
        return np.ones_like(r), np.zeros_like(r)

    def _bend(self, r: Array, z: Array) -> Array:
        return np.zeros_like(r)


@dataclass(frozen=True, slots=True, eq=False)
class ConicalSurface(_SurfaceOfRevolution):
    """`radius` at the origin; it grows with v, the length along the side, for a positive `angle` (radians, within +- pi/2)."""

    radius: float
    angle: float

    @property
    def apex_v(self) -> float:
        """v of the apex."""
        return -self.radius / float(np.sin(self.angle))

    def scaled(self, factor: float) -> ConicalSurface:
        return replace(self, origin=factor * self.origin, radius=factor * self.radius)

    def _profile(self, v: Array, order: int) -> tuple[Array, Array]:
        return _linear_derivative(v, self.radius, np.sin(self.angle), order), _linear_derivative(
            v, 0.0, np.cos(self.angle), order
        )

    def _along(self, r: Array, z: Array) -> Array:
        return (r - self.radius) * np.sin(self.angle) + z * np.cos(self.angle)

    def _profile_distance(self, r: Array, z: Array) -> Array:
        return (r - self.radius) * np.cos(self.angle) - z * np.sin(self.angle)

    def _slope(self, r: Array, z: Array) -> tuple[Array, Array]:
        return np.full_like(r, np.cos(self.angle)), np.full_like(r, -np.sin(self.angle))

    def _bend(self, r: Array, z: Array) -> Array:
        return np.zeros_like(r)


@dataclass(frozen=True, slots=True, eq=False)
class ToroidalSurface(_SurfaceOfRevolution):
    """Around the circle of radius `major`, at distance `minor` from it."""

    major: float
    minor: float

    @property
    def period(self) -> tuple[float, float]:
        return TWO_PI, TWO_PI

    def scaled(self, factor: float) -> ToroidalSurface:
        return replace(self, origin=factor * self.origin, major=factor * self.major, minor=factor * self.minor)

    def _profile(self, v: Array, order: int) -> tuple[Array, Array]:
        return self.minor * cosine_derivative(v, order) + (
            0.0 if order else self.major
        ), self.minor * cosine_derivative(v, order - 1)

    def _along(self, r: Array, z: Array) -> Array:
        return np.arctan2(z, r - self.major)

    def _profile_distance(self, r: Array, z: Array) -> Array:
        return np.hypot(r - self.major, z) - self.minor

    def _slope(self, r: Array, z: Array) -> tuple[Array, Array]:
        reach = np.maximum(np.hypot(r - self.major, z), MIN_RADIUS)
        return (r - self.major) / reach, z / reach

    def _bend(self, r: Array, z: Array) -> Array:
        return 1.0 / np.maximum(np.hypot(r - self.major, z), MIN_RADIUS)


@dataclass(frozen=True, slots=True, eq=False)
class SphericalSurface(_SurfaceOfRevolution):
    """v is the latitude, the poles are at +- pi/2."""

    radius: float

    def scaled(self, factor: float) -> SphericalSurface:
        return replace(self, origin=factor * self.origin, radius=factor * self.radius)

    def _profile(self, v: Array, order: int) -> tuple[Array, Array]:
        return self.radius * cosine_derivative(v, order), self.radius * cosine_derivative(v, order - 1)

    def _along(self, r: Array, z: Array) -> Array:
        return np.arctan2(z, r)

    def _profile_distance(self, r: Array, z: Array) -> Array:
        return np.hypot(r, z) - self.radius

    def _slope(self, r: Array, z: Array) -> tuple[Array, Array]:
        reach = np.maximum(np.hypot(r, z), MIN_RADIUS)
        return r / reach, z / reach

    def _bend(self, r: Array, z: Array) -> Array:
        return 1.0 / np.maximum(np.hypot(r, z), MIN_RADIUS)


def _linear_derivative(v: Array, constant: float, slope: float, order: int) -> Array:
    """The derivative of that order of constant + slope v."""
    return constant + slope * v if order == 0 else np.full_like(v, slope if order == 1 else 0.0)
