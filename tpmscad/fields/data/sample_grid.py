"""Uniform sampling grids in a box, ends included, and fields sampled on them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from tpmscad._typing import Array
from tpmscad.errors import InvalidRequest
from tpmscad.memory_limit import require_memory

FieldFunction = Callable[[Array], Array]
"""Any function of points (..., 3) -> (...), a Field among others."""

BoxBounds = tuple[tuple[float, float, float], tuple[float, float, float]]
"""Corners ((x0, y0, z0), (x1, y1, z1)) of a box."""

BYTES_PER_SAMPLE = 16
"""Of one field on a grid: its values, and an array to compare them with."""

POINTS_PER_SLAB = 1 << 18
"""Points per call of a function without `on_grid`: enough to hide the overhead of a call, few enough for the cache."""


@dataclass(frozen=True)
class SampleGrid:
    """A box [low, high] in model units and the numbers of samples along x, y and z, at least 2 each."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]
    shape: tuple[int, int, int]

    def __post_init__(self) -> None:
        if not all(a < b for a, b in zip(self.low, self.high, strict=True)):
            raise InvalidRequest(f"the domain from {self.low} to {self.high} is empty: each low must be below its high")
        if min(self.shape) < 2:
            raise InvalidRequest(f"resolution {self.shape}: at least 2 samples along each axis are needed")
        require_memory(
            float(np.prod(self.shape, dtype=float)),
            BYTES_PER_SAMPLE,
            f"a grid of {self.shape} samples",
            "use a coarser resolution or a smaller domain",
        )

    @cached_property
    def axes(self) -> tuple[Array, Array, Array]:
        """Coordinates of the grid planes along x, y and z."""
        x, y, z = (np.linspace(a, b, n) for a, b, n in zip(self.low, self.high, self.shape, strict=True))
        return x, y, z

    @property
    def spacing(self) -> Array:
        """Distances of neighbouring samples: (3,)."""
        return (np.array(self.high) - self.low) / (np.array(self.shape) - 1)

    @property
    def extent(self) -> Array:
        """Edges of the box: (3,)."""
        return np.array(self.high) - self.low

    @property
    def size(self) -> int:
        """Number of samples."""
        return int(np.prod(self.shape))

    def double_samples(self) -> SampleGrid:
        """Grid with twice the samples along each axis, not 2 n - 1: none of its inner samples is one of this grid."""
        nx, ny, nz = self.shape
        return SampleGrid(self.low, self.high, (2 * nx, 2 * ny, 2 * nz))

    def points(self, index: ArrayLike | None = None) -> Array:
        """All points (nx, ny, nz, 3), or the points (n, 3) of flat indices (n,) in C order."""
        if index is None:
            return grid_points(self.axes)
        parts = np.unravel_index(np.asarray(index), self.shape)
        return np.stack([axis[part] for axis, part in zip(self.axes, parts, strict=True)], axis=-1)


def grid_points(axes: tuple[Array, Array, Array]) -> Array:
    """Points of all x with all y with all z: (nx, ny, nz, 3)."""
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)


def sample_field(field: FieldFunction, grid: SampleGrid, name: str = "the field") -> Array:
    """Values of a field on the grid (nx, ny, nz), by its method `on_grid(x, y, z)` if it has one.

    InvalidRequest if the field does not take points (..., 3) or returns a value that is not finite.
    """
    on_grid = getattr(field, "on_grid", None)
    if on_grid is not None:
        values = np.asarray(on_grid(*grid.axes), float)
    else:
        values = np.empty(grid.shape)
        step = max(1, POINTS_PER_SLAB // (grid.shape[1] * grid.shape[2]))
        y, z = grid.axes[1:]
        for start in range(0, grid.shape[0], step):
            x = grid.axes[0][start : start + step]
            values[start : start + step] = call_field(field, grid_points((x, y, z)), name)
    if values.shape != grid.shape:
        raise InvalidRequest(f"{name} gave values of shape {values.shape} on a grid of {grid.shape}")
    if not np.isfinite(values).all():
        first = grid.points(int(np.flatnonzero(~np.isfinite(values))[0]))
        where = ", ".join(f"{c:g}" for c in np.ravel(first))
        count = int((~np.isfinite(values)).sum())
        raise InvalidRequest(f"{name} is not finite at {count} of {values.size} samples, first at ({where})")
    return values


def call_field(field: FieldFunction, points: Array, name: str) -> Array:
    """field(points); InvalidRequest with the remedy if it cannot be called with an array of points or gives another shape."""
    try:
        values = np.asarray(field(points), float)
    except (TypeError, ValueError, IndexError) as error:
        raise InvalidRequest(
            f"{name} can't be called with points of shape {points.shape} ({error}): it must take an array (..., 3) and "
            "return (...); wrap it with fields.from_function or numpy.vectorize"
        ) from error
    if values.shape != points.shape[:-1]:
        raise InvalidRequest(
            f"{name} gave shape {values.shape} for points of shape {points.shape}, not {points.shape[:-1]}: it must be "
            "vectorised; wrap it with fields.from_function or numpy.vectorize"
        )
    return values
