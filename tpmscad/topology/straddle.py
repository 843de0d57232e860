"""The classes alive at one level only, birth <= level < death: what a blending loop needs of persistence, for less.

The components of the solid (of the void) at the level are labelled first. If there is one (none beside the exterior), that is
all; otherwise only the other side of the level is searched for the saddles where the components meet.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from tpmscad.topology.grid import Array, Convention, Ints, Labels, compiled, connectivity, samples
from tpmscad.topology.merge import merges
from tpmscad.topology.persistence import Pairs, check_dimension, pairs_of, start
from tpmscad.topology.runs import Runs, extremes, runs


def straddling(values: ArrayLike, dimension: int, convention: Convention = "vertices", level: float = 0.0) -> Pairs:
    """The pairs of `persistence` with birth <= level < death: one for each component (dimension 0) or cavity (2) at the level."""
    field, level = samples(values), float(level)
    check_dimension(dimension)
    solid = dimension == 0
    count = connectivity(convention)[0 if solid else 1]
    found = runs(field, level, solid, count, exterior=not solid)
    if found.count <= (1 if solid else 0):
        lows = saddles = np.empty(0, np.int64)
    else:
        lows, saddles = _merges_above(field, found, level, dimension, count)
    pairs = pairs_of(field, dimension, lows, saddles)
    return pairs if found.count else pairs.straddling(level)


def _merges_above(field: Array, found: Runs, level: float, dimension: int, count: int) -> tuple[Ints, Ints]:
    solid = dimension == 0
    keys, basins = start(field, dimension)
    # -f < -level is the void: a voxel at the level is solid
    floor = level if solid else np.nextafter(-level, -np.inf)
    lowest = extremes(field, found, 1 if solid else -1)
    shape = keys.shape
    parts = np.unravel_index(np.maximum(lowest, 0), field.shape)
    roots = np.ravel_multi_index(tuple(part + 1 for part in parts), shape).astype(np.int32)
    if not solid:
        roots[0] = 0
    _seed(found.start, found.stop, found.row, found.label, roots, basins.reshape(-1), *shape)
    return merges(keys, basins, count, floor, found.count + (0 if solid else 1))


@compiled
def _seed(
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
