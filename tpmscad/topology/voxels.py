"""Sampled fields and how their voxels hang together.

A sample is a voxel; solid is {f <= level}. Voxels of one phase are neighbours through their 6 faces, or through all 26 of faces,
edges and corners; the void reaches the exterior from every voxel on the array's border. By convention:

* "vertices": samples are the vertices of a cubical complex and a cell enters with its last vertex, as in porous blending,
  section 2.3, and gudhi.CubicalComplex(vertices=...): solid 6, void 26.
* "top_cells": samples are the cubes and a face enters with its first cube, as in gudhi's top_dimensional_cells=...:
  solid 26, void 6.
* "strict": solid 6, void 6: no complex but a bound. Every component of {f <= 0} and of {f > 0} of the trilinear interpolant
  holds a sample, and 6-neighbours of one sign are joined along their edge, so the interpolant has no more components and no
  more cavities than are counted so. One component without cavities here is a certificate for it.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Literal

import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray

from tpmscad._typing import Array, IntArray
from tpmscad.errors import InvalidRequest

Labels = NDArray[np.int32]
Convention = Literal["vertices", "top_cells", "strict"]

CONNECTIVITY: Mapping[str, tuple[int, int]] = MappingProxyType(
    {"vertices": (6, 26), "top_cells": (26, 6), "strict": (6, 6)}
)
"""Neighbours of a solid and of a void voxel, by convention."""

njit_cached = numba.njit(cache=True)
"""Every loop is compiled on first use and kept on disk."""


def as_sample_array(values: ArrayLike) -> Array:
    """A field's samples (nx, ny, nz) as contiguous floats, or InvalidRequest."""
    # writeable, since numba compiles its loops again, for seconds, for arrays that are not
    array = np.require(values, float, ("C", "W"))
    if array.ndim != 3 or array.size == 0:
        raise InvalidRequest(
            f"samples of shape {np.shape(values)}: a three-dimensional array that is not empty is needed"
        )
    if not np.isfinite(array).all():
        first = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        raise InvalidRequest(f"the samples hold {array[first]} at voxel {first}: a field must be finite everywhere")
    return array


def connectivity(convention: str) -> tuple[int, int]:
    """Neighbours of a solid and of a void voxel, or InvalidRequest."""
    if convention not in CONNECTIVITY:
        raise InvalidRequest(f"convention {convention!r}: choose one of {', '.join(CONNECTIVITY)}")
    return CONNECTIVITY[convention]


def neighbour_offsets(shape: tuple[int, ...], count: int) -> IntArray:
    """Offsets of the flat (C order) index to the 6 or 26 neighbours, ascending."""
    steps: Any = np.indices((3, 3, 3)).reshape(3, -1).T - 1
    near = np.abs(steps).sum(axis=1)
    steps = steps[(near > 0) & (near <= (1 if count == 6 else 3))]
    return np.sort(steps @ np.array([shape[1] * shape[2], shape[2], 1])).astype(np.int64)
