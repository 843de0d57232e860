"""Gudhi's persistence of the same samples, by matrix reduction: the reference, which also has dimension 1.

Gudhi's flat indices are in Fortran order; used in C order they name other voxels, without any error. Births and deaths of
complexes built from vertices are voxels by `vertices_of_persistence_pairs`, of those built from cubes by
`cofaces_of_persistence_pairs`; the one on the other's complex is undefined behaviour.
"""

from __future__ import annotations

from typing import Any

import gudhi
import numpy as np
from numpy.typing import ArrayLike

from tpmscad._typing import Array, IntArray
from tpmscad.errors import InvalidRequest
from tpmscad.topology.persistence import NO_VOXEL, PersistencePairs
from tpmscad.topology.voxels import Convention, as_sample_array


def gudhi_pairs(values: ArrayLike, dimension: int, convention: Convention = "vertices") -> PersistencePairs:
    """Pairs of dimension 0, 1 or 2 by gudhi, as those of `persistence.persistence`."""
    field = as_sample_array(values)
    return pairs_in_dimension(build_cubical_complex(field, convention), field, dimension, convention)


def build_cubical_complex(field: Array, convention: Convention) -> Any:
    """Gudhi's complex of the samples, with its persistence computed: all dimensions at once."""
    if convention == "vertices":
        brep = gudhi.CubicalComplex(vertices=field)
    elif convention == "top_cells":
        brep = gudhi.CubicalComplex(top_dimensional_cells=field)
    else:
        raise InvalidRequest(f"convention {convention!r} is no cubical complex: choose vertices or top_cells")
    brep.compute_persistence()
    return brep


def pairs_in_dimension(brep: Any, field: Array, dimension: int, convention: Convention) -> PersistencePairs:
    """The pairs of one dimension read off a complex of `complex_of`."""
    vertices = convention == "vertices"
    finite, endless = brep.vertices_of_persistence_pairs() if vertices else brep.cofaces_of_persistence_pairs()
    pairs, alone = (
        _indices_in_dimension(finite, dimension).reshape(-1, 2),
        _indices_in_dimension(endless, dimension).reshape(-1),
    )
    births = _to_c_order(np.concatenate([pairs[:, 0], alone]), field.shape)
    deaths = _to_c_order(np.concatenate([pairs[:, 1], np.full(alone.size, NO_VOXEL)]), field.shape)
    flat = field.reshape(-1)
    birth, death = flat[births], np.where(deaths == NO_VOXEL, np.inf, flat[deaths])
    order = np.lexsort((deaths, births, death, birth))
    order = order[birth[order] < death[order]]
    return PersistencePairs(dimension, birth[order], death[order], births[order], deaths[order], field.shape)


def _indices_in_dimension(found: list[IntArray], dimension: int) -> IntArray:
    return np.asarray(found[dimension], np.int64) if dimension < len(found) else np.empty(0, np.int64)


def _to_c_order(flat: IntArray, shape: tuple[int, ...]) -> IntArray:
    parts = np.unravel_index(np.where(flat == NO_VOXEL, 0, flat), shape, order="F")
    return np.where(flat == NO_VOXEL, NO_VOXEL, np.ravel_multi_index(parts, shape)).astype(np.int64)
