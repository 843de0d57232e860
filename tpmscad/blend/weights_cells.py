"""The earlier weight by discrete reconstruction (Ozdemir et al., as described in the blending paper's section 1.1).

Every unit cell of the domain takes 0 or 1, the side of its centre; each corner of a cell takes the mean of the cells around it;
within a cell the weight is trilinear.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from tpmscad.blend.grid import Array, Box, Field, lattice
from tpmscad.errors import InvalidRequest


@dataclass(frozen=True, slots=True, eq=False)
class CellWeight:
    """The trilinear interpolant of values (a, b, c) at the corners of cells that start at `low` and have edges `edge`."""

    low: Array
    edge: Array
    corners: Array

    def __call__(self, points: ArrayLike) -> Array:
        return np.clip(self._combined(np.asarray(points, float), None), 0.0, 1.0)

    def gradient(self, points: ArrayLike) -> Array:
        """The gradient within the cells; it jumps from cell to cell."""
        points = np.asarray(points, float)
        return np.stack([self._combined(points, axis) for axis in range(3)], axis=-1)

    def on_grid(self, x: Array, y: Array, z: Array) -> Array:
        return self(lattice((x, y, z)))

    def _combined(self, points: Array, by: int | None) -> Array:
        last = np.array(self.corners.shape) - 2
        place = np.clip((points - self.low) / self.edge, 0.0, last + 1.0)
        cell = np.minimum(place.astype(np.int64), last)
        part = place - cell
        total = np.zeros(points.shape[:-1])
        for corner in np.ndindex(2, 2, 2):
            share = np.ones(points.shape[:-1])
            for axis, side in enumerate(corner):
                if axis == by:
                    share = share * ((1.0 if side else -1.0) / self.edge[axis])
                else:
                    share = share * (part[..., axis] if side else 1.0 - part[..., axis])
            total += share * self.corners[tuple(np.moveaxis(cell + np.array(corner), -1, 0))]
        return total


def cell_weight(first: Field, domain: Box, cell: float) -> CellWeight:
    """The weight of cells of about the given edge (a whole number of them fills the domain): 0 in `first`, else 1."""
    low, high = np.array(domain[0]), np.array(domain[1])
    if not cell > 0:
        raise InvalidRequest(f"cell {cell:g}: the edge of the cells of discrete reconstruction must be positive")
    count = np.maximum(np.rint((high - low) / cell).astype(int), 1)
    edge = (high - low) / count
    x, y, z = (a + e * (np.arange(n) + 0.5) for a, e, n in zip(low, edge, count, strict=True))
    corners = (np.asarray(first(lattice((x, y, z)))) > 0).astype(float)
    for axis in range(3):
        width = [(1, 1) if k == axis else (0, 0) for k in range(3)]
        padded = np.pad(corners, width, mode="edge")
        corners = (
            np.take(padded, range(padded.shape[axis] - 1), axis) + np.take(padded, range(1, padded.shape[axis]), axis)
        ) / 2
    return CellWeight(low, edge, corners)
