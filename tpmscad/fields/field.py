"""What a field is: a function f(points (..., 3)) -> (...) of model coordinates, f < 0 solid, with its exact gradient.

A kind of field says how it is computed once, on three coordinate arrays that broadcast: `at(x, y, z)` for values, `jet(x, y, z)`
for values and the three partial derivatives. On points the three arrays are columns; on a grid they have shapes (nx, 1, 1),
(1, ny, 1) and (1, 1, nz), so that what depends on one coordinate is computed once per plane. Only elementwise operations are
used, in one order, so the two routes give the same bits, and a point the same bits in whatever company it is evaluated.
(Foreign functions, see `function.py`, can't promise that.)
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tpmscad.errors import InvalidRequest

if TYPE_CHECKING:
    from tpmscad.fields.algebra import Sum

Array = NDArray[np.float64]
Jet = tuple[Array, Array, Array, Array]
Triple = tuple[float, float, float]

SLAB = 1 << 16
"""Points evaluated at a time: half a megabyte per intermediate array, whatever the size of the grid, and up to twice as fast as
larger slabs. A gyroid takes 60 ns a point, and 3 ns on a grid of 200^3."""


class Field:
    """Base of all fields. Call it with points (..., 3) for values (...); `gradient` gives (..., 3), outward from the solid.

    `+ - *` combine fields and numbers; `a | b`, `a & b` and `~a` are union, intersection and complement of the solids.
    """

    __slots__ = ()
    __array_ufunc__ = None
    """A NumPy number on the left of an operator leaves the operation to the field."""

    def at(self, x: Array, y: Array, z: Array) -> Array:
        """Values at coordinates that broadcast against each other; the result may still have to be broadcast."""
        raise NotImplementedError

    def jet(self, x: Array, y: Array, z: Array) -> Jet:
        """Value, df/dx, df/dy, df/dz at coordinates that broadcast; the value has the bits of `at`."""
        raise NotImplementedError

    def periods(self) -> Triple | None:
        """The translations (px, py, pz) along the axes that leave the field unchanged, where it has them."""
        return None

    def __call__(self, points: ArrayLike) -> Array:
        flat, shape = _flat(points)
        values = np.empty(len(flat))
        for part in _parts(len(flat)):
            values[part] = self.at(*_columns(flat[part]))
        return values.reshape(shape)

    def gradient(self, points: ArrayLike) -> Array:
        """The exact gradient (..., 3); where two solids meet in an edge, that of one of them."""
        return self.value_and_gradient(points)[1]

    def value_and_gradient(self, points: ArrayLike) -> tuple[Array, Array]:
        """Values (...) and gradient (..., 3) in one pass."""
        flat, shape = _flat(points)
        values, slopes = np.empty(len(flat)), np.empty((len(flat), 3))
        for part in _parts(len(flat)):
            values[part], slopes[part, 0], slopes[part, 1], slopes[part, 2] = self.jet(*_columns(flat[part]))
        return values.reshape(shape), slopes.reshape(*shape, 3)

    def on_grid(self, x: ArrayLike, y: ArrayLike, z: ArrayLike) -> Array:
        """Values on the grid of all x with all y with all z: (nx, ny, nz), the same bits as on the grid's points."""
        axes = _axes(x, y, z)
        values = np.empty(tuple(len(axis) for axis in axes))
        for part, coordinates in _slabs(axes):
            values[part] = self.at(*coordinates)
        return values

    def gradient_on_grid(self, x: ArrayLike, y: ArrayLike, z: ArrayLike) -> tuple[Array, Array]:
        """Values (nx, ny, nz) and gradient (nx, ny, nz, 3) on that grid."""
        axes = _axes(x, y, z)
        values = np.empty(tuple(len(axis) for axis in axes))
        slopes = np.empty((*values.shape, 3))
        for part, coordinates in _slabs(axes):
            values[part], slopes[part, ..., 0], slopes[part, ..., 1], slopes[part, ..., 2] = self.jet(*coordinates)
        return values, slopes

    def __add__(self, other: FieldLike) -> Sum:
        return _algebra().Sum(self, as_field(other))

    def __radd__(self, other: FieldLike) -> Sum:
        return _algebra().Sum(as_field(other), self)

    def __sub__(self, other: FieldLike) -> Sum:
        return _algebra().Sum(self, -as_field(other))

    def __rsub__(self, other: FieldLike) -> Sum:
        return _algebra().Sum(as_field(other), -self)

    def __mul__(self, other: FieldLike) -> Field:
        return _algebra().product(self, other)

    __rmul__ = __mul__

    def __truediv__(self, number: float) -> Field:
        divisor = as_field(number)
        if getattr(divisor, "value", 0.0) == 0:
            raise InvalidRequest(f"a field can be divided by a number other than zero, not by {number!r}")
        return _algebra().product(self, 1.0 / float(number))

    def __neg__(self) -> Field:
        return _algebra().product(self, -1.0)

    __invert__ = __neg__

    def __or__(self, other: FieldLike) -> Field:
        return _booleans().union(self, other)

    def __and__(self, other: FieldLike) -> Field:
        return _booleans().intersection(self, other)


FieldLike = Field | float | Callable[[Array], Array]
"""What a field argument may be: a field, a number (constant field), or any function of points (..., 3)."""


def as_field(source: Any) -> Field:
    """A field from a field, a number or a function of points; see `from_function` for how functions are read."""
    if isinstance(source, Field):
        return source
    if callable(source):
        from tpmscad.fields.function import from_function

        return from_function(source)
    return _algebra().constant(source)


def is_grid(x: Array, y: Array, z: Array) -> bool:
    """Whether the coordinates are those of a grid, of shapes (nx, 1, 1), (1, ny, 1) and (1, 1, nz)."""
    return x.ndim == 3 and x.shape[1:] == (1, 1) and y.shape[::2] == (1, 1) and z.shape[:2] == (1, 1)


def stacked(x: Array, y: Array, z: Array) -> tuple[Array, tuple[int, ...]]:
    """The points (n, 3) of coordinates that broadcast, and the shape they broadcast to."""
    x, y, z = np.broadcast_arrays(x, y, z)
    return np.stack((x.ravel(), y.ravel(), z.ravel()), axis=-1), x.shape


def triple(value: Any, name: str) -> Triple:
    """Three finite numbers, or InvalidRequest."""
    try:
        numbers = np.asarray(value, float)
    except (TypeError, ValueError):
        numbers = np.empty(0)
    if numbers.shape != (3,) or not np.isfinite(numbers).all():
        raise InvalidRequest(f"{name} {value!r} must be three finite numbers (x, y, z)")
    return float(numbers[0]), float(numbers[1]), float(numbers[2])


def positive(value: Any, name: str) -> float:
    """One finite number above zero, or InvalidRequest."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = np.nan
    if not 0 < number < np.inf:
        raise InvalidRequest(f"{name} {value!r} must be a finite number above zero")
    return number


def _algebra() -> Any:
    from tpmscad.fields import algebra

    return algebra


def _booleans() -> Any:
    from tpmscad.fields import booleans

    return booleans


def _flat(points: ArrayLike) -> tuple[Array, tuple[int, ...]]:
    try:
        array = np.asarray(points, float)
    except (TypeError, ValueError) as error:
        raise InvalidRequest(f"points must be an array of numbers of shape (..., 3): {error}") from error
    if array.ndim == 0 or array.shape[-1] != 3:
        raise InvalidRequest(f"points of shape {array.shape}: the last axis must hold x, y and z, so (..., 3)")
    return array.reshape(-1, 3), array.shape[:-1]


def _columns(points: Array) -> tuple[Array, Array, Array]:
    """Contiguous copies: all that follows then runs through the same vector code, whatever the strides of the points."""
    return points[:, 0].copy(), points[:, 1].copy(), points[:, 2].copy()


def _parts(count: int) -> Iterator[slice]:
    return (slice(start, start + SLAB) for start in range(0, count, SLAB))


def _axes(x: ArrayLike, y: ArrayLike, z: ArrayLike) -> tuple[Array, Array, Array]:
    axes = np.ascontiguousarray(x, float), np.ascontiguousarray(y, float), np.ascontiguousarray(z, float)
    for name, axis in zip("xyz", axes, strict=True):
        if axis.ndim != 1:
            raise InvalidRequest(f"{name} of shape {axis.shape}: a grid is given by three one-dimensional arrays")
    return axes


def _slabs(axes: tuple[Array, Array, Array]) -> Iterator[tuple[slice, tuple[Array, Array, Array]]]:
    x, y, z = axes
    step = max(1, SLAB // max(1, len(y) * len(z)))
    for start in range(0, len(x), step):
        part = slice(start, start + step)
        yield part, (x[part, None, None], y[None, :, None], z[None, None, :])
