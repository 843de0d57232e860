"""Sampled fields and the connectivity of their voxels.

A sample is a voxel; the solid is {f <= level}. Voxels of one phase are neighbours across their 6 faces, or across all 26 faces,
edges and corners. Void voxels on the border of the array are connected to the exterior. Three conventions are in use:

* "vertices": samples are the vertices of a cubical complex and a cell enters with its last vertex, as in porous blending,
  section 2.3, and gudhi.CubicalComplex(vertices=...): solid 6, void 26.
* "top_cells": samples are the cubes and a face enters with its first cube, as in gudhi's top_dimensional_cells=...:
  solid 26, void 6.
* "strict": solid 6, void 6: not a complex but a bound. Every component of {f <= 0} and of {f > 0} of the trilinear interpolant
  contains a sample, and 6-neighbours of one sign are joined along their edge, so the interpolant has at most as many components
  and cavities as are counted. A count of one component without cavities is therefore a certificate for the interpolant.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tpmscad._compiled_loops import njit_cached
from tpmscad._typing import Array, IntArray
from tpmscad.api.public_calls import read_value
from tpmscad.api.shared_kinds import VALUES
from tpmscad.errors import InvalidRequest

Labels = NDArray[np.int32]
Convention = Literal["vertices", "top_cells", "strict"]

CONNECTIVITY: Mapping[str, tuple[int, int]] = MappingProxyType(
    {"vertices": (6, 26), "top_cells": (26, 6), "strict": (6, 6)}
)
"""Numbers of neighbours of a solid and of a void voxel, by convention."""


def as_sample_array(values: ArrayLike) -> Array:
    """Samples (nx, ny, nz) as a contiguous writeable float array; InvalidRequest if they are not finite or not 3-D."""
    # writeable: for a read-only array numba would compile every loop once more, which takes seconds
    return np.require(read_value("values", VALUES, values), float, ("C", "W"))


def check_complex(convention: str) -> None:
    """Raise InvalidRequest unless the convention defines a cubical complex."""
    if convention not in ("vertices", "top_cells"):
        raise InvalidRequest(f"convention {convention!r} defines no cubical complex: choose vertices or top_cells")


@njit_cached
def find_root(parent: Labels, element: int) -> int:
    """Root of an element of a union-find forest, by path halving."""
    while parent[element] != element:
        parent[element] = parent[parent[element]]
        element = parent[element]
    return element


def neighbour_offsets(shape: tuple[int, ...], count: int) -> IntArray:
    """Ascending offsets of the flat (C order) index to the 6 or 26 neighbours."""
    steps: Any = np.indices((3, 3, 3)).reshape(3, -1).T - 1
    near = np.abs(steps).sum(axis=1)
    steps = steps[(near > 0) & (near <= (1 if count == 6 else 3))]
    return np.sort(steps @ np.array([shape[1] * shape[2], shape[2], 1])).astype(np.int64)
