"""Fields in transformed coordinates: translated, rotated, scaled, or deformed by a map."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from tpmscad._typing import Array, BoxCorners
from tpmscad.api.argument_kinds import POINT
from tpmscad.api.public_calls import call_for_array, validate_call
from tpmscad.api.shared_kinds import DIRECTION, FIELD, FUNCTION, MAP, NUMBER, POSITIVE
from tpmscad.errors import InvalidRequest
from tpmscad.fields.data_box import DataBox
from tpmscad.fields.field import Field, FieldLike, as_field
from tpmscad.fields.kinds.data_domains import move_data
from tpmscad.fields.periods_and_directions import Direction, as_unit_vector
from tpmscad.fields.tape.evaluation import FieldJet, Triple, stack_points
from tpmscad.fields.tape.function_calls import DIFFERENCE_STEP, DerivativeCheck, central_differences
from tpmscad.fields.tape.tape_nodes import Node, sum_nodes

IDENTITY: tuple[Triple, Triple, Triple] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


@dataclass(frozen=True, slots=True)
class AffineTransformedField(Field):
    """factor * f(matrix p + shift)."""

    field: Field
    matrix: tuple[Triple, Triple, Triple]
    shift: Triple
    factor: float

    def trace(self, x: Node, y: Node, z: Node) -> Node:
        """The formula on the nodes of a tape."""
        coordinates = [
            sum_nodes([factor * t for factor, t in zip(row, (x, y, z), strict=True) if factor != 0]) + shift
            for row, shift in zip(self.matrix, self.shift, strict=True)
        ]
        return self.factor * self.field.trace(*coordinates)

    @property
    def notes(self) -> tuple[str, ...]:
        """What was assumed of the data."""
        return tuple(getattr(self.field, "notes", ()))

    def data_box(self) -> DataBox | None:
        """The box of the data, moved."""
        box = self.field.data_box() if self.factor > 0 else None
        return None if box is None else box.take_back(np.array(self.matrix), np.array(self.shift))

    @property
    def domain(self) -> BoxCorners | None:
        """The box of the data, or one around the moved box of what they are combined with."""
        box, inner = self.data_box(), self.field.domain
        if box is None and inner is not None and self.factor > 0:
            box = DataBox.of_corners(inner, (1, 1, 1)).take_back(np.array(self.matrix), np.array(self.shift))
        return None if box is None else box.domain

    def periods(self) -> Triple | None:
        """Periods along the axes, or None."""
        return self.field.periods() if self.matrix == IDENTITY else None


@dataclass(frozen=True, slots=True, eq=False)
class MappedField(Field):
    """f(mapping(p)), with the gradient J^T grad f by the chain rule."""

    field: Field
    mapping: Callable[[Array], Any]
    jacobian: Callable[[Array], Any] | None
    step: float
    check: DerivativeCheck

    def at(self, x: Array, y: Array, z: Array) -> Array:
        """Values at coordinates that broadcast."""
        points, shape = stack_points(x, y, z)
        return self.field.at(*self._image(points)).reshape(shape)

    def jet(self, x: Array, y: Array, z: Array) -> FieldJet:
        """Value and partial derivatives at coordinates that broadcast."""
        points, shape = stack_points(x, y, z)
        f, fx, fy, fz = self.field.jet(*self._image(points))
        if self.jacobian is None:
            jacobian = central_differences(self._stack_image, points, self.step)
        else:
            jacobian = call_for_array("the Jacobian", self.jacobian, points)
            if jacobian.shape != (len(points), 3, 3):
                raise InvalidRequest(
                    f"the Jacobian gave shape {jacobian.shape} for {len(points)} points: it must return (n, 3, 3), "
                    "derivatives of coordinate i by x, y, z in row i"
                )
            self.check.run(self._stack_image, points, jacobian, self.step)
        gx, gy, gz = (
            (jacobian[:, 0, axis] * fx + jacobian[:, 1, axis] * fy + jacobian[:, 2, axis] * fz).reshape(shape)
            for axis in range(3)
        )
        return np.broadcast_to(f, len(points)).reshape(shape), gx, gy, gz

    def _stack_image(self, points: Array) -> Array:
        return np.stack(self._image(points), axis=-1)

    def _image(self, points: Array) -> tuple[Array, Array, Array]:
        image = call_for_array("the map", self.mapping, points)
        if image.shape != points.shape:
            raise InvalidRequest(
                f"the map gave shape {image.shape} for points of shape {points.shape}: it must keep the shape"
            )
        if not np.isfinite(image).all():
            first = points[np.flatnonzero(~np.isfinite(image).all(axis=-1))[0]]
            raise InvalidRequest(f"the map is not finite at ({', '.join(f'{c:g}' for c in first)}): define it there")
        return image[:, 0].copy(), image[:, 1].copy(), image[:, 2].copy()


@validate_call()
def warp(
    field: Annotated[FieldLike, FIELD, "The field f in its own, straight coordinates."],
    map: Annotated[
        Callable[[Array], Any],
        MAP,
        "map(points (n, 3)) -> (n, 3), from points of the model (the deformed part) to the coordinates of the field.",
    ],
    jacobian: Annotated[
        Callable[[Array], Any] | None,
        FUNCTION.described_as("a function of points (n, 3) that returns (n, 3, 3)"),
        "jacobian(points (n, 3)) -> (n, 3, 3), row i the derivatives of coordinate i; by default central differences.",
    ] = None,
    *,
    step: Annotated[
        float,
        POSITIVE.described_as(example="0.001"),
        "Step of the central differences of fourth order, in model units.",
    ] = DIFFERENCE_STEP,
) -> Field:
    """Return the field p -> f(map(p)).

    Returns
    -------
    Field
        The field. It is not periodic. Data are empty where the map leaves the box of their samples.

    Raises
    ------
    InvalidRequest
        On evaluation, if the map or the Jacobian returns another shape or values that are not finite, or the Jacobian is not that
        of the map.

    Examples
    --------
    >>> import numpy as np
    >>> from tpmscad import fields
    >>> def unroll(p):
    ...     return np.stack([np.hypot(p[:, 0], p[:, 1]), 10 * np.arctan2(p[:, 1], p[:, 0]), p[:, 2]], axis=-1)
    >>> ring = fields.warp(fields.tpms("gyroid", 2 * np.pi), unroll)
    """
    check = DerivativeCheck("the Jacobian of the map")
    return move_data(as_field(field), lambda part: MappedField(part, map, jacobian, step, check))


@validate_call()
def translate(
    field: Annotated[FieldLike, FIELD, "The field."],
    vector: Annotated[Sequence[float], POINT, "Translation, in model units."],
) -> Field:
    """Return the field translated by a vector.

    Returns
    -------
    Field
        The translated field; periods stay. Data keep a `domain`, beyond which they are empty.

    Examples
    --------
    >>> from tpmscad import fields
    >>> ball = fields.translate(fields.sphere((0, 0, 0), 1.0), (5, 0, 0))
    >>> float(ball((5.0, 0.0, 0.0)))
    -1.0
    """
    x, y, z = vector
    return place_field(as_field(field), IDENTITY, (-x, -y, -z), 1.0)


@validate_call()
def rotate(
    field: Annotated[FieldLike, FIELD, "The field."],
    axis: Annotated[Direction, DIRECTION, '"x", "y", "z", "-x", ... or a vector of any length.'],
    angle: Annotated[
        float, NUMBER.described_as(example="20"), "Angle in degrees, counter-clockwise seen from the tip of the axis."
    ],
    center: Annotated[Sequence[float], POINT, "Point on the axis, in model units."] = (0.0, 0.0, 0.0),
) -> Field:
    """Return the field rotated about an axis.

    Returns
    -------
    Field
        The rotated field. Data keep a `domain`, beyond which they are empty.

    Examples
    --------
    >>> from tpmscad import fields
    >>> bar = fields.rotate(fields.box((-3, -1, -1), (3, 1, 1)), "z", 90)
    >>> round(float(bar((0.0, 2.5, 0.0))), 6)
    -0.5
    """
    n, c = np.array(as_unit_vector(axis)), np.array(center)
    turn = np.deg2rad(angle)
    cross = np.array([[0.0, -n[2], n[1]], [n[2], 0.0, -n[0]], [-n[1], n[0], 0.0]])
    back = np.eye(3) - np.sin(turn) * cross + (1 - np.cos(turn)) * (cross @ cross)
    return place_field(as_field(field), _as_rows(back), _as_vector(c - back @ c), 1.0)


@validate_call()
def scale(
    field: Annotated[FieldLike, FIELD, "The field."],
    factor: Annotated[
        float, POSITIVE, "Scale factor, positive. The values are scaled too, so that a signed distance remains one."
    ],
    center: Annotated[Sequence[float], POINT, "Fixed point, in model units."] = (0.0, 0.0, 0.0),
) -> Field:
    """Return the field scaled about a center.

    Returns
    -------
    Field
        The scaled field. Data keep a `domain`, beyond which they are empty.

    Examples
    --------
    >>> from tpmscad import fields
    >>> ball = fields.scale(fields.sphere((0, 0, 0), 1.0), 4.0)
    >>> float(ball((1.0, 0.0, 0.0)))
    -3.0
    """
    c = np.array(center)
    return place_field(as_field(field), _as_rows(np.eye(3) / factor), _as_vector(c - c / factor), factor)


def place_field(field: Field, matrix: tuple[Triple, Triple, Triple], shift: Triple, factor: float) -> Field:
    """The field factor * f(matrix p + shift), empty beyond the box of data; see `data_domains`."""
    return move_data(field, lambda part: AffineTransformedField(part, matrix, shift, factor))


def place_samples(field: Field, directions: Array, first: Array) -> Field:
    """Data whose own axes run along directions, the columns of (3, 3), from a point (3,): placed, and not resampled."""
    back = np.asarray(np.linalg.inv(directions), float)
    return place_field(field, _as_rows(back), _as_vector(-back @ first), 1.0)


def _as_rows(matrix: Array) -> tuple[Triple, Triple, Triple]:
    return _as_vector(matrix[0]), _as_vector(matrix[1]), _as_vector(matrix[2])


def _as_vector(array: Array) -> Triple:
    return float(array[0]), float(array[1]), float(array[2])
