"""Connected components of one phase, from its runs: maximal stretches of the phase along the last axis.

A run is joined with the runs of the rows before it that it touches. There are tens of times fewer runs than voxels, and finding
them is one pass of comparisons: 2.5 ms at 100^3, where scipy.ndimage.label takes 10 to 30.

The components of a sampled solid and the cavities in it, one by one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from tpmscad._typing import Array, IntArray
from tpmscad.topology.voxels import Convention, Labels, as_sample_array, connectivity, njit_cached


@dataclass(frozen=True, slots=True, eq=False)
class Runs:
    """start, stop (n,): flat indices of the runs of a phase; row (nx ny + 1,): first run of each row along z.

    label (n,): component of each run, from 1 in the order of first voxels; 0 for what touches the array's border, if that was
    asked for. count: the greatest label.
    """

    start: Labels
    stop: Labels
    row: Labels
    label: Labels
    count: int


def label_runs(field: Array, level: float, solid: bool, neighbours: int, exterior: bool) -> Runs:
    """The components of {f <= level} (solid) or {f > level}. exterior: whether the border of the array is one component, 0."""
    nx, ny, nz = field.shape
    flat, level = field.reshape(-1), float(level)
    row = np.zeros(nx * ny + 1, np.int32)
    _count_runs(flat, level, solid, nz, row)
    start, stop = np.empty(row[-1], np.int32), np.empty(row[-1], np.int32)
    _find_runs(flat, level, solid, nz, row, start, stop)
    label = np.empty(row[-1], np.int32)
    count = _unite_runs(start, stop, row, nx, ny, nz, neighbours == 26, exterior, label)
    return Runs(start, stop, row, label, count)


def count_voxels(found: Runs) -> IntArray:
    """Voxels of each component, (count + 1,)."""
    return np.bincount(found.label, found.stop - found.start, found.count + 1).astype(np.int64)


def find_extreme_voxels(field: Array, found: Runs, sign: int) -> IntArray:
    """The voxel of each component with the least sign * f, the first of several: flat indices (count + 1,), -1 for none."""
    best = np.full(found.count + 1, -1, np.int64)
    _scan_extremes(field.reshape(-1), sign, found.start, found.stop, found.label, best)
    return best


def paint_labels(found: Runs, shape: tuple[int, ...]) -> Labels:
    """The labels of the runs as a volume, 0 outside the phase."""
    volume = np.zeros(shape, np.int32)
    _fill_labels(found.start, found.stop, found.label, volume.reshape(-1))
    return volume


@njit_cached
def _count_runs(flat: Array, level: float, solid: bool, nz: int, row: Labels) -> None:
    for r in range(len(row) - 1):
        starts = 0
        before = False
        for v in range(r * nz, (r + 1) * nz):
            inside = (flat[v] <= level) == solid
            starts += inside and not before
            before = inside
        row[r + 1] = row[r] + starts


@njit_cached
def _find_runs(flat: Array, level: float, solid: bool, nz: int, row: Labels, start: Labels, stop: Labels) -> None:
    for r in range(len(row) - 1):
        n = row[r]
        before = False
        for v in range(r * nz, (r + 1) * nz):
            inside = (flat[v] <= level) == solid
            if inside != before:
                if inside:
                    start[n] = v
                else:
                    stop[n] = v
                    n += 1
                before = inside
        if before:
            stop[n] = (r + 1) * nz


@njit_cached
def _find_root(parent: Labels, a: int) -> int:
    while parent[a] != a:
        parent[a] = parent[parent[a]]
        a = parent[a]
    return a


@njit_cached
def _join_rows(
    parent: Labels, start: Labels, stop: Labels, row: Labels, here: int, there: int, nz: int, reach: int
) -> None:
    """Join the runs of two rows that overlap, or, with reach 1, touch across an edge."""
    shift = (here - there) * nz
    a, b = row[here], row[there]
    while a < row[here + 1] and b < row[there + 1]:
        if start[a] < stop[b] + shift + reach and start[b] + shift < stop[a] + reach:
            first, second = _find_root(parent, a + 1), _find_root(parent, b + 1)
            parent[max(first, second)] = min(first, second)
        if stop[a] < stop[b] + shift:
            a += 1
        else:
            b += 1


@njit_cached
def _unite_runs(
    start: Labels, stop: Labels, row: Labels, nx: int, ny: int, nz: int, corners: bool, exterior: bool, label: Labels
) -> int:
    parent = np.arange(len(start) + 1).astype(np.int32)
    for i in range(nx):
        for j in range(ny):
            r = i * ny + j
            if exterior:
                edge = i == 0 or j == 0 or i == nx - 1 or j == ny - 1
                for a in range(row[r], row[r + 1]):
                    if edge or start[a] == r * nz or stop[a] == (r + 1) * nz:
                        parent[_find_root(parent, a + 1)] = 0
            reach = 1 if corners else 0
            if j > 0:
                _join_rows(parent, start, stop, row, r, r - 1, nz, reach)
            if i > 0:
                _join_rows(parent, start, stop, row, r, r - ny, nz, reach)
                if corners and j > 0:
                    _join_rows(parent, start, stop, row, r, r - ny - 1, nz, 1)
                if corners and j < ny - 1:
                    _join_rows(parent, start, stop, row, r, r - ny + 1, nz, 1)
    number = np.zeros(len(parent), np.int32)
    count = 0
    for a in range(len(start)):
        root = _find_root(parent, a + 1)
        if root != 0 and number[root] == 0:
            count += 1
            number[root] = count
        label[a] = number[root]
    return count


@njit_cached
def _scan_extremes(flat: Array, sign: int, start: Labels, stop: Labels, label: Labels, best: IntArray) -> None:
    for a in range(len(start)):
        n = label[a]
        w = best[n]
        low = np.inf if w < 0 else sign * flat[w]
        for v in range(start[a], stop[a]):
            if sign * flat[v] < low:
                w, low = v, sign * flat[v]
        best[n] = w


@njit_cached
def _fill_labels(start: Labels, stop: Labels, label: Labels, flat: Labels) -> None:
    for a in range(len(start)):
        for v in range(start[a], stop[a]):
            flat[v] = label[a]


@dataclass(frozen=True, slots=True, eq=False)
class LabelledComponents:
    """Pieces numbered from 1: `labels` (nx, ny, nz), 0 elsewhere; of piece k, `sizes[k - 1]` voxels and, as the flat index
    (C order) of a voxel, `deepest[k - 1]`, where f is farthest from the level: lowest in a component, highest in a cavity.
    """

    labels: Labels
    sizes: IntArray
    deepest: IntArray

    def __len__(self) -> int:
        return len(self.sizes)

    def deepest_voxels(self) -> IntArray:
        """The deepest voxels as (n, 3) indices."""
        return np.stack(np.unravel_index(self.deepest, self.labels.shape), axis=-1).astype(np.int64)


def label_components(values: ArrayLike, level: float = 0.0, convention: Convention = "strict") -> LabelledComponents:
    """The components of {f <= level}."""
    return _label_phase(values, level, connectivity(convention)[0], solid=True)


def label_cavities(values: ArrayLike, level: float = 0.0, convention: Convention = "strict") -> LabelledComponents:
    """The cavities of {f <= level}: components of the void that do not reach the border of the array."""
    return _label_phase(values, level, connectivity(convention)[1], solid=False)


def count_components_and_cavities(
    values: ArrayLike, level: float = 0.0, convention: Convention = "strict"
) -> tuple[int, int]:
    """n0 and n2 as porous blending counts them (Table 1): the components, one of which is the structure, and the cavities.

    With the default convention (1, 0) is a certificate for the trilinear interpolant of the samples.
    """
    field = as_sample_array(values)
    solid, void = connectivity(convention)
    return (
        label_runs(field, level, True, solid, exterior=False).count,
        label_runs(field, level, False, void, exterior=True).count,
    )


def _label_phase(values: ArrayLike, level: float, neighbours: int, solid: bool) -> LabelledComponents:
    field = as_sample_array(values)
    found = label_runs(field, level, solid, neighbours, exterior=not solid)
    deepest = find_extreme_voxels(field, found, 1 if solid else -1)
    return LabelledComponents(paint_labels(found, field.shape), count_voxels(found)[1:], deepest[1:])
