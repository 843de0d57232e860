"""The surfaces that faces lie on and the curves that edges run on: B-splines, planes, quadrics, circles, ellipses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from tpmscad._typing import Array
from tpmscad.brep.conics import Circle, Ellipse, cross
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
        return cross(self.normal, self.x_axis)

    @property
    def period(self) -> tuple[float, float]:
        return 0.0, 0.0

    def __call__(self, u: ArrayLike, v: ArrayLike, du: int = 0, dv: int = 0) -> Array:
        """Points, or the mixed derivative of orders (du, dv), at the pairs (u, v), broadcast: (..., 3)."""
        u, v = np.broadcast_arrays(np.asarray(u, float)[..., None], np.asarray(v, float)[..., None])
        if du + dv == 0:
            return np.asarray(self.origin + u * self.x_axis + v * self.y_axis)
        constant = {(1, 0): self.x_axis, (0, 1): self.y_axis}.get((du, dv), np.zeros(3))
        return np.zeros_like(u) + constant

    def parameters(self, points: ArrayLike) -> Array:
        """(u, v) of the points' feet: (..., 2)."""
        return (np.asarray(points, float) - self.origin) @ np.stack([self.x_axis, self.y_axis], axis=1)

    def distance(self, points: ArrayLike) -> Array:
        """Signed distance along the normal: (...)."""
        return (np.asarray(points, float) - self.origin) @ self.normal

    def gradient(self, points: ArrayLike) -> Array:
        """Of the distance: (..., 3)."""
        return np.zeros_like(np.asarray(points, float)) + self.normal

    def hessian(self, points: ArrayLike) -> Array:
        """Of the distance: zeros (..., 3, 3)."""
        return np.zeros((*np.shape(points), 3))

    def scaled(self, factor: float) -> Plane:
        return Plane(factor * self.origin, self.x_axis, self.normal)

    def moved(self, motion: Motion) -> Plane:
        """The plane moved, with its side; under a mirror the parameter v turns round."""
        x_axis, normal = motion.apply_to_vectors(self.x_axis), motion.apply_to_vectors(self.normal)
        return Plane(motion.apply(self.origin), x_axis, normal)


Quadric = CylindricalSurface | ConicalSurface | SphericalSurface | ToroidalSurface
Carrier = BSplineSurface | Plane | Quadric
EdgeCurve = BSplineCurve | Circle | Ellipse
