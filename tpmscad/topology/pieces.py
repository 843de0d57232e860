"""The components of a sampled solid and the cavities in it, one by one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from tpmscad.topology.grid import Convention, Ints, Labels, connectivity, samples
from tpmscad.topology.runs import extremes, painted, runs, sizes


@dataclass(frozen=True, slots=True, eq=False)
class Pieces:
    """Pieces numbered from 1: `labels` (nx, ny, nz), 0 elsewhere; of piece k, `sizes[k - 1]` voxels and, as the flat index
    (C order) of a voxel, `deepest[k - 1]`, where f is farthest from the level: lowest in a component, highest in a cavity.
    """

    labels: Labels
    sizes: Ints
    deepest: Ints

    def __len__(self) -> int:
        return len(self.sizes)

    def voxels(self) -> Ints:
        """The deepest voxels as (n, 3) indices."""
        return np.stack(np.unravel_index(self.deepest, self.labels.shape), axis=-1).astype(np.int64)


def components(values: ArrayLike, level: float = 0.0, convention: Convention = "strict") -> Pieces:
    """The components of {f <= level}."""
    return _pieces(values, level, connectivity(convention)[0], solid=True)


def cavities(values: ArrayLike, level: float = 0.0, convention: Convention = "strict") -> Pieces:
    """The cavities of {f <= level}: components of the void that do not reach the border of the array."""
    return _pieces(values, level, connectivity(convention)[1], solid=False)


def isolated(values: ArrayLike, level: float = 0.0, convention: Convention = "strict") -> tuple[int, int]:
    """n0 and n2 as porous blending counts them (Table 1): the components, one of which is the structure, and the cavities.

    With the default convention (1, 0) is a certificate for the trilinear interpolant of the samples.
    """
    field = samples(values)
    solid, void = connectivity(convention)
    return (
        runs(field, level, True, solid, exterior=False).count,
        runs(field, level, False, void, exterior=True).count,
    )


def _pieces(values: ArrayLike, level: float, neighbours: int, solid: bool) -> Pieces:
    field = samples(values)
    found = runs(field, level, solid, neighbours, exterior=not solid)
    deepest = extremes(field, found, 1 if solid else -1)
    return Pieces(painted(found, field.shape), sizes(found)[1:], deepest[1:])
