"""Persistent homology of a sampled field in dimensions 0 and 2: components and cavities of {f <= c} as c rises.

The components form the merge tree of f. By Alexander duality the cavities form the merge tree of -f with the exterior as an
additional, oldest component. The pairs equal those of gudhi's cubical complexes under either convention (see `voxels`), and so do
their locations if no two samples have the same value. Pairs of equal birth and death are omitted, as in gudhi.

`compute_pairs_at_level` computes only the classes alive at one level, birth <= level < death, which is all that the objective of
porous blending needs. It labels the components of the solid (or of the void) at the level first. If there is one (or none besides
the exterior) no saddle is needed; otherwise only the other side of the level is swept for the saddles that join the components.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.api.public_calls import validate_call
from tpmscad.api.shared_arguments import Level, SampleConnectivity, Samples
from tpmscad.api.shared_kinds import WHOLE_NUMBER
from tpmscad.errors import InvalidRequest
from tpmscad.topology.components import EXTERIOR, find_deepest_samples, label_phase
from tpmscad.topology.merge_tree import UNASSIGNED, compute_merges, pad_keys
from tpmscad.topology.voxels import CONNECTIVITY, Labels, as_sample_array

SweepDimension = Annotated[int, WHOLE_NUMBER.described_as("0 or 2", "0"), "0 for components, 2 for cavities."]

NO_VOXEL = -1
"""Location of the death of a class that never dies."""


@dataclass(frozen=True, slots=True, eq=False)
class PersistencePairs:
    """Persistence pairs of one dimension by ascending birth.

    - `birth`, `death` (n,): values of f.
    - `birth_at`, `death_at` (n,): voxels of these values as flat indices in C order, `np.unravel_index(birth_at, shape)`;
      -1 where death is inf, which is the component of the whole array.
    """

    dimension: int
    birth: Array
    death: Array
    birth_at: IntArray
    death_at: IntArray
    shape: tuple[int, int, int]

    @classmethod
    def from_voxels(cls, field: Array, dimension: int, births: IntArray, deaths: IntArray) -> PersistencePairs:
        """Pairs from the voxels (n,) of their births and deaths; a death NO_VOXEL is at infinity."""
        flat = field.reshape(-1)
        birth, death = flat[births], np.where(deaths == NO_VOXEL, np.inf, flat[deaths])
        order = np.lexsort((deaths, births, death, birth))
        return cls(dimension, birth[order], death[order], births[order], deaths[order], field.shape)

    def __len__(self) -> int:
        return len(self.birth)

    def select(self, mask: BoolArray) -> PersistencePairs:
        """The pairs where the mask (n,) is True."""
        return PersistencePairs(
            self.dimension, self.birth[mask], self.death[mask], self.birth_at[mask], self.death_at[mask], self.shape
        )

    def alive_at(self, level: float = 0.0) -> PersistencePairs:
        """Return the classes that exist at one level.

        Parameters
        ----------
        level : float
            Value of the field.

        Returns
        -------
        PersistencePairs
            The pairs with birth <= level < death: the components or cavities of {f <= level}.
        """
        return self.select((self.birth <= level) & (level < self.death))


@validate_call()
def compute_persistence(
    values: Samples, dimension: SweepDimension, convention: SampleConnectivity = "vertices"
) -> PersistencePairs:
    """Compute the persistence pairs of samples in dimension 0 or 2 by a union-find sweep.

    Returns
    -------
    PersistencePairs
        The pairs by ascending birth.

    Examples
    --------
    >>> import numpy as np
    >>> from tpmscad import topology
    >>> values = np.ones((5, 5, 5))
    >>> values[1, 1, 1] = values[3, 3, 3] = -1.0
    >>> pairs = topology.compute_persistence(values, 0)
    >>> pairs.birth, pairs.death
    (array([-1., -1.]), array([ 1., inf]))
    """
    field = as_sample_array(values)
    check_dimension(dimension)
    keys, basins = initialise_sweep(field, dimension)
    basins[1:-1, 1:-1, 1:-1] = UNASSIGNED
    minima, saddles = compute_merges(keys, basins, CONNECTIVITY[convention][0 if dimension == 0 else 1], np.inf, 0)
    return assemble_pairs(field, dimension, minima, saddles)


def check_dimension(dimension: int) -> None:
    """Raise InvalidRequest unless the sweeps compute the dimension."""
    if dimension not in (0, 2):
        raise InvalidRequest(
            f"dimension {dimension}: the sweeps compute components (0) and cavities (2); persistence_diagram computes tunnels (1)"
        )


def initialise_sweep(field: Array, dimension: int) -> tuple[Array, Labels]:
    """Padded keys in the order of the sweep, and padded basins that all belong to the exterior."""
    keys = pad_keys(field, 1, np.inf) if dimension == 0 else pad_keys(field, -1, -np.inf)
    return keys, np.zeros(keys.shape, np.int32)


def assemble_pairs(field: Array, dimension: int, minima: IntArray, saddles: IntArray) -> PersistencePairs:
    """Pairs from the minima and saddles of the padded keys, with the component that never dies in dimension 0."""
    shape = field.shape
    minima, saddles = _unpad_indices(minima, shape), _unpad_indices(saddles, shape)
    if dimension == 0:
        births, deaths = np.append(minima, np.argmin(field)), np.append(saddles, NO_VOXEL)
    else:
        births, deaths = saddles, minima
    return PersistencePairs.from_voxels(field, dimension, births, deaths)


def _unpad_indices(flat: IntArray, shape: tuple[int, ...]) -> IntArray:
    """Indices of the padded array as indices of the array itself."""
    parts = np.unravel_index(flat, tuple(n + 2 for n in shape))
    return np.ravel_multi_index(tuple(part - 1 for part in parts), shape).astype(np.int64)


@validate_call()
def compute_pairs_at_level(
    values: Samples,
    dimension: SweepDimension,
    convention: SampleConnectivity = "vertices",
    level: Level = 0.0,
) -> PersistencePairs:
    """Compute the persistence pairs that are alive at one level: one for each component or cavity.

    Returns
    -------
    PersistencePairs
        The same as `compute_persistence(...).alive_at(level)`, for less work.

    Examples
    --------
    >>> import numpy as np
    >>> from tpmscad import topology
    >>> values = np.ones((5, 5, 5))
    >>> values[1, 1, 1] = values[3, 3, 3] = -1.0
    >>> topology.compute_pairs_at_level(values, 0).death
    array([ 1., inf])
    """
    field, level = as_sample_array(values), float(level)
    check_dimension(dimension)
    solid = dimension == 0
    labels, count = label_phase(field, level, convention, solid)
    if count <= 1:  # the void has its exterior
        minima = saddles = np.empty(0, np.int64)
    else:
        minima, saddles = _merges_beyond_level(field, labels, count, level, dimension, convention)
    pairs = assemble_pairs(field, dimension, minima, saddles)
    return pairs if count > (0 if solid else 1) else pairs.alive_at(level)


def _merges_beyond_level(
    field: Array, labels: Labels, count: int, level: float, dimension: int, convention: str
) -> tuple[IntArray, IntArray]:
    """Minima of the labelled components and the saddles beyond the level at which they end, padded indices."""
    solid = dimension == 0
    keys, basins = initialise_sweep(field, dimension)
    # the void is -f < -level: a voxel at the level is solid
    recorded_below = level if solid else np.nextafter(-level, -np.inf)
    deepest = find_deepest_samples(field, labels, count, 1 if solid else -1)
    parts = np.unravel_index(np.maximum(deepest, 0), field.shape)
    roots = np.empty(count + 1, np.int32)
    roots[1:] = np.ravel_multi_index(tuple(part + 1 for part in parts), keys.shape)
    roots[0] = UNASSIGNED
    if not solid:
        roots[EXTERIOR] = 0
    basins[1:-1, 1:-1, 1:-1] = roots[labels]
    return compute_merges(keys, basins, CONNECTIVITY[convention][0 if solid else 1], recorded_below, count)
