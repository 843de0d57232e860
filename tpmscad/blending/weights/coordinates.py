"""Scalar coordinates t(p) of univariate weights: a direction, the radius of a cylinder, the radius of a sphere.

These are the coordinates of section 3.1.1 (eqs 7, 10 and 12) of the porous-blending paper, for any direction, axis and centre.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Protocol

import numpy as np

from tpmscad._typing import Array
from tpmscad.api.argument_kinds import POINT
from tpmscad.api.public_calls import validate_constructor
from tpmscad.errors import InvalidRequest
from tpmscad.fields.field import Field
from tpmscad.fields.tape.tape_nodes import Node, norm, sum_nodes

Vector = tuple[float, float, float]


class Coordinate(Protocol):
    """A coordinate t(points (..., 3)) -> (...) in model units, and its gradient (..., 3)."""

    def __call__(self, points: Array) -> Array:
        """Coordinates (...) of points (..., 3)."""
        ...

    def gradient(self, points: Array) -> Array:
        """Exact gradients (..., 3) at points (..., 3)."""
        ...


@validate_constructor
@dataclass(frozen=True, slots=True)
class LinearCoordinate(Field):
    """The coordinate along a direction, measured from the origin (eq. 7).

    Raises
    ------
    InvalidRequest
        If the direction is zero or not finite.

    Examples
    --------
    >>> import numpy as np
    >>> from tpmscad.blending import LinearCoordinate
    >>> float(LinearCoordinate((0, 0, 2))(np.array([1.0, 2.0, 3.0])))
    3.0
    """

    direction: Annotated[Vector, POINT, "The direction; its length does not matter."] = (1.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        _check_direction(self.direction)

    def trace(self, x: Node, y: Node, z: Node) -> Node:
        """The coordinate on the nodes of a tape."""
        unit = _normalised_direction(self.direction).tolist()
        return sum_nodes([d * t for d, t in zip(unit, (x, y, z), strict=True) if d != 0])

    @property
    def axis(self) -> int | None:
        """The axis 0, 1 or 2 if the direction is that of x, y or z; None for any other direction."""
        unit = _normalised_direction(self.direction)
        return int(np.argmax(unit)) if np.max(unit) == 1.0 else None


@validate_constructor
@dataclass(frozen=True, slots=True)
class CylinderRadius(Field):
    """The distance from an axis (eq. 10).

    Raises
    ------
    InvalidRequest
        If the direction is zero or not finite.

    Examples
    --------
    >>> import numpy as np
    >>> from tpmscad.blending import CylinderRadius
    >>> float(CylinderRadius()(np.array([3.0, 4.0, 7.0])))
    5.0
    """

    origin: Annotated[Vector, POINT, "A point of the axis, in model units."] = (0.0, 0.0, 0.0)
    direction: Annotated[Vector, POINT, "The direction of the axis; its length does not matter."] = (0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        _check_direction(self.direction)

    def trace(self, x: Node, y: Node, z: Node) -> Node:
        """The coordinate on the nodes of a tape."""
        unit = _normalised_direction(self.direction).tolist()
        offset = [t - o for t, o in zip((x, y, z), self.origin, strict=True)]
        along = sum_nodes([d * n for d, n in zip(offset, unit, strict=True)])
        return norm(*(d - n * along for d, n in zip(offset, unit, strict=True)))


@validate_constructor
@dataclass(frozen=True, slots=True)
class SphereRadius(Field):
    """The distance from a point (eq. 12).

    Examples
    --------
    >>> import numpy as np
    >>> from tpmscad.blending import SphereRadius
    >>> float(SphereRadius((1, 0, 0))(np.array([1.0, 3.0, 4.0])))
    5.0
    """

    centre: Annotated[Vector, POINT, "The point, in model units."] = (0.0, 0.0, 0.0)

    def trace(self, x: Node, y: Node, z: Node) -> Node:
        """The coordinate on the nodes of a tape."""
        return norm(*(t - c for t, c in zip((x, y, z), self.centre, strict=True)))


def _normalised_direction(direction: Vector) -> Array:
    vector = np.array(direction, float)
    return vector / np.sqrt(vector @ vector)


def _check_direction(direction: Vector) -> None:
    if not np.any(direction) or not np.all(np.isfinite(direction)):
        raise InvalidRequest(f"direction {direction} has no length: give three finite numbers that are not all zero")
