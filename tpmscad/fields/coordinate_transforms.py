"""Fields in other coordinates: moved, turned, scaled, or bent by a map."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tpmscad._typing import Array
from tpmscad.errors import InvalidRequest
from tpmscad.fields.evaluation import FieldJet, Triple, as_positive, as_triple, stack_points
from tpmscad.fields.field import Field, FieldLike, as_field
from tpmscad.fields.function_field import DIFFERENCE_STEP, central_differences
from tpmscad.fields.primitive_regions import Direction, as_unit_vector

IDENTITY: tuple[Triple, Triple, Triple] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


@dataclass(frozen=True, slots=True)
class AffineTransformedField(Field):
    """factor * f(matrix p + shift)."""

    field: Field
    matrix: tuple[Triple, Triple, Triple]
    shift: Triple
    factor: float

    def at(self, x: Array, y: Array, z: Array) -> Array:
        value = self.field.at(*self._moved(x, y, z))
        return value if self.factor == 1 else self.factor * value

    def jet(self, x: Array, y: Array, z: Array) -> FieldJet:
        f, *slope = self.field.jet(*self._moved(x, y, z))
        c = self.factor
        gx, gy, gz = (_linear_combination([c * row[axis] for row in self.matrix], slope) for axis in range(3))
        return f if c == 1 else c * f, gx, gy, gz

    def periods(self) -> Triple | None:
        return self.field.periods() if self.matrix == IDENTITY else None

    def _moved(self, *coordinates: Array) -> list[Array]:
        """Only with the coordinates that have a part in it, so that a grid stays one under shifts and scalings."""
        moved = []
        for row, shift in zip(self.matrix, self.shift, strict=True):
            t = _linear_combination(row, coordinates)
            moved.append(t if shift == 0 else t + shift)
        return moved


@dataclass(frozen=True, slots=True, eq=False)
class MappedField(Field):
    """f(map(p)) with the gradient J^T grad f."""

    field: Field
    map: Callable[[Array], Any]
    jacobian: Callable[[Array], Any] | None
    step: float

    def at(self, x: Array, y: Array, z: Array) -> Array:
        points, shape = stack_points(x, y, z)
        return self.field.at(*self._image(points)).reshape(shape)

    def jet(self, x: Array, y: Array, z: Array) -> FieldJet:
        points, shape = stack_points(x, y, z)
        f, fx, fy, fz = self.field.jet(*self._image(points))
        if self.jacobian is None:
            columns = central_differences(lambda p: np.stack(self._image(p), axis=-1), points, self.step)
        else:
            columns = np.asarray(self.jacobian(points), float)
            if columns.shape != (len(points), 3, 3):
                raise InvalidRequest(
                    f"the Jacobian gave shape {columns.shape} for {len(points)} points: it must return (n, 3, 3), "
                    "derivatives of coordinate i by x, y, z in row i"
                )
        gx, gy, gz = (
            (columns[:, 0, axis] * fx + columns[:, 1, axis] * fy + columns[:, 2, axis] * fz).reshape(shape)
            for axis in range(3)
        )
        return np.broadcast_to(f, len(points)).reshape(shape), gx, gy, gz

    def _image(self, points: Array) -> tuple[Array, Array, Array]:
        image = np.asarray(self.map(points), float)
        if image.shape != points.shape:
            raise InvalidRequest(
                f"the map gave shape {image.shape} for points of shape {points.shape}: it must keep it"
            )
        if not np.isfinite(image).all():
            first = points[np.flatnonzero(~np.isfinite(image).all(axis=-1))[0]]
            raise InvalidRequest(f"the map is not finite at ({', '.join(f'{c:g}' for c in first)}): mend it there")
        return image[:, 0].copy(), image[:, 1].copy(), image[:, 2].copy()


def mapped(
    field: FieldLike,
    map: Callable[[Array], Any],
    jacobian: Callable[[Array], Any] | None = None,
    *,
    step: float = DIFFERENCE_STEP,
) -> MappedField:
    """The field p -> f(map(p)).

    map: points (n, 3) of the model to points (n, 3) of the field's own coordinates (from the bent part back to the straight
    lattice). jacobian: (n, 3, 3), row i the derivatives of coordinate i; by default central differences of fourth order.
    """
    return MappedField(as_field(field), map, jacobian, as_positive(step, "step"))


def translated(field: FieldLike, vector: Sequence[float]) -> AffineTransformedField:
    """The field moved by a vector."""
    x, y, z = as_triple(vector, "vector")
    return AffineTransformedField(as_field(field), IDENTITY, (-x, -y, -z), 1.0)


def rotated(
    field: FieldLike, axis: Direction, angle: float, center: Sequence[float] = (0.0, 0.0, 0.0)
) -> AffineTransformedField:
    """The field turned by `angle` degrees about the axis through `center`, counter-clockwise seen from its tip."""
    n, c = np.array(as_unit_vector(axis, "axis")), np.array(as_triple(center, "center"))
    turn = np.deg2rad(angle)
    cross = np.array([[0.0, -n[2], n[1]], [n[2], 0.0, -n[0]], [-n[1], n[0], 0.0]])
    back = np.eye(3) - np.sin(turn) * cross + (1 - np.cos(turn)) * (cross @ cross)
    return AffineTransformedField(as_field(field), _as_rows(back), _as_vector(c - back @ c), 1.0)


def scaled(field: FieldLike, factor: float, center: Sequence[float] = (0.0, 0.0, 0.0)) -> AffineTransformedField:
    """The field made larger by a factor about a center; its values too, so that distances remain distances."""
    s, c = as_positive(factor, "factor"), np.array(as_triple(center, "center"))
    return AffineTransformedField(as_field(field), _as_rows(np.eye(3) / s), _as_vector(c - c / s), s)


def _linear_combination(factors: Sequence[float], parts: Sequence[Array]) -> Array:
    total: Array | None = None
    for factor, part in zip(factors, parts, strict=True):
        if factor != 0:
            term = part if factor == 1 else factor * part
            total = term if total is None else total + term
    return np.zeros_like(parts[0]) if total is None else total


def _as_rows(matrix: Array) -> tuple[Triple, Triple, Triple]:
    return _as_vector(matrix[0]), _as_vector(matrix[1]), _as_vector(matrix[2])


def _as_vector(array: Array) -> Triple:
    return float(array[0]), float(array[1]), float(array[2])
