"""Boxes, half-spaces, spheres and cylinders as exact signed distances, negative inside; gradients are unit vectors."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import reduce
from typing import Annotated

import numpy as np

from tpmscad.api.argument_kinds import POINT
from tpmscad.api.public_calls import validate_call
from tpmscad.api.shared_kinds import DIRECTION, POSITIVE, UNBOUNDED_POINT
from tpmscad.errors import InvalidRequest
from tpmscad.fields.field import Field
from tpmscad.fields.periods_and_directions import Direction, as_unit_vector
from tpmscad.fields.tape.evaluation import Triple
from tpmscad.fields.tape.tape_nodes import Node, absolute, choose_extreme, clamp, norm, select, sum_nodes


@dataclass(frozen=True, slots=True)
class BoxRegion(Field):
    """Signed distance to the surface of an axis-parallel box, whose coordinates may be infinite."""

    lo: Triple
    hi: Triple

    def trace(self, x: Node, y: Node, z: Node) -> Node:
        """The formula on the nodes of a tape."""
        # at equal distances the upper face, so that the gradient there is that of the upper side
        excess = [choose_extreme(+1, t - hi, lo - t) for t, lo, hi in zip((x, y, z), self.lo, self.hi, strict=True)]
        return _corner_distance(*excess)


@dataclass(frozen=True, slots=True)
class HalfSpaceRegion(Field):
    """Signed distance to the plane (p - point) . normal = 0, negative behind it: an affine function of unit slope."""

    point: Triple
    normal: Triple

    def trace(self, x: Node, y: Node, z: Node) -> Node:
        """The formula on the nodes of a tape."""
        return sum_nodes([(t - p) * n for t, p, n in zip((x, y, z), self.point, self.normal, strict=True)])


@dataclass(frozen=True, slots=True)
class SphereRegion(Field):
    """Signed distance to a sphere; at the center, where no gradient exists, (1, 0, 0) is returned."""

    center: Triple
    radius: float

    def trace(self, x: Node, y: Node, z: Node) -> Node:
        """The formula on the nodes of a tape."""
        dx, dy, dz = (t - c for t, c in zip((x, y, z), self.center, strict=True))
        distance = norm(dx, dy, dz)
        return select(distance > 0.0, distance, dx) - self.radius


@dataclass(frozen=True, slots=True)
class CylinderRegion(Field):
    """Signed distance to a cylinder about the line center + t axis; infinitely long, or |t| <= height / 2."""

    center: Triple
    axis: Triple
    radius: float
    height: float | None

    def trace(self, x: Node, y: Node, z: Node) -> Node:
        """The formula on the nodes of a tape."""
        offset = [t - c for t, c in zip((x, y, z), self.center, strict=True)]
        along = sum_nodes([d * n for d, n in zip(offset, self.axis, strict=True)])
        across = [d - along * n for d, n in zip(offset, self.axis, strict=True)]
        distance = norm(*across)
        aside = sum_nodes([w * a for w, a in zip(across, _perpendicular_unit_vector(self.axis), strict=True)])
        radial = select(distance > 0.0, distance, aside) - self.radius
        return radial if self.height is None else _corner_distance(radial, absolute(along) - self.height / 2)


@validate_call()
def box(
    lo: Annotated[
        Triple,
        UNBOUNDED_POINT,
        "Corners, in model units; each coordinate of `lo` is below that of `hi`. Coordinates may be infinite: "
        "box((0.4, -inf, -inf), (0.6, inf, inf)) is a slab.",
    ],
    hi: Annotated[Triple, UNBOUNDED_POINT.described_as(example="(10, 10, 10)"), "As `lo`."],
) -> BoxRegion:
    """Return the axis-parallel box between two corners.

    Returns
    -------
    BoxRegion
        The signed distance, negative inside.

    Raises
    ------
    InvalidRequest
        If the box is empty or all of space.

    Examples
    --------
    >>> from tpmscad import fields
    >>> float(fields.box((0, 0, 0), (2, 2, 2))((1.0, 1.0, 1.5)))
    -0.5
    """
    if not all(a < b for a, b in zip(lo, hi, strict=True)):
        raise InvalidRequest(f"box from {lo} to {hi}: two corners (x, y, z) are needed, each lo below its hi")
    if np.isinf(lo).all() and np.isinf(hi).all():
        raise InvalidRequest("the box is all of space: at least one of its faces must be finite")
    return BoxRegion(lo, hi)


@validate_call()
def halfspace(
    point: Annotated[Triple, POINT, "Point of the plane, in model units."],
    normal: Annotated[Direction, DIRECTION, 'Outward normal: "x", "-y", ... or a vector of any length.'],
) -> HalfSpaceRegion:
    """Return the half-space behind a plane.

    Returns
    -------
    HalfSpaceRegion
        The signed distance (p - point) . n, negative behind the plane.

    Examples
    --------
    >>> from tpmscad import fields
    >>> float(fields.halfspace((0, 0, 1), "z")((0.0, 0.0, 3.0)))
    2.0
    """
    return HalfSpaceRegion(point, as_unit_vector(normal))


@validate_call()
def sphere(
    center: Annotated[Triple, POINT, "Center, in model units."],
    radius: Annotated[float, POSITIVE.described_as("a positive, finite number", "5.0"), "Radius, positive."],
) -> SphereRegion:
    """Return the ball with a center and a radius.

    Returns
    -------
    SphereRegion
        The signed distance, negative inside.

    Examples
    --------
    >>> from tpmscad import fields
    >>> float(fields.sphere((0, 0, 0), 2.0)((0.0, 3.0, 4.0)))
    3.0
    """
    return SphereRegion(center, radius)


@validate_call()
def cylinder(
    center: Annotated[Triple, POINT, "Middle of the axis, in model units."],
    radius: Annotated[float, POSITIVE.described_as("a positive, finite number", "5.0"), "Radius, positive."],
    axis: Annotated[Direction, DIRECTION, 'Direction: "x", "y", "z" or a vector of any length.'] = "z",
    height: Annotated[
        float | None, POSITIVE, "Height, half of it on each side of the center; infinite by default."
    ] = None,
) -> CylinderRegion:
    """Return a circular cylinder.

    Returns
    -------
    CylinderRegion
        The signed distance, negative inside.

    Examples
    --------
    >>> from tpmscad import fields
    >>> float(fields.cylinder((0, 0, 0), 2.0, "z")((3.0, 4.0, 9.0)))
    3.0
    """
    return CylinderRegion(center, as_unit_vector(axis), radius, height)


def _corner_distance(*excess: Node) -> Node:
    """Signed distance to the intersection {all excess <= 0} of perpendicular half-spaces."""
    inside = reduce(lambda first, other: choose_extreme(+1, first, other), excess)
    return select(inside > 0.0, norm(*(clamp(e, 0.0, math.inf) for e in excess)), inside)


def _perpendicular_unit_vector(axis: Triple) -> Triple:
    """A unit vector perpendicular to an axis, the radial direction of points on the axis."""
    least = int(np.argmin(np.abs(axis)))
    across = np.cross(axis, np.eye(3)[least])
    return tuple(map(float, across / np.linalg.norm(across)))  # type: ignore[return-value]
