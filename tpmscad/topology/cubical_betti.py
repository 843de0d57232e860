"""Betti numbers of a sampled solid: components and cavities by labelling, tunnels from the Euler characteristic."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import ArrayLike

from tpmscad._typing import Array, BoolArray
from tpmscad.errors import InvalidRequest
from tpmscad.topology.components import count_components_and_cavities
from tpmscad.topology.voxels import Convention, as_sample_array


@dataclass(frozen=True, slots=True)
class Betti:
    """Components, tunnels, cavities of the cubical complex."""

    b0: int
    b1: int
    b2: int

    @property
    def euler(self) -> int:
        return self.b0 - self.b1 + self.b2


def betti(values: ArrayLike, level: float = 0.0, convention: Convention = "vertices") -> Betti:
    """Betti numbers of {f <= level} as the complex of "vertices" or of "top_cells"."""
    field = as_sample_array(values)
    euler = euler_characteristic(field, level, convention)
    b0, b2 = count_components_and_cavities(field, level, convention)
    return Betti(b0, b0 + b2 - euler, b2)


def euler_characteristic(values: ArrayLike, level: float = 0.0, convention: Convention = "vertices") -> int:
    """Vertices - edges + faces - cubes of that complex.

    It can't stand for the Betti numbers: a component too many and a tunnel too many cancel.
    """
    field = as_sample_array(values)
    if convention == "vertices":
        return _alternating_cell_sum(field <= level)
    if convention == "top_cells":
        # the solid closed cubes are what the complex of the void's vertices leaves of a box
        return _alternating_cell_sum(np.pad(field > level, 1, constant_values=True)) - 1
    raise InvalidRequest(f"convention {convention!r} is no cubical complex: choose vertices or top_cells")


def bound_component_counts(values: ArrayLike, level: float = 0.0) -> tuple[tuple[int, int], tuple[int, int]]:
    """Least and greatest number of components, and of cavities, that the samples allow their trilinear interpolant.

    Neighbours through faces only give the greatest numbers, through faces, edges and corners the least (see `grid.py`).
    """
    field: Array = as_sample_array(values)
    most_parts, most_holes = count_components_and_cavities(field, level, "strict")
    fewest_parts, _ = count_components_and_cavities(field, level, "top_cells")
    _, fewest_holes = count_components_and_cavities(field, level, "vertices")
    return (fewest_parts, most_parts), (fewest_holes, most_holes)


def _alternating_cell_sum(inside: BoolArray) -> int:
    """The alternating sum of the cells all of whose vertices are inside."""
    total = 0
    for steps in product((0, 1), repeat=3):
        cells = inside
        for axis, step in enumerate(steps):
            if step:
                low, high = np.moveaxis(cells, axis, 0)[:-1], np.moveaxis(cells, axis, 0)[1:]
                cells = np.moveaxis(low & high, 0, axis)
        total += (-1) ** sum(steps) * int(np.count_nonzero(cells))
    return total
