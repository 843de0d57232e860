"""Coordinate maps of a lattice: smooth functions of points in model units, with their Jacobians.

The *mid surface* of a lattice is mapped, and its walls are offset along the normal of the mapped surface, so a wall keeps its
thickness wherever the map stretches. A `Map` has a function and, where it is known, the exact Jacobian; any other callable is
differentiated by central differences of sixth order.
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
"""Difference step in cell edges: it balances truncation (1e-16 of the seventh derivative) and round-off (1e-13)."""


@dataclass(frozen=True, slots=True)
class Map:
    """A smooth coordinate map of a lattice, in model units.

    Parameters
    ----------
    function : callable
        Maps points (..., 3) to points (..., 3). It must be one-to-one over the lattice and one cell beyond its box.
    jacobian_function : callable, optional
        Maps points (..., 3) to Jacobians (..., 3, 3), entry (i, j) the derivative of coordinate i by coordinate j. Central
        differences are used if it is None.
    name : str, optional
        The name of the map in messages.

    Examples
    --------
    >>> import numpy as np
    >>> from tpmscad import maps
    >>> shear = maps.Map(lambda p: p + 0.1 * np.roll(p, 1, axis=-1), name="shear")
    >>> shear([0.0, 0.0, 1.0])
    array([0.1, 0. , 1. ])
    """

    function: Callable[[Array], Array]
    jacobian_function: Callable[[Array], Array] | None = None
    name: str = "user map"

    def __call__(self, points: ArrayLike) -> Array:
        """Return the images of points.

        Parameters
        ----------
        points : array_like, shape (..., 3)
            Points in lattice coordinates, in model units.

        Returns
        -------
        ndarray, shape (..., 3)
            The images, in model units.

        Raises
        ------
        InvalidRequest
            If the function returns another shape, or a value that is not finite.
        """
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
        """Return the Jacobian matrices of the map.

        Parameters
        ----------
        points : array_like, shape (..., 3)
            Points in model units.
        scale : float
            The cell edge in model units, which sets the difference step if there is no exact Jacobian.

        Returns
        -------
        ndarray, shape (..., 3, 3)
            Entry (i, j) is the derivative of image coordinate i by coordinate j.
        """
        points = np.asarray(points, float)
        if self.jacobian_function is not None:
            return np.asarray(self.jacobian_function(points), float)
        h = DIFFERENCE_STEP_CELLS * scale
        columns = []
        for axis in np.eye(3):
            difference = [self(points + k * h * axis) - self(points - k * h * axis) for k in (1, 2, 3)]
            columns.append((45 * difference[0] - 9 * difference[1] + difference[2]) / (60 * h))
        return np.stack(columns, axis=-1)


def as_map(function: Map | Callable[[Array], Array]) -> Map:
    """Return a callable as a `Map`.

    Parameters
    ----------
    function : Map or callable
        A map, or a function of points (..., 3) that returns points (..., 3), in model units.

    Returns
    -------
    Map
        The map itself, or a map of the function with differences for its Jacobian.

    Examples
    --------
    >>> from tpmscad import maps
    >>> maps.as_map(lambda p: 2.0 * p)([1.0, 2.0, 3.0])
    array([2., 4., 6.])
    """
    return function if isinstance(function, Map) else Map(function, name=getattr(function, "__name__", "user map"))


def stretching(factors: Sequence[float]) -> Map:
    """Return the map that stretches each axis by its own factor, as unequal cell edges do.

    Parameters
    ----------
    factors : sequence of float
        One factor per axis, dimensionless.

    Returns
    -------
    Map
        The map x -> factors * x, with its exact Jacobian.

    Examples
    --------
    >>> from tpmscad import maps
    >>> maps.stretching((1.0, 1.0, 2.0))([1.0, 1.0, 1.0])
    array([1., 1., 2.])
    """
    f = np.asarray(factors, float)
    return Map(lambda p: p * f, lambda p: np.broadcast_to(np.diag(f), (*p.shape, 3)), f"stretch {f.tolist()}")


def grading(axis: int, scale: Callable[[Array], Array] | tuple[float, float], length: float) -> Map:
    """Return the map that grades the cell size along one axis; the other axes stay as they are.

    Parameters
    ----------
    axis : int
        The axis of the grading: 0, 1 or 2.
    scale : callable or (float, float)
        The local scale of the cell (1 = nominal cell): a positive function of the lattice coordinate along the axis in model
        units, or its values at 0 and at `length`, between which it is linear.
    length : float
        The extent of the lattice along the axis in model units.

    Returns
    -------
    Map
        The map with its exact Jacobian.

    Raises
    ------
    InvalidRequest
        If a scale of the pair is not positive.

    Notes
    -----
    The mapped coordinate is the integral of the scale from 0: in closed form for the linear grading, else by adaptive
    quadrature.

    Examples
    --------
    >>> from tpmscad import maps
    >>> maps.grading(2, (1.0, 2.0), 10.0)([0.0, 0.0, 10.0])
    array([ 0.,  0., 15.])
    """
    if callable(scale):
        rate = scale

        def moved(x: Array) -> Array:
            flat = np.asarray([quad_vec(rate, 0.0, float(t), epsabs=1e-13 * length)[0] for t in x.ravel()])
            return flat.reshape(x.shape)
    else:
        low, high = scale
        if min(low, high) <= 0:
            raise InvalidRequest(f"scales {scale} of a grading must be positive")
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
    """Return the map that wraps a lattice around the z axis.

    Lattice coordinate x becomes the arc length at `radius`, y the radial distance from there, and z stays.

    Parameters
    ----------
    radius : float
        The radius in model units at which y = 0.

    Returns
    -------
    Map
        The map with its exact Jacobian.

    Raises
    ------
    InvalidRequest
        If the radius is not positive.

    Notes
    -----
    A lattice of length 2 pi radius along x meets itself; a shorter one leaves a sector open.

    Examples
    --------
    >>> from tpmscad import maps
    >>> maps.cylinder(10.0)([0.0, 1.0, 2.0])
    array([ 0., 11.,  2.])
    """
    if radius <= 0:
        raise InvalidRequest(f"radius {radius:g} of a cylinder must be positive")

    def function(p: Array) -> Array:
        angle, r = p[..., 0] / radius, radius + p[..., 1]
        return np.stack([r * np.sin(angle), r * np.cos(angle), p[..., 2]], axis=-1)

    def jacobian(p: Array) -> Array:
        angle, r = p[..., 0] / radius, radius + p[..., 1]
        s, c, o = np.sin(angle), np.cos(angle), np.zeros_like(angle)
        rows = [[r / radius * c, s, o], [-r / radius * s, c, o], [o, o, o + 1]]
        return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)

    return Map(function, jacobian, f"wrap around a cylinder of radius {radius:g}")


def composition(outer: Map, inner: Map, scale: float) -> Map:
    """Return the composition of two maps: `outer` after `inner`.

    Parameters
    ----------
    outer, inner : Map
        The maps; `inner` is applied first.
    scale : float
        The cell edge in model units, for Jacobians by differences.

    Returns
    -------
    Map
        The map x -> outer(inner(x)); its Jacobian follows the chain rule.

    Examples
    --------
    >>> from tpmscad import maps
    >>> maps.composition(maps.cylinder(10.0), maps.stretching((1.0, 2.0, 1.0)), 5.0)([0.0, 1.0, 2.0])
    array([ 0., 12.,  2.])
    """
    return Map(
        lambda p: outer(inner(p)),
        lambda p: outer.jacobian(inner(p), scale) @ inner.jacobian(p, scale),
        f"{outer.name} after {inner.name}",
    )
