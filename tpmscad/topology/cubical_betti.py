"""Betti numbers of a sampled solid: components and cavities by labelling, tunnels from the Euler characteristic.

The Euler characteristic of a cubical complex is vertices - edges + faces - cubes, and b0 - b1 + b2 by the Euler-Poincare formula.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Annotated

import numpy as np

from tpmscad._typing import Array, BoolArray
from tpmscad.api.argument_kinds import choice_of
from tpmscad.api.public_calls import validate_call
from tpmscad.api.shared_arguments import Level, Samples
from tpmscad.topology.components import count_components_and_cavities
from tpmscad.topology.voxels import Convention, as_sample_array, check_complex

ComplexConvention = Annotated[
    Convention,
    choice_of("vertices", "top_cells", "strict"),
    "Cubical complex of the samples: as vertices, or as cubes.",
]


@dataclass(frozen=True, slots=True)
class Betti:
    """Betti numbers of a cubical complex: `b0` components, `b1` tunnels, `b2` cavities."""

    b0: int
    b1: int
    b2: int

    @property
    def euler(self) -> int:
        """Euler characteristic b0 - b1 + b2."""
        return self.b0 - self.b1 + self.b2


@validate_call()
def betti(values: Samples, level: Level = 0.0, convention: ComplexConvention = "vertices") -> Betti:
    """Compute the Betti numbers of the solid {f <= level}.

    Returns
    -------
    Betti
        Numbers of components, tunnels and cavities.

    Examples
    --------
    >>> import numpy as np
    >>> from tpmscad import topology
    >>> x, y, z = np.meshgrid(*[np.linspace(-1, 1, 33)] * 3, indexing="ij")
    >>> topology.betti(np.hypot(np.hypot(x, y) - 0.6, z) - 0.2)
    Betti(b0=1, b1=1, b2=0)
    """
    field = as_sample_array(values)
    euler = euler_characteristic(field, level, convention)
    b0, b2 = count_components_and_cavities(field, level, convention)
    return Betti(b0, b0 + b2 - euler, b2)


@validate_call()
def euler_characteristic(values: Samples, level: Level = 0.0, convention: ComplexConvention = "vertices") -> int:
    """Compute the Euler characteristic of the solid {f <= level}.

    Returns
    -------
    int
        Vertices - edges + faces - cubes of the complex.

    Notes
    -----
    It does not replace the Betti numbers: a superfluous component and a superfluous tunnel cancel.

    Examples
    --------
    >>> import numpy as np
    >>> from tpmscad import topology
    >>> values = np.ones((5, 5, 5))
    >>> values[1, 1, 1] = values[3, 3, 3] = -1.0
    >>> topology.euler_characteristic(values)
    2
    """
    field = as_sample_array(values)
    check_complex(convention)
    if convention == "vertices":
        return _alternating_cell_sum(field <= level)
    # Alexander duality: the closed solid cubes are the complement of the complex of the void's vertices in a box
    return _alternating_cell_sum(np.pad(field > level, 1, constant_values=True)) - 1


@validate_call()
def bound_component_counts(values: Samples, level: Level = 0.0) -> tuple[tuple[int, int], tuple[int, int]]:
    """Bound the numbers of components and cavities of the trilinear interpolant of the samples.

    Returns
    -------
    components, cavities : tuple of int
        Least and greatest number of each.

    Notes
    -----
    Connectivity across faces gives the upper bounds, connectivity across faces, edges and corners the lower ones.

    Examples
    --------
    >>> import numpy as np
    >>> from tpmscad import topology
    >>> values = np.ones((4, 4, 4))
    >>> values[1, 1, 1] = values[2, 2, 2] = -1.0  # two voxels that share a corner
    >>> topology.bound_component_counts(values)
    ((1, 2), (0, 0))
    """
    field: Array = as_sample_array(values)
    max_components, max_cavities = count_components_and_cavities(field, level, "strict")
    min_components, _ = count_components_and_cavities(field, level, "top_cells")
    _, min_cavities = count_components_and_cavities(field, level, "vertices")
    return (min_components, max_components), (min_cavities, max_cavities)


def _alternating_cell_sum(inside: BoolArray) -> int:
    """Alternating sum, by dimension, of the numbers of cells all of whose vertices are inside."""
    return sum_cells_of_block(np.pad(inside, (0, 1)))


def sum_cells_of_block(inside: BoolArray) -> int:
    """Alternating sum, by dimension, of the numbers of cells that begin in a block, all of whose vertices are inside.

    The last layer along each axis belongs to the next block. The sum is zero where all vertices are inside, and the sums
    of all blocks of a grid that ends with a layer outside add up to its Euler characteristic.
    """
    total = 0
    for steps in product((0, 1), repeat=3):
        cells = inside
        for axis, step in enumerate(steps):
            low, high = np.moveaxis(cells, axis, 0)[:-1], np.moveaxis(cells, axis, 0)[1:]
            cells = np.moveaxis(low & high if step else low, 0, axis)
        total += (-1) ** sum(steps) * int(np.count_nonzero(cells))
    return total
