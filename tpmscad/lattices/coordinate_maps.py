"""Coordinate maps of a lattice: smooth functions of points in model units, with their Jacobians.

The *mid surface* of a lattice is mapped, and its walls are offset along the normal of the mapped surface, so a wall keeps its
thickness wherever the map stretches. A `Map` has a function and, where it is known, the exact Jacobian; any other callable is
differentiated by central differences of sixth order.

A map that repeats after the length of the lattice closes it: its ends meet, patch by patch, and become one part. A map that lays
walls of the lattice on each other is refused.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike
from scipy.integrate import quad_vec

from tpmscad._typing import Array
from tpmscad.api.argument_kinds import choice_of
from tpmscad.api.public_calls import call_for_array, validate_call, validate_constructor
from tpmscad.api.shared_kinds import ANYTHING, AXIS_NUMBER, FACTORS, FUNCTION, PAIR, POSITIVE, SCALE, TEXT
from tpmscad.errors import InvalidRequest
from tpmscad.lattices.spherical_charts import chart_along_equator, chart_from_pole

__all__ = ["Map", "as_map", "composition", "cylinder", "grading", "sphere", "stretching"]


DIFFERENCE_STEP_CELLS = 2e-3
"""Difference step in cell edges: it balances truncation (1e-16 of the seventh derivative) and round-off (1e-13)."""

SCALE_SAMPLES = 65
"""Points along the lattice at which a grading's scale is checked."""


@validate_constructor
@dataclass(frozen=True, slots=True)
class Map:
    """A smooth coordinate map of a lattice, in model units.

    Examples
    --------
    >>> import numpy as np
    >>> from tpmscad import maps
    >>> shear = maps.Map(lambda p: p + 0.1 * np.roll(p, 1, axis=-1), name="shear")
    >>> shear([0.0, 0.0, 1.0])
    array([0.1, 0. , 1. ])
    """

    function: Annotated[
        Callable[[Array], Array],
        FUNCTION.described_as(example="lambda p: p"),
        "Maps points (..., 3) to points (..., 3). It must be one-to-one over the lattice and one cell beyond its box.",
    ]
    jacobian_function: Annotated[
        Callable[[Array], Array] | None,
        FUNCTION,
        "Maps points (..., 3) to Jacobians (..., 3, 3), entry (i, j) the derivative of coordinate i by coordinate j. Central "
        "differences are used if it is None.",
    ] = None
    name: Annotated[str, TEXT, "The name of the map in messages."] = "user map"
    from_middle: Annotated[
        tuple[bool, bool, bool],
        ANYTHING,
        "Along which axes the coordinates that the map takes are counted from the middle of the lattice, not its lower end.",
    ] = (False, False, False)

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
        return _evaluate(
            self.name, self.function, points, points.shape, "a map takes (..., 3) points and returns as many"
        )

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
            name, returned = f"the Jacobian of {self.name}", "it takes (..., 3) points and returns matrices (..., 3, 3)"
            return _evaluate(name, self.jacobian_function, points, (*points.shape, 3), returned)
        h = DIFFERENCE_STEP_CELLS * scale
        columns = []
        for axis in np.eye(3):
            difference = [self(points + k * h * axis) - self(points - k * h * axis) for k in (1, 2, 3)]
            columns.append((45 * difference[0] - 9 * difference[1] + difference[2]) / (60 * h))
        return np.stack(columns, axis=-1)

    def images_and_jacobians(self, points: Array, scale: float) -> tuple[Array, Array]:
        """Return images (..., 3) and Jacobians (..., 3, 3) of points (..., 3); what `scale` is says `jacobian`."""
        return self(points), self.jacobian(points, scale)

    def over_block(self, size: Array) -> Map:
        """Return the map of a lattice whose block of cells starts at the origin.

        Parameters
        ----------
        size : ndarray, shape (3,)
            Edges of the block, in model units.

        Returns
        -------
        Map
            The same map of coordinates that are counted from the lower end of the block along every axis.
        """
        if not any(self.from_middle):
            return self
        shift = np.where(self.from_middle, size / 2, 0.0)
        exact = self.jacobian_function
        return Map(lambda p: self(p - shift), None if exact is None else lambda p: exact(p - shift), self.name)


IDENTITY = Map(lambda p: p, lambda p: np.broadcast_to(np.eye(3), (*p.shape, 3)), "the identity")
"""The map of a lattice that is not mapped: its patches are moved rigidly."""


@validate_call()
def as_map(
    function: Annotated[
        Map | Callable[[Array], Array],
        FUNCTION.described_as(example="lambda p: p"),
        "A map, or a function of points (..., 3) that returns points (..., 3), in model units.",
    ],
) -> Map:
    """Return a callable as a `Map`.

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


@validate_call()
def stretching(factors: Annotated[Sequence[float], FACTORS, "One positive factor per axis, dimensionless."]) -> Map:
    """Return the map that stretches each axis by its own factor, as unequal cell edges do.

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
    f = np.array(factors)
    return Map(lambda p: p * f, lambda p: np.broadcast_to(np.diag(f), (*p.shape, 3)), f"stretch {f.tolist()}")


@validate_call()
def grading(
    axis: Annotated[int, AXIS_NUMBER, "The axis of the grading: 0, 1 or 2."],
    scale: Annotated[
        Callable[[Array], Array] | tuple[float, float],
        SCALE,
        "The local scale of the cell (1 = nominal cell): a positive function of the lattice coordinate along the axis "
        "in model units, or its values at 0 and at `length`, between which it is linear.",
    ],
    length: Annotated[
        float, POSITIVE.described_as(example="40.0"), "The extent of the lattice along the axis in model units."
    ],
) -> Map:
    """Return the map that grades the cell size along one axis; the other axes stay as they are.

    Returns
    -------
    Map
        The map with its exact Jacobian.

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
        given = scale

        def rate(x: Array) -> Array:
            return call_for_array("the scale of a grading", given, x)

        _check_scales(rate(np.linspace(0.0, length, SCALE_SAMPLES)))

        def moved(x: Array) -> Array:
            flat = np.asarray([quad_vec(rate, 0.0, float(t), epsabs=1e-13 * length)[0] for t in x.ravel()])
            return flat.reshape(x.shape)
    else:
        low, high = scale
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


@validate_call()
def cylinder(
    radius: Annotated[
        float, POSITIVE.described_as("a positive, finite number", "5.0"), "The radius in model units at which y = 0."
    ],
) -> Map:
    """Return the map that wraps a lattice around the z axis.

    Lattice coordinate x becomes the arc length at `radius`, y the radial distance from there, and z stays.

    Returns
    -------
    Map
        The map with its exact Jacobian.

    Notes
    -----
    A lattice of length 2 pi radius along x closes to a ring: with N cells, ``radius = N * cell / (2 * pi)``. A shorter one
    leaves a sector open, and a longer one is refused.

    Examples
    --------
    >>> from tpmscad import maps
    >>> maps.cylinder(10.0)([0.0, 1.0, 2.0])
    array([ 0., 11.,  2.])
    """

    def function(p: Array) -> Array:
        angle, r = p[..., 0] / radius, radius + p[..., 1]
        return np.stack([r * np.sin(angle), r * np.cos(angle), p[..., 2]], axis=-1)

    def jacobian(p: Array) -> Array:
        angle, r = p[..., 0] / radius, radius + p[..., 1]
        s, c, o = np.sin(angle), np.cos(angle), np.zeros_like(angle)
        rows = [[r / radius * c, s, o], [-r / radius * s, c, o], [o, o, o + 1]]
        return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)

    return Map(function, jacobian, f"wrap around a cylinder of radius {radius:g}")


@validate_call()
def sphere(
    radius: Annotated[
        float, POSITIVE.described_as("a positive, finite number", "5.0"), "The radius in model units at which z = 0."
    ],
    *,
    chart: Annotated[
        str,
        choice_of("pole", "equator"),
        '"pole": the lattice lies on the sphere like a cloth whose centre is at the upper pole (0, 0, radius), '
        'straight lines through the centre along the meridians. "equator": x is the arc length along the equator and '
        "y that along the meridians; a lattice of length 2 pi radius along x closes to a band.",
    ] = "pole",
    centre: Annotated[
        Sequence[float] | None,
        PAIR.described_as(example="(0.0, 0.0)"),
        "The lattice coordinates (x, y) that come to the pole, or to longitude and latitude 0. By default the middle "
        'of the lattice ("equator": of y only).',
    ] = None,
) -> Map:
    """Return the map that wraps a lattice around the origin, as a dome or as a band.

    Lattice coordinate z becomes the radial distance from `radius`; x and y lie along the sphere. In both charts y at x = 0 runs
    along a great circle, true to length at `radius`.

    Returns
    -------
    Map
        The map with its exact Jacobian.

    Notes
    -----
    The chart of the pole is the azimuthal equidistant projection: at the angle t from the pole, lengths along the parallels
    shrink by sin(t) / t, to 0.64 on the equator. A lattice of length pi radius along x and y covers the upper half and, with its
    corners, reaches 127 degrees from the pole; the lower pole is singular, and lattices that come near it are refused. The
    chart of the equator shrinks lengths along the parallels by the cosine of the latitude; both poles are singular.

    Examples
    --------
    >>> import numpy as np
    >>> from tpmscad import maps
    >>> maps.sphere(10.0)([0.0, 0.0, 2.0])
    array([ 0.,  0., 12.])
    >>> np.round(maps.sphere(10.0)([5.0 * np.pi, 0.0, 0.0]), 9)
    array([10.,  0.,  0.])
    """
    x0, y0 = (0.0, 0.0) if centre is None else centre
    function, jacobian = chart_from_pole(radius) if chart == "pole" else chart_along_equator(radius)
    origin = np.array([x0, y0, 0.0])
    return Map(
        lambda p: function(p - origin),
        lambda p: jacobian(p - origin),
        f"wrap around a sphere of radius {radius:g} from its {chart}",
        (centre is None and chart == "pole", centre is None, False),
    )


@validate_call()
def composition(
    outer: Annotated[
        Map, FUNCTION.described_as("one of tpmscad.maps", "maps.cylinder(20)"), "The maps; `inner` is applied first."
    ],
    inner: Annotated[
        Map,
        FUNCTION.described_as("one of tpmscad.maps", "maps.stretching((1, 1, 2))"),
        "The maps; `inner` is applied first.",
    ],
    scale: Annotated[float, POSITIVE, "The cell edge in model units, for Jacobians by differences."],
) -> Map:
    """Return the composition of two maps: `outer` after `inner`.

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
    outer, inner = as_map(outer), as_map(inner)
    return Map(
        lambda p: outer(inner(p)),
        lambda p: outer.jacobian(inner(p), scale) @ inner.jacobian(p, scale),
        f"{outer.name} after {inner.name}",
        inner.from_middle,
    )


def _evaluate(
    name: str, function: Callable[[Array], Array], points: Array, shape: tuple[int, ...], returned: str
) -> Array:
    """Values of this shape of a user's function at points (..., 3); InvalidRequest if they have another or are not finite."""
    values = call_for_array(name, function, points)
    if values.shape != shape:
        raise InvalidRequest(f"{name} returned shape {values.shape} for points of shape {points.shape}; {returned}")
    if not np.isfinite(values).all():
        where = points.reshape(-1, 3)[~np.isfinite(values.reshape(points.size // 3, -1)).all(axis=1)][0]
        raise InvalidRequest(
            f"{name} is not finite at {where.tolist()}: give a smooth map, which must hold a cell beyond the lattice's box"
        )
    return values


def _check_scales(scales: ArrayLike) -> None:
    values = np.atleast_1d(np.asarray(scales, float))
    if not (np.isfinite(values).all() and values.min() > 0):
        wrong = values[~(np.isfinite(values) & (values > 0))][0]
        raise InvalidRequest(f"scale {wrong:g} of a grading must be positive and finite all along the lattice")
