"""Persistent homology of a sampled field in dimensions 0 and 2: components and cavities of {f <= c} as c rises.

Components are the merge tree of f; cavities, by Alexander duality, that of -f with the exterior as one more, oldest, component.
The pairs equal those of gudhi's cubical complexes, built either way (see `grid.py` for the conventions); locations equal gudhi's
where no two samples have the same value. Pairs of equal birth and death are left out, as gudhi does.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from tpmscad.errors import InvalidRequest
from tpmscad.topology.grid import Array, Convention, Ints, Labels, connectivity, samples
from tpmscad.topology.merge import OPEN, merges, padded

NOWHERE = -1
"""Location of the death of a class that never dies."""


@dataclass(frozen=True, slots=True, eq=False)
class Pairs:
    """Classes of one dimension: values of f at birth and death (n,), and the voxels that cause them, by ascending birth.

    birth_at, death_at: flat indices in C order, `np.unravel_index(birth_at, shape)`; -1 where death is inf, the class of all
    that is solid, in dimension 0.
    """

    dimension: int
    birth: Array
    death: Array
    birth_at: Ints
    death_at: Ints
    shape: tuple[int, int, int]

    def __len__(self) -> int:
        return len(self.birth)

    def straddling(self, level: float = 0.0) -> Pairs:
        """The classes alive at a level, birth <= level < death: what {f <= level} has."""
        keep = (self.birth <= level) & (level < self.death)
        return Pairs(
            self.dimension, self.birth[keep], self.death[keep], self.birth_at[keep], self.death_at[keep], self.shape
        )


def persistence(values: ArrayLike, dimension: int, convention: Convention = "vertices") -> Pairs:
    """Pairs of a field's samples (nx, ny, nz) in dimension 0 or 2."""
    field = samples(values)
    solid, void = connectivity(convention)
    check_dimension(dimension)
    keys, basins = start(field, dimension)
    basins[1:-1, 1:-1, 1:-1] = OPEN
    lows, saddles = merges(keys, basins, solid if dimension == 0 else void, np.inf, 0)
    return pairs_of(field, dimension, lows, saddles)


def check_dimension(dimension: int) -> None:
    if dimension not in (0, 2):
        raise InvalidRequest(f"dimension {dimension}: components have dimension 0, cavities 2; loops are not computed")


def start(field: Array, dimension: int) -> tuple[Array, Labels]:
    """Keys that rise with the sweep, and basins all of the exterior, padded."""
    keys = padded(field, 1, np.inf) if dimension == 0 else padded(field, -1, -np.inf)
    return keys, np.zeros(keys.shape, np.int32)


def pairs_of(field: Array, dimension: int, lows: Ints, saddles: Ints) -> Pairs:
    """Pairs from the minima and saddles of the padded keys; with the class of all that is solid, in dimension 0."""
    shape = field.shape
    lows, saddles = _inner(lows, shape), _inner(saddles, shape)
    if dimension == 0:
        births, deaths = np.append(lows, np.argmin(field)), np.append(saddles, NOWHERE)
    else:
        births, deaths = saddles, lows
    flat = field.reshape(-1)
    birth, death = flat[births], np.where(deaths == NOWHERE, np.inf, flat[deaths])
    order = np.lexsort((deaths, births, death, birth))
    return Pairs(dimension, birth[order], death[order], births[order], deaths[order], shape)


def _inner(flat: Ints, shape: tuple[int, ...]) -> Ints:
    """Indices of the padded array as those of the array itself."""
    parts = np.unravel_index(flat, tuple(n + 2 for n in shape))
    return np.ravel_multi_index(tuple(part - 1 for part in parts), shape).astype(np.int64)
