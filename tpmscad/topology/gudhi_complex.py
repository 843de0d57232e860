"""Persistent homology of sampled fields by gudhi's cubical complexes, the only module that imports gudhi.

Gudhi reduces the boundary matrix and gives all dimensions at once. It computes the diagrams of `diagrams` and is the reference
for the union-find sweeps of `persistence`.

Gudhi's flat indices are in Fortran order; read in C order they name other voxels without an error. Births and deaths of complexes
built from vertices are located by `vertices_of_persistence_pairs`, those of complexes built from cubes by
`cofaces_of_persistence_pairs`; calling either on the other complex is undefined behaviour.
"""

from __future__ import annotations

from collections.abc import Sequence

import gudhi
import numpy as np
from numpy.typing import ArrayLike

from tpmscad._typing import IntArray
from tpmscad.topology.persistence import NO_VOXEL, PersistencePairs
from tpmscad.topology.voxels import Convention, as_sample_array, check_complex


def gudhi_diagram(
    values: ArrayLike, dimensions: Sequence[int], convention: Convention = "vertices"
) -> list[PersistencePairs]:
    """Pairs of each of the dimensions, 0, 1 or 2, in the form of `compute_persistence`."""
    field = as_sample_array(values)
    check_complex(convention)
    is_vertices = convention == "vertices"
    cubical_complex = gudhi.CubicalComplex(**{"vertices" if is_vertices else "top_dimensional_cells": field})
    cubical_complex.compute_persistence()
    finite, endless = (
        cubical_complex.vertices_of_persistence_pairs()
        if is_vertices
        else cubical_complex.cofaces_of_persistence_pairs()
    )
    diagram = []
    for dimension in dimensions:
        pairs = _indices_in_dimension(finite, dimension).reshape(-1, 2)
        unpaired = _indices_in_dimension(endless, dimension).reshape(-1)
        births = _to_c_order(np.concatenate([pairs[:, 0], unpaired]), field.shape)
        deaths = _to_c_order(np.concatenate([pairs[:, 1], np.full(unpaired.size, NO_VOXEL)]), field.shape)
        found = PersistencePairs.from_voxels(field, dimension, births, deaths)
        diagram.append(found.select(found.birth < found.death))
    return diagram


def gudhi_pairs(values: ArrayLike, dimension: int, convention: Convention = "vertices") -> PersistencePairs:
    """Pairs of one dimension, as `gudhi_diagram`."""
    return gudhi_diagram(values, (dimension,), convention)[0]


def _indices_in_dimension(found: list[IntArray], dimension: int) -> IntArray:
    return np.asarray(found[dimension], np.int64) if dimension < len(found) else np.empty(0, np.int64)


def _to_c_order(flat: IntArray, shape: tuple[int, ...]) -> IntArray:
    """Flat indices in Fortran order as indices in C order; NO_VOXEL stays."""
    parts = np.unravel_index(np.where(flat == NO_VOXEL, 0, flat), shape, order="F")
    return np.where(flat == NO_VOXEL, NO_VOXEL, np.ravel_multi_index(parts, shape)).astype(np.int64)
