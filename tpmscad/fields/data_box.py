"""The box of the samples that a field of data is made of, wherever it was moved."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from tpmscad._typing import Array, BoxCorners

POINTS_PER_SPACING = 2
"""Points along a side of the box for each spacing, at which the data are looked at there."""

ALIGNED, SAME = 1e-12, 1e-9
"""Of an edge: components along other axes, and differences of two boxes, that round-off explains."""


@dataclass(frozen=True, slots=True, eq=False)
class DataBox:
    """A box of samples: its corner, its edges, the rows of (3, 3), in any direction, and the spacings along each."""

    corner: Array
    edges: Array
    counts: tuple[int, ...]

    @classmethod
    def of_corners(cls, domain: BoxCorners, counts: tuple[int, ...]) -> DataBox:
        """The box along the axes between two corners."""
        low, high = (np.asarray(end, float) for end in domain)
        return cls(low, np.diag(high - low), counts)

    @property
    def domain(self) -> BoxCorners:
        """The least box along the axes that holds it, as two corners."""
        corners = self.corner + np.array(list(product((0.0, 1.0), repeat=3))) @ self.edges
        return tuple(corners.min(axis=0).tolist()), tuple(corners.max(axis=0).tolist())

    @property
    def is_aligned(self) -> bool:
        """Whether its edges run along the axes."""
        size = np.abs(self.edges)
        return bool((np.sort(size, axis=1)[:, 1] <= ALIGNED * size.max(axis=1)).all())

    @property
    def sides(self) -> list[tuple[Array, Array]]:
        """A point (3,) and the outward unit normal (3,) of each of the six sides."""
        found = []
        for axis in range(3):
            normal = np.cross(self.edges[axis - 2], self.edges[axis - 1])
            normal *= np.sign(normal @ self.edges[axis]) / np.linalg.norm(normal)
            found += [(self.corner, -normal), (self.corner + self.edges[axis], normal)]
        return found

    @property
    def border(self) -> Array:
        """Points (n, 3) on the sides, closer than the samples."""
        steps = [np.linspace(0.0, 1.0, POINTS_PER_SPACING * n + 1) for n in self.counts]
        parts = []
        for axis in range(3):
            ends = [np.array([0.0, 1.0]) if k == axis else steps[k] for k in range(3)]
            parts.append(np.stack(np.meshgrid(*ends, indexing="ij"), axis=-1).reshape(-1, 3))
        return self.corner + np.concatenate(parts) @ self.edges

    @property
    def least_step(self) -> float:
        """The least distance of neighbouring samples."""
        return float((np.linalg.norm(self.edges, axis=1) / self.counts).min())

    def is_same(self, other: DataBox) -> bool:
        """Whether another box is this one, up to round-off."""
        tol = SAME * float(np.abs(self.edges).max())
        return bool(np.abs(self.corner - other.corner).max() <= tol and np.abs(self.edges - other.edges).max() <= tol)

    def take_back(self, matrix: Array, shift: Array) -> DataBox:
        """The box of the points p with matrix p + shift in this one."""
        inverse = np.linalg.inv(matrix)
        return DataBox(inverse @ (self.corner - shift), self.edges @ inverse.T, self.counts)
