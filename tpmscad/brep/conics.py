"""Circles and ellipses as curves of edges, called like a `BSplineCurve`; the parameter is the angle, as in STEP and in OCC."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from tpmscad._typing import Array
from tpmscad.rigid_motion import Motion

TWO_PI = 2.0 * np.pi


@dataclass(frozen=True, slots=True, eq=False)
class _Conic:
    """A closed conic about `origin` in the plane of two orthogonal unit vectors: x_axis, and y_axis = normal x x_axis."""

    origin: Array
    x_axis: Array
    normal: Array

    @property
    def y_axis(self) -> Array:
        """The direction at the angle pi / 2."""
        return cross_single(self.normal, self.x_axis)

    @property
    def domain(self) -> tuple[float, float]:
        """One turn; the curve may be evaluated outside it."""
        return 0.0, TWO_PI

    def place_frames(self, motion: Motion) -> Array:
        """Origins, normals and x axes (n, 3, 3) of the curve after rigid motions (n,), as `moved` has them."""
        x, y = (motion.apply_to_vectors(np.tile(axis, (len(motion), 1))) for axis in (self.x_axis, self.y_axis))
        return np.stack([motion.apply(self.origin), np.cross(x, y), x], axis=1)

    def moved(self, motion: Motion) -> Self:
        """The curve after a rigid motion, mirrors included, with its parameter."""
        x, y = motion.apply_to_vectors(self.x_axis), motion.apply_to_vectors(self.y_axis)
        return replace(self, origin=motion.apply(self.origin), x_axis=x, normal=cross_single(x, y))


@dataclass(frozen=True, slots=True, eq=False)
class Ellipse(_Conic):
    """origin + major cos t x_axis + minor sin t y_axis."""

    major: float
    minor: float

    def __call__(self, t: ArrayLike, order: int = 0) -> Array:
        """Points, or derivatives of the given order, at any t: (..., 3)."""
        t = np.asarray(t, float)[..., None]
        arm = (
            self.major * cosine_derivative(t, order) * self.x_axis
            + self.minor * cosine_derivative(t, order - 1) * self.y_axis
        )
        return np.asarray(arm if order else self.origin + arm)

    def scaled(self, factor: float) -> Ellipse:
        """The ellipse scaled about the origin of space."""
        return replace(self, origin=factor * self.origin, major=factor * self.major, minor=factor * self.minor)


@dataclass(frozen=True, slots=True, eq=False)
class Circle(_Conic):
    """origin + radius (cos t x_axis + sin t y_axis)."""

    radius: float

    def __call__(self, t: ArrayLike, order: int = 0) -> Array:
        """Points, or derivatives of the given order, at any t: (..., 3)."""
        t = np.asarray(t, float)[..., None]
        arm = self.radius * (cosine_derivative(t, order) * self.x_axis + cosine_derivative(t, order - 1) * self.y_axis)
        return np.asarray(arm if order else self.origin + arm)

    def scaled(self, factor: float) -> Circle:
        """The circle scaled about the origin of space."""
        return replace(self, origin=factor * self.origin, radius=factor * self.radius)


def cosine_derivative(t: Array, order: int) -> Array:
    """The derivative of the given order of the cosine; order -1 is its antiderivative, the sine."""
    return (np.cos, lambda t: -np.sin(t), lambda t: -np.cos(t), np.sin)[order % 4](t)


def cross_single(a: Array, b: Array) -> Array:
    """The cross product of two single vectors (3,), for which `numpy.cross` takes 20 times as long."""
    (a0, a1, a2), (b0, b1, b2) = a.tolist(), b.tolist()
    return np.array([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0])
