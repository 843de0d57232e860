"""Protocols of the weight functions: what a blended field needs of a weight, and what the optimiser needs in addition."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, Self

from numpy.typing import ArrayLike
from scipy.sparse import csr_array

from tpmscad._typing import Array, BoolArray
from tpmscad.blending.weights.coordinates import Coordinate
from tpmscad.fields.tape.evaluation import FieldJet, stack_points
from tpmscad.fields.tape.tape_nodes import Node


class WeightFunction(Protocol):
    """A weight w(points (..., 3)) -> (...) in [0, 1], and its exact gradient (..., 3)."""

    def __call__(self, points: ArrayLike) -> Array:
        """Weights (...) at points (..., 3)."""
        ...

    def gradient(self, points: ArrayLike) -> Array:
        """Exact gradients (..., 3) at points (..., 3)."""
        ...

    def on_grid(self, x: Array, y: Array, z: Array) -> Array:
        """Values on the tensor-product grid of three axes: (nx, ny, nz)."""
        ...


class SplineWeight(WeightFunction, Protocol):
    """A weight that is linear in its B-spline coefficients; the optimiser changes the free ones within their bounds."""

    @property
    def coefficients(self) -> Array:
        """Spline coefficients, of the shape of `is_free`."""
        ...

    @property
    def is_free(self) -> BoolArray:
        """Mask of the free coefficients; the others are fixed at 0 or 1."""
        ...

    @property
    def lower_bounds(self) -> float | Array:
        """Lower bounds of the free coefficients."""
        ...

    @property
    def upper_bounds(self) -> float | Array:
        """Upper bounds of the free coefficients."""
        ...

    def apply_transpose(self, x: Array, y: Array, z: Array, values: Array) -> Array:
        """Adjoint of the map from coefficients to values on a grid, applied to values (nx, ny, nz)."""
        ...

    def design_matrix(self, points: Array) -> csr_array:
        """Values of all basis functions at points (m, 3): sparse (m, number of coefficients)."""
        ...

    def with_coefficients(self, coefficients: Array) -> Self:
        """The weight with other coefficients."""
        ...


@dataclass(frozen=True, slots=True)
class _ForeignInput:
    """A weight or a coordinate without a formula of nodes, as an input of the tapes that use it."""

    function: Coordinate

    def at(self, x: Array, y: Array, z: Array) -> Array:
        """Values at coordinates that broadcast."""
        points, shape = stack_points(x, y, z)
        return self.function(points).reshape(shape)

    def jet(self, x: Array, y: Array, z: Array) -> FieldJet:
        """Values and partial derivatives at coordinates that broadcast."""
        points, shape = stack_points(x, y, z)
        gx, gy, gz = (column.reshape(shape) for column in self.function.gradient(points).T)
        return self.function(points).reshape(shape), gx, gy, gz


def trace_function(function: Coordinate, point: Sequence[Node]) -> Node:
    """A weight or a coordinate on the nodes of a tape: by its method `trace` if it has one, otherwise as an input."""
    x, y, z = point
    formula = getattr(function, "trace", None)
    return x.recorder.external(_ForeignInput(function), (x, y, z)) if formula is None else formula(x, y, z)
