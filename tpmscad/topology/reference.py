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

from tpmscad.errors import InvalidRequest
from tpmscad.topology.grid import Array, Convention, Ints, samples
from tpmscad.topology.persistence import NOWHERE, Pairs


def persistence(values: ArrayLike, dimension: int, convention: Convention = "vertices") -> Pairs:
    """Pairs of dimension 0, 1 or 2 by gudhi, as those of `persistence.persistence`."""
    field = samples(values)
    return pairs_of(complex_of(field, convention), field, dimension, convention)


def complex_of(field: Array, convention: Convention) -> Any:
    """Gudhi's complex of the samples, with its persistence computed: all dimensions at once."""
    if convention == "vertices":
        complex = gudhi.CubicalComplex(vertices=field)
    elif convention == "top_cells":
        complex = gudhi.CubicalComplex(top_dimensional_cells=field)
    else:
        raise InvalidRequest(f"convention {convention!r} is no cubical complex: choose vertices or top_cells")
    complex.compute_persistence()
    return complex


def pairs_of(complex: Any, field: Array, dimension: int, convention: Convention) -> Pairs:
    """The pairs of one dimension read off a complex of `complex_of`."""
    vertices = convention == "vertices"
    finite, endless = complex.vertices_of_persistence_pairs() if vertices else complex.cofaces_of_persistence_pairs()
    pairs, alone = _of_dimension(finite, dimension).reshape(-1, 2), _of_dimension(endless, dimension).reshape(-1)
    births = _c_order(np.concatenate([pairs[:, 0], alone]), field.shape)
    deaths = _c_order(np.concatenate([pairs[:, 1], np.full(alone.size, NOWHERE)]), field.shape)
    flat = field.reshape(-1)
    birth, death = flat[births], np.where(deaths == NOWHERE, np.inf, flat[deaths])
    order = np.lexsort((deaths, births, death, birth))
    order = order[birth[order] < death[order]]
    return Pairs(dimension, birth[order], death[order], births[order], deaths[order], field.shape)


def _of_dimension(found: list[Ints], dimension: int) -> Ints:
    return np.asarray(found[dimension], np.int64) if dimension < len(found) else np.empty(0, np.int64)


def _c_order(flat: Ints, shape: tuple[int, ...]) -> Ints:
    parts = np.unravel_index(np.where(flat == NOWHERE, 0, flat), shape, order="F")
    return np.where(flat == NOWHERE, NOWHERE, np.ravel_multi_index(parts, shape)).astype(np.int64)
