"""What the optimiser asks of a weight; line and volume weights both answer."""

from __future__ import annotations

from typing import Protocol, Self

from numpy.typing import ArrayLike
from scipy.sparse import csr_array

from tpmscad._typing import Array, BoolArray


class SplineWeight(Protocol):
    """What the optimiser asks of a weight: line and volume weights both answer."""

    @property
    def coefficients(self) -> Array: ...

    @property
    def free(self) -> BoolArray: ...

    @property
    def low(self) -> float | Array: ...

    @property
    def high(self) -> float | Array: ...

    def __call__(self, points: ArrayLike) -> Array: ...

    def gradient(self, points: ArrayLike) -> Array: ...

    def on_grid(self, x: Array, y: Array, z: Array) -> Array: ...

    def adjoint(self, x: Array, y: Array, z: Array, values: Array) -> Array: ...

    def design(self, points: Array) -> csr_array: ...

    def moved(self, coefficients: Array) -> Self: ...
