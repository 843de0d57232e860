"""Persistent homology of a sampled field in dimensions 0 and 2: components and cavities of {f <= c} as c rises.

Components are the merge tree of f; cavities, by Alexander duality, that of -f with the exterior as one more, oldest, component.
The pairs equal those of gudhi's cubical complexes, built either way (see `grid.py` for the conventions); locations equal gudhi's
where no two samples have the same value. Pairs of equal birth and death are left out, as gudhi does.

The classes alive at one level only, birth <= level < death: what a blending loop needs of persistence, for less.

The components of the solid (of the void) at the level are labelled first. If there is one (none beside the exterior), that is
all; otherwise only the other side of the level is searched for the saddles where the components meet.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from tpmscad._typing import Array, IntArray
from tpmscad.errors import InvalidRequest
from tpmscad.topology.components import Runs, find_extreme_voxels, label_runs
from tpmscad.topology.merge_tree import UNASSIGNED, compute_merges, pad_keys
from tpmscad.topology.voxels import Convention, Labels, as_sample_array, connectivity, njit_cached

NO_VOXEL = -1
"""Location of the death of a class that never dies."""


@dataclass(frozen=True, slots=True, eq=False)
class PersistencePairs:
    """Classes of one dimension: values of f at birth and death (n,), and the voxels that cause them, by ascending birth.

    birth_at, death_at: flat indices in C order, `np.unravel_index(birth_at, shape)`; -1 where death is inf, the class of all
    that is solid, in dimension 0.
    """

    dimension: int
    birth: Array
    death: Array
    birth_at: IntArray
    death_at: IntArray
    shape: tuple[int, int, int]

    def __len__(self) -> int:
        return len(self.birth)

    def straddling(self, level: float = 0.0) -> PersistencePairs:
        """The classes alive at a level, birth <= level < death: what {f <= level} has."""
        keep = (self.birth <= level) & (level < self.death)
        return PersistencePairs(
            self.dimension, self.birth[keep], self.death[keep], self.birth_at[keep], self.death_at[keep], self.shape
        )


def compute_persistence(values: ArrayLike, dimension: int, convention: Convention = "vertices") -> PersistencePairs:
    """Pairs of a field's samples (nx, ny, nz) in dimension 0 or 2."""
    field = as_sample_array(values)
    solid, void = connectivity(convention)
    check_dimension(dimension)
    keys, basins = initialise_sweep(field, dimension)
    basins[1:-1, 1:-1, 1:-1] = UNASSIGNED
    lows, saddles = compute_merges(keys, basins, solid if dimension == 0 else void, np.inf, 0)
    return assemble_pairs(field, dimension, lows, saddles)


def check_dimension(dimension: int) -> None:
    if dimension not in (0, 2):
        raise InvalidRequest(f"dimension {dimension}: components have dimension 0, cavities 2; loops are not computed")


def initialise_sweep(field: Array, dimension: int) -> tuple[Array, Labels]:
    """Keys that rise with the sweep, and basins all of the exterior, padded."""
    keys = pad_keys(field, 1, np.inf) if dimension == 0 else pad_keys(field, -1, -np.inf)
    return keys, np.zeros(keys.shape, np.int32)


def assemble_pairs(field: Array, dimension: int, lows: IntArray, saddles: IntArray) -> PersistencePairs:
    """Pairs from the minima and saddles of the padded keys; with the class of all that is solid, in dimension 0."""
    shape = field.shape
    lows, saddles = _unpad_indices(lows, shape), _unpad_indices(saddles, shape)
    if dimension == 0:
        births, deaths = np.append(lows, np.argmin(field)), np.append(saddles, NO_VOXEL)
    else:
        births, deaths = saddles, lows
    flat = field.reshape(-1)
    birth, death = flat[births], np.where(deaths == NO_VOXEL, np.inf, flat[deaths])
    order = np.lexsort((deaths, births, death, birth))
    return PersistencePairs(dimension, birth[order], death[order], births[order], deaths[order], shape)


def _unpad_indices(flat: IntArray, shape: tuple[int, ...]) -> IntArray:
    """Indices of the padded array as those of the array itself."""
    parts = np.unravel_index(flat, tuple(n + 2 for n in shape))
    return np.ravel_multi_index(tuple(part - 1 for part in parts), shape).astype(np.int64)


def compute_pairs_at_level(
    values: ArrayLike, dimension: int, convention: Convention = "vertices", level: float = 0.0
) -> PersistencePairs:
    """The pairs of `persistence` with birth <= level < death: one for each component (dimension 0) or cavity (2) at the level."""
    field, level = as_sample_array(values), float(level)
    check_dimension(dimension)
    solid = dimension == 0
    count = connectivity(convention)[0 if solid else 1]
    found = label_runs(field, level, solid, count, exterior=not solid)
    if found.count <= (1 if solid else 0):
        lows = saddles = np.empty(0, np.int64)
    else:
        lows, saddles = _merges_above(field, found, level, dimension, count)
    pairs = assemble_pairs(field, dimension, lows, saddles)
    return pairs if found.count else pairs.straddling(level)


def _merges_above(field: Array, found: Runs, level: float, dimension: int, count: int) -> tuple[IntArray, IntArray]:
    solid = dimension == 0
    keys, basins = initialise_sweep(field, dimension)
    # -f < -level is the void: a voxel at the level is solid
    floor = level if solid else np.nextafter(-level, -np.inf)
    lowest = find_extreme_voxels(field, found, 1 if solid else -1)
    shape = keys.shape
    parts = np.unravel_index(np.maximum(lowest, 0), field.shape)
    roots = np.ravel_multi_index(tuple(part + 1 for part in parts), shape).astype(np.int32)
    if not solid:
        roots[0] = 0
    _seed_basins(found.start, found.stop, found.row, found.label, roots, basins.reshape(-1), *shape)
    return compute_merges(keys, basins, count, floor, found.count + (0 if solid else 1))


@njit_cached
def _seed_basins(
    start: Labels, stop: Labels, row: Labels, label: Labels, roots: Labels, basin: Labels, nx: int, ny: int, nz: int
) -> None:
    """Give the voxels of each run the lowest voxel of their component, all other inner voxels -1; padded by one voxel."""
    for i in range(nx - 2):
        for j in range(ny - 2):
            r = i * (ny - 2) + j
            shift = ((i + 1) * ny + j + 1) * nz + 1 - r * (nz - 2)
            for v in range(r * (nz - 2), (r + 1) * (nz - 2)):
                basin[v + shift] = -1
            for a in range(row[r], row[r + 1]):
                for v in range(start[a], stop[a]):
                    basin[v + shift] = roots[label[a]]
