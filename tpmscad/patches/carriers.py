"""The surfaces that faces lie on, apart from B-splines: the plane."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tpmscad.splines.bspline import Surface

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
    """P(u, v) = origin + u x_axis + v (normal x x_axis); x_axis and normal are orthogonal unit vectors."""

    origin: Array
    x_axis: Array
    normal: Array

    @property
    def y_axis(self) -> Array:
        return np.cross(self.normal, self.x_axis)

    def __call__(self, u: ArrayLike, v: ArrayLike) -> Array:
        u, v = np.asarray(u, float)[..., None], np.asarray(v, float)[..., None]
        return self.origin + u * self.x_axis + v * self.y_axis

    def parameters(self, points: ArrayLike) -> Array:
        """(u, v) of the points' feet: (..., 2)."""
        return (np.asarray(points, float) - self.origin) @ np.stack([self.x_axis, self.y_axis], axis=1)

    def distance(self, points: ArrayLike) -> Array:
        """Signed distance along the normal: (...)."""
        return (np.asarray(points, float) - self.origin) @ self.normal

    def scaled(self, factor: float) -> Plane:
        return Plane(factor * self.origin, self.x_axis, self.normal)


Carrier = Surface | Plane
