"""The surfaces that carry faces and the curves of edges: B-splines, planes, quadrics, circles and ellipses.

All surfaces are called as `surface(u, v, du, dv)`; planes and quadrics have a signed distance with gradient too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from tpmscad._typing import Array
from tpmscad.brep.conics import Circle, Ellipse, cross_single
from tpmscad.brep.quadrics import ConicalSurface, CylindricalSurface, SphericalSurface, ToroidalSurface
from tpmscad.rigid_motion import Motion
from tpmscad.splines.bspline import BSplineCurve, BSplineSurface

__all__ = [
    "Carrier",
    "Circle",
    "ConicalSurface",
    "CylindricalSurface",
    "EdgeCurve",
    "Ellipse",
    "Plane",
    "Quadric",
    "SphericalSurface",
    "ToroidalSurface",
]


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
    """P(u, v) = origin + u x_axis + v (normal x x_axis); x_axis and normal are orthogonal unit vectors."""

    origin: Array
    x_axis: Array
    normal: Array

    @property
    def y_axis(self) -> Array:
        """Direction of v: normal x x_axis."""
        return cross_single(self.normal, self.x_axis)

    @property
    def period(self) -> tuple[float, float]:
        """Periods of u and v; 0 means none."""
        return 0.0, 0.0

    def __call__(self, u: ArrayLike, v: ArrayLike, du: int = 0, dv: int = 0) -> Array:
        """Points, or the mixed derivative of orders (du, dv), at the pairs (u, v), broadcast: (..., 3)."""
        u, v = np.broadcast_arrays(np.asarray(u, float)[..., None], np.asarray(v, float)[..., None])
        if du + dv == 0:
            return np.asarray(self.origin + u * self.x_axis + v * self.y_axis)
        constant = {(1, 0): self.x_axis, (0, 1): self.y_axis}.get((du, dv), np.zeros(3))
        return np.zeros_like(u) + constant

    def jet(self, u: Array, v: Array) -> tuple[Array, Array, Array]:
        """Points and first derivatives by u and by v at parameters (n,), (n,): (n, 3) each."""
        y_axis, shape = self.y_axis, (len(u), 3)
        points = self.origin + u[:, None] * self.x_axis + v[:, None] * y_axis
        return points, np.full(shape, self.x_axis), np.full(shape, y_axis)

    def parameters(self, points: ArrayLike) -> Array:
        """(u, v) of the orthogonal projections of points (..., 3): (..., 2)."""
        return (np.asarray(points, float) - self.origin) @ np.stack([self.x_axis, self.y_axis], axis=1)

    def distance(self, points: ArrayLike) -> Array:
        """Signed distance of points (..., 3), positive on the side of the normal: (...)."""
        return (np.asarray(points, float) - self.origin) @ self.normal

    def gradient(self, points: ArrayLike) -> Array:
        """Gradient of the distance, the normal: (..., 3)."""
        return np.zeros_like(np.asarray(points, float)) + self.normal

    def scaled(self, factor: float) -> Plane:
        """The plane scaled about the origin."""
        return Plane(factor * self.origin, self.x_axis, self.normal)

    def moved(self, motion: Motion) -> Plane:
        """The plane after a rigid motion, with its side; a mirror reverses the parameter v."""
        x_axis, normal = motion.apply_to_vectors(self.x_axis), motion.apply_to_vectors(self.normal)
        return Plane(motion.apply(self.origin), x_axis, normal)


Quadric = CylindricalSurface | ConicalSurface | SphericalSurface | ToroidalSurface
Carrier = BSplineSurface | Plane | Quadric
EdgeCurve = BSplineCurve | Circle | Ellipse
