"""Coordinate maps of a lattice: smooth functions points -> points in model units, with their Jacobians.

A mapped lattice has the *mid surface* mapped and its walls offset along the mapped surface's own normal, so a thickness stays
what it is in model units wherever the map stretches. `Map` carries a function and, where it is known, its exact Jacobian; any
other callable gets one by sixth-order central differences.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.integrate import quad_vec

from tpmscad._typing import Array
from tpmscad.errors import InvalidRequest

DIFFERENCE_STEP_CELLS = 2e-3
"""Difference step over the lattice's cell: truncation (1e-16 of the sixth derivative) and round-off (1e-13) balance."""


@dataclass(frozen=True, slots=True)
class Map:
    """A smooth map: function (..., 3) -> (..., 3), jacobian (..., 3) -> (..., 3, 3) or None for differences."""

    function: Callable[[Array], Array]
    jacobian_function: Callable[[Array], Array] | None = None
    name: str = "user map"

    def __call__(self, points: ArrayLike) -> Array:
        points = np.asarray(points, float)
        values = np.asarray(self.function(points), float)
        if values.shape != points.shape:
            raise InvalidRequest(
                f"{self.name} returned shape {values.shape} for points of shape {points.shape}; "
                "a map takes (..., 3) points and returns as many"
            )
        if not np.isfinite(values).all():
            where = points.reshape(-1, 3)[~np.isfinite(values).all(axis=-1).ravel()][0]
            raise InvalidRequest(
                f"{self.name} is not finite at {where.tolist()}; it must hold a cell beyond the lattice's box"
            )
        return values

    def jacobian(self, points: ArrayLike, scale: float) -> Array:
        """d map_i / d x_j (..., 3, 3); `scale` is the cell edge, which sets the difference step."""
        points = np.asarray(points, float)
        if self.jacobian_function is not None:
            return np.asarray(self.jacobian_function(points), float)
        h = DIFFERENCE_STEP_CELLS * scale
        columns = []
        for axis in np.eye(3):
            at = [self(points + k * h * axis) - self(points - k * h * axis) for k in (1, 2, 3)]
            columns.append((45 * at[0] - 9 * at[1] + at[2]) / (60 * h))
        return np.stack(columns, axis=-1)


def as_map(function: Map | Callable[[Array], Array]) -> Map:
    """The callable as a `Map`."""
    return function if isinstance(function, Map) else Map(function, name=getattr(function, "__name__", "user map"))


def stretching(factors: Sequence[float]) -> Map:
    """x -> factors * x along the axes: a different cell edge along each."""
    f = np.asarray(factors, float)
    return Map(lambda p: p * f, lambda p: np.broadcast_to(np.diag(f), (*p.shape, 3)), f"stretch {f.tolist()}")


def grading(axis: int, scale: Callable[[Array], Array] | tuple[float, float], length: float) -> Map:
    """Cell size graded along one axis: the local scale (1 = the nominal cell) at lattice coordinate x in [0, length].

    `scale` is a positive function of x, or the pair (at 0, at length) of a linear grading. Other axes stay as they are.
    The mapped coordinate is the integral of the scale from 0, exact for the linear grading, adaptive otherwise.
    """
    if callable(scale):
        rate = scale

        def moved(x: Array) -> Array:
            flat = np.asarray([quad_vec(rate, 0.0, float(t), epsabs=1e-13 * length)[0] for t in x.ravel()])
            return flat.reshape(x.shape)
    else:
        low, high = scale
        if min(low, high) <= 0:
            raise InvalidRequest(f"scales {scale} must be positive")
        slope = (high - low) / length

        def rate(x: Array) -> Array:
            return low + slope * x

        def moved(x: Array) -> Array:
            return low * x + slope * x**2 / 2

    def function(p: Array) -> Array:
        q = p.copy()
        q[..., axis] = moved(p[..., axis])
        return q

    def jacobian(p: Array) -> Array:
        j = np.broadcast_to(np.eye(3), (*p.shape, 3)).copy()
        j[..., axis, axis] = rate(p[..., axis])
        return j

    return Map(function, jacobian, f"grading along {'xyz'[axis]}")


def cylinder(radius: float) -> Map:
    """Wrap the lattice round the z axis: y becomes the radius (y = 0 at `radius`), x the arc at that radius, z stays.

    A lattice of length 2 pi radius along x meets itself; a shorter one leaves a sector open.
    """
    if radius <= 0:
        raise InvalidRequest(f"radius {radius:g} must be positive")

    def function(p: Array) -> Array:
        angle, r = p[..., 0] / radius, radius + p[..., 1]
        return np.stack([r * np.sin(angle), r * np.cos(angle), p[..., 2]], axis=-1)

    def jacobian(p: Array) -> Array:
        angle, r = p[..., 0] / radius, radius + p[..., 1]
        s, c, o = np.sin(angle), np.cos(angle), np.zeros_like(angle)
        rows = [[r / radius * c, s, o], [-r / radius * s, c, o], [o, o, o + 1]]
        return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)

    return Map(function, jacobian, f"wrap round a cylinder of radius {radius:g}")


def composition(outer: Map, inner: Map, scale: float) -> Map:
    """outer after inner; `scale` is the cell edge for Jacobians by differences."""
    return Map(
        lambda p: outer(inner(p)),
        lambda p: outer.jacobian(inner(p), scale) @ inner.jacobian(p, scale),
        f"{outer.name} after {inner.name}",
    )
