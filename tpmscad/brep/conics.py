"""Circles and ellipses as curves of edges; the parameter is the angle, as in STEP and in OCC."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from tpmscad._typing import Array
from tpmscad.rigid_motion import Motion

TWO_PI = 2.0 * np.pi


@dataclass(frozen=True, slots=True, eq=False)
class Ellipse:
    """origin + major cos t x_axis + minor sin t (normal x x_axis); called as a Curve is."""

    origin: Array
    x_axis: Array
    normal: Array
    major: float
    minor: float

    @property
    def y_axis(self) -> Array:
        return cross(self.normal, self.x_axis)

    @property
    def domain(self) -> tuple[float, float]:
        return 0.0, TWO_PI

    def __call__(self, t: ArrayLike, order: int = 0) -> Array:
        """Points, or derivatives of the given order, at any t: (..., 3)."""
        t = np.asarray(t, float)[..., None]
        arm = (
            self.major * cosine_derivative(t, order) * self.x_axis
            + self.minor * cosine_derivative(t, order - 1) * self.y_axis
        )
        return np.asarray(arm if order else self.origin + arm)

    def scaled(self, factor: float) -> Ellipse:
        return replace(self, origin=factor * self.origin, major=factor * self.major, minor=factor * self.minor)

    def moved(self, motion: Motion) -> Ellipse:
        """Moved with its parameter, by mirrors too."""
        x, y = motion.apply_to_vectors(self.x_axis), motion.apply_to_vectors(self.y_axis)
        return replace(self, origin=motion.apply(self.origin), x_axis=x, normal=cross(x, y))


@dataclass(frozen=True, slots=True, eq=False)
class Circle:
    """origin + radius (cos t x_axis + sin t (normal x x_axis)); called as a Curve is."""

    origin: Array
    x_axis: Array
    normal: Array
    radius: float

    @property
    def y_axis(self) -> Array:
        return cross(self.normal, self.x_axis)

    @property
    def domain(self) -> tuple[float, float]:
        return 0.0, TWO_PI

    def __call__(self, t: ArrayLike, order: int = 0) -> Array:
        """Points, or derivatives of the given order, at any t: (..., 3)."""
        t = np.asarray(t, float)[..., None]
        arm = self.radius * (cosine_derivative(t, order) * self.x_axis + cosine_derivative(t, order - 1) * self.y_axis)
        return np.asarray(arm if order else self.origin + arm)

    def scaled(self, factor: float) -> Circle:
        return replace(self, origin=factor * self.origin, radius=factor * self.radius)

    def moved(self, motion: Motion) -> Circle:
        """Moved with its parameter, by mirrors too."""
        x, y = motion.apply_to_vectors(self.x_axis), motion.apply_to_vectors(self.y_axis)
        return replace(self, origin=motion.apply(self.origin), x_axis=x, normal=cross(x, y))


def cosine_derivative(t: Array, order: int) -> Array:
    """The derivative of that order of the cosine; -1 for its antiderivative, the sine."""
    return (np.cos, lambda t: -np.sin(t), lambda t: -np.cos(t), np.sin)[order % 4](t)


def cross(a: Array, b: Array) -> Array:
    """The cross product of two vectors (3,): numpy's takes 20 times as long for one."""
    (a0, a1, a2), (b0, b1, b2) = a.tolist(), b.tolist()
    return np.array([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0])
