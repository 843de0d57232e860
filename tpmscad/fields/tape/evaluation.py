"""Evaluation of fields on points (..., 3), and on grids given by three axes, in batches that fit the processor's cache."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike

from tpmscad._typing import Array
from tpmscad.api.public_calls import read_value, translate_errors
from tpmscad.api.shared_kinds import GRID_AXIS, POINTS
from tpmscad.errors import InvalidRequest
from tpmscad.fields.tape.field_tape import FieldTape
from tpmscad.fields.tape.tape_nodes import Node

FieldJet = tuple[Array, Array, Array, Array]
"""Value, df/dx, df/dy and df/dz, which broadcast against each other."""

Triple = tuple[float, float, float]

MAX_POINTS_PER_SLAB = 1 << 16
"""Points evaluated at a time: half a megabyte per intermediate array, so that intermediates stay in the cache."""


def flatten_points(points: ArrayLike) -> tuple[Array, tuple[int, ...]]:
    """Points (..., 3) as an array (n, 3), and the shape (...); InvalidRequest for other shapes."""
    array = read_value("points", POINTS, points)
    if array.ndim == 0 or array.shape[-1] != 3:
        raise InvalidRequest(f"points of shape {array.shape}: the last axis must hold x, y and z, so (..., 3)")
    return array.reshape(-1, 3), array.shape[:-1]


def as_grid_axes(x: ArrayLike, y: ArrayLike, z: ArrayLike) -> tuple[Array, Array, Array]:
    """Axes of a grid as contiguous arrays; InvalidRequest if they are not one-dimensional."""
    a, b, c = (np.ascontiguousarray(read_value(n, GRID_AXIS, axis)) for n, axis in zip("xyz", (x, y, z), strict=True))
    axes = a, b, c
    for name, axis in zip("xyz", axes, strict=True):
        if axis.ndim != 1:
            raise InvalidRequest(f"{name} of shape {axis.shape}: a grid is given by three one-dimensional arrays")
    return axes


def grid_slabs(axes: tuple[Array, Array, Array]) -> Iterator[tuple[slice, tuple[Array, Array, Array]]]:
    """Slabs of x planes of a grid: the slice of each, and its axes."""
    x, y, z = axes
    step = max(1, MAX_POINTS_PER_SLAB // max(1, len(y) * len(z)))
    for start in range(0, len(x), step):
        part = slice(start, start + step)
        yield part, (x[part], y, z)


def broadcast_axes(axes: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
    """The axes of a grid as coordinates that broadcast."""
    x, y, z = axes
    return x[:, None, None], y[None, :, None], z[None, None, :]


def is_grid(x: Array, y: Array, z: Array) -> bool:
    """True if the coordinates are those of a grid, of shapes (nx, 1, 1), (1, ny, 1) and (1, 1, nz)."""
    return x.ndim == 3 and x.shape[1:] == (1, 1) and y.shape[::2] == (1, 1) and z.shape[:2] == (1, 1)


def stack_points(x: Array, y: Array, z: Array) -> tuple[Array, tuple[int, ...]]:
    """Points (n, 3) of coordinates that broadcast, and the shape they broadcast to."""
    x, y, z = np.broadcast_arrays(x, y, z)
    return np.stack((x.ravel(), y.ravel(), z.ravel()), axis=-1), x.shape


class FieldEvaluation:
    """Values and gradients on points and grids of a class that states its formula in `trace`, or implements `at` and `jet`."""

    __slots__ = ("_tape",)

    def trace(self, x: Node, y: Node, z: Node) -> Node:
        """The formula on the nodes of a tape; by default a call of `at` and `jet`."""
        return x.recorder.external(self, (x, y, z))

    def at(self, x: Array, y: Array, z: Array) -> Array:
        """Values at coordinates that broadcast against each other; the result may still have to be broadcast."""
        return self._run(x, y, z, False)[0]

    def jet(self, x: Array, y: Array, z: Array) -> FieldJet:
        """Value, df/dx, df/dy and df/dz at coordinates that broadcast; the value has the same bits as `at`."""
        value, gx, gy, gz = self._run(x, y, z, True)
        return value, gx, gy, gz

    def _run(self, x: Array, y: Array, z: Array, with_gradient: bool) -> Array:
        """Value, or value and derivatives, (m, ...) by the tape."""
        evaluator = self.tape.evaluator(with_gradient)
        if is_grid(x, y, z):
            return evaluator.on_grid((x.ravel(), y.ravel(), z.ravel()))
        shape = np.broadcast_shapes(x.shape, y.shape, z.shape)
        columns = np.empty((3, *shape))
        columns[0], columns[1], columns[2] = x, y, z
        return evaluator.at_points(columns.reshape(3, math.prod(shape))).reshape(4 if with_gradient else 1, *shape)

    @property
    def tape(self) -> FieldTape:
        """The field's tape, recorded when it is first needed."""
        tape: FieldTape | None = getattr(self, "_tape", None)
        if tape is None:
            tape = FieldTape(self)
            object.__setattr__(self, "_tape", tape)
        return tape

    def periods(self) -> Triple | None:
        """Return the periods along the axes.

        Lengths of the translations along x, y and z that leave the field unchanged, in model units; None if there are none.
        """
        return None

    @translate_errors
    def __call__(self, points: ArrayLike) -> Array:
        """Return values at points.

        Parameters
        ----------
        points : array_like, shape (..., 3)
            Points in model units.

        Returns
        -------
        ndarray, shape (...)
            Values, negative in the solid.
        """
        flat, shape = flatten_points(points)
        return self.tape.values_at(flat).reshape(shape)

    @translate_errors
    def gradient(self, points: ArrayLike) -> Array:
        """Return the exact gradient.

        Parameters
        ----------
        points : array_like, shape (..., 3)
            Points in model units.

        Returns
        -------
        ndarray, shape (..., 3)
            The gradient, which points out of the solid; on a crease of two surfaces, that of one of them.
        """
        return self.value_and_gradient(points)[1]

    @translate_errors
    def value_and_gradient(self, points: ArrayLike) -> tuple[Array, Array]:
        """Return values and gradient in one pass.

        Parameters
        ----------
        points : array_like, shape (..., 3)
            Points in model units.

        Returns
        -------
        values : ndarray, shape (...)
            Values, the same bits as those of the call.
        gradients : ndarray, shape (..., 3)
            Exact gradients.
        """
        flat, shape = flatten_points(points)
        values, gradients = self.tape.jets_at(flat)
        return values.reshape(shape), gradients.reshape(*shape, 3)

    @translate_errors
    def on_grid(self, x: ArrayLike, y: ArrayLike, z: ArrayLike) -> Array:
        """Return values on the grid of all x with all y with all z.

        Parameters
        ----------
        x, y, z : array_like, shapes (nx,), (ny,), (nz,)
            Coordinates of the grid planes, in model units.

        Returns
        -------
        ndarray, shape (nx, ny, nz)
            Values, the same bits as on the points of the grid, at a fraction of the cost.
        """
        axes = as_grid_axes(x, y, z)
        if (whole := self.tape.values_on_grid(axes)) is not None:
            return whole
        values = np.empty(tuple(len(axis) for axis in axes))
        for part, slab in grid_slabs(axes):
            values[part] = self.at(*broadcast_axes(slab))
        return values

    @translate_errors
    def value_and_gradient_on_grid(self, x: ArrayLike, y: ArrayLike, z: ArrayLike) -> tuple[Array, Array]:
        """Return values and gradient on the grid of all x with all y with all z.

        Parameters
        ----------
        x, y, z : array_like, shapes (nx,), (ny,), (nz,)
            Coordinates of the grid planes, in model units.

        Returns
        -------
        values : ndarray, shape (nx, ny, nz)
            Values.
        gradients : ndarray, shape (nx, ny, nz, 3)
            Exact gradients.
        """
        axes = as_grid_axes(x, y, z)
        values = np.empty(tuple(len(axis) for axis in axes))
        gradients = np.empty((*values.shape, 3))
        for part, slab in grid_slabs(axes):
            values[part], gradients[part, ..., 0], gradients[part, ..., 1], gradients[part, ..., 2] = self.jet(
                *broadcast_axes(slab)
            )
        return values, gradients
