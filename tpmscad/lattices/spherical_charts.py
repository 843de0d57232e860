"""Charts of a sphere about the origin, as maps of lattice coordinates with exact Jacobians: from a pole, and along the equator.

In both, z is the radial distance from the sphere, and lengths along the axis y of the chart are true on it. The chart of the
pole is the azimuthal equidistant projection, regular up to the other pole; that of the equator is equirectangular.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.special import spherical_jn

from tpmscad._typing import Array

Chart = tuple[Callable[[Array], Array], Callable[[Array], Array]]
"""Points (..., 3) to points, and to Jacobians (..., 3, 3)."""


def chart_from_pole(radius: float) -> Chart:
    """The azimuthal equidistant map from the upper pole, and its Jacobian."""

    def function(p: Array) -> Array:
        x, y, r = p[..., 0], p[..., 1], radius + p[..., 2]
        angle = np.hypot(x, y) / radius
        across = np.sinc(angle / np.pi) / radius  # sin(angle) / hypot(x, y)
        return np.stack([r * across * x, r * across * y, r * np.cos(angle)], axis=-1)

    def jacobian(p: Array) -> Array:
        x, y, r = p[..., 0], p[..., 1], radius + p[..., 2]
        angle = np.hypot(x, y) / radius
        across = np.sinc(angle / np.pi) / radius
        # The derivative of `across` by x is bend x, by y bend y; j1(t) / t tends to 1/3.
        safe = np.where(angle > 0, angle, 1.0)
        bend = -np.where(angle > 0, spherical_jn(1, safe) / safe, 1 / 3) / radius**3
        mixed = r * bend * x * y
        rows = [
            [r * (across + bend * x**2), mixed, across * x],
            [mixed, r * (across + bend * y**2), across * y],
            [-r * across * x / radius, -r * across * y / radius, np.cos(angle)],
        ]
        return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)

    return function, jacobian


def chart_along_equator(radius: float) -> Chart:
    """The map of x to longitude and y to latitude, and its Jacobian."""

    def function(p: Array) -> Array:
        longitude, latitude, r = p[..., 0] / radius, p[..., 1] / radius, radius + p[..., 2]
        ring = r * np.cos(latitude)
        return np.stack([ring * np.cos(longitude), ring * np.sin(longitude), r * np.sin(latitude)], axis=-1)

    def jacobian(p: Array) -> Array:
        longitude, latitude, r = p[..., 0] / radius, p[..., 1] / radius, radius + p[..., 2]
        c, s, cos, sin = np.cos(longitude), np.sin(longitude), np.cos(latitude), np.sin(latitude)
        rows = [
            [-r / radius * cos * s, -r / radius * sin * c, cos * c],
            [r / radius * cos * c, -r / radius * sin * s, cos * s],
            [np.zeros_like(c), r / radius * cos, sin],
        ]
        return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)

    return function, jacobian
