"""The merge tree of a sampled function: which minima there are, and at which saddle each joins an older one.

Every voxel runs down to the lowest of its neighbours, and so to a minimum: the voxels of a minimum are its basin. Only voxels
where two basins meet can be saddles, and only those without a lower neighbour where the same two meet; they alone are sorted and
swept with a union-find structure in which the lower minimum survives (the elder rule). Of a smooth field that is one voxel in
twenty. Voxels of equal value are ordered by their index. Basins may be given beforehand for all voxels up to some value.

Keys are padded by one voxel all around, with +inf for nothing or -inf for an exterior, which is the voxel of index 0.
"""

from __future__ import annotations

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.topology.voxels import Labels, neighbour_offsets, njit_cached

UNASSIGNED = np.int32(-1)
"""A voxel whose basin is not known yet."""

NO_BASIN, SEVERAL_BASINS = np.int32(-1), np.int32(-2)
"""In place of the second basin that a voxel's lower neighbours are in."""


def pad_keys(values: Array, sign: int, around: float) -> Array:
    """sign * values with one voxel of `around` on every side."""
    keys = np.full(tuple(n + 2 for n in values.shape), around)
    np.multiply(values, float(sign), out=keys[1:-1, 1:-1, 1:-1])
    return keys


def compute_merges(keys: Array, basins: Labels, count: int, floor: float, roots: int) -> tuple[IntArray, IntArray]:
    """Minima and the saddles where they end, as flat indices into the padded arrays; equal keys are left out.

    basins: OPEN, or the minimum of the voxel's basin (0: the exterior); overwritten. Of minima born above `floor` nothing is
    recorded. roots: how many minima up to `floor` there are, or 0 if they are still to be counted.
    """
    near = neighbour_offsets(keys.shape, count)
    nx, ny, nz = keys.shape
    flat, basin = keys.reshape(-1), basins.reshape(-1)
    minima = _descend(flat, basin, near, nx, ny, nz)
    _resolve(basin, nx, ny, nz)
    other = np.full(flat.size, NO_BASIN)
    _find_second_basins(flat, basin, near, nx, ny, nz, floor if roots else -np.inf, other)
    candidates = np.empty(flat.size, np.int32)
    candidates = candidates[: _select_saddles(flat, basin, other, near, candidates)].copy()
    order = candidates[np.argsort(flat[candidates], kind="stable")]
    most = roots if roots else minima + 1
    births, deaths = np.empty(most, np.int64), np.empty(most, np.int64)
    found = _sweep(flat, basin, near, order, floor, most - 1 if roots else minima, births, deaths)
    return births[:found], deaths[:found]


@njit_cached
def _descend(key: Array, basin: Labels, near: IntArray, nx: int, ny: int, nz: int) -> int:
    """Point every open voxel at its lowest neighbour, minima at themselves; the number of minima."""
    minima = 0
    for i in range(1, nx - 1):
        for j in range(1, ny - 1):
            row = (i * ny + j) * nz
            for v in range(row + 1, row + nz - 1):
                if basin[v] >= 0:
                    continue
                best, low = v, key[v]
                for step in near:
                    u = v + step
                    k = key[u]
                    if k < low or (k == low and u < best):
                        best, low = u, k
                basin[v] = best
                if best == v:
                    minima += 1
    return minima


@njit_cached
def _resolve(basin: Labels, nx: int, ny: int, nz: int) -> None:
    """Point every voxel at the minimum it runs down to."""
    for i in range(1, nx - 1):
        for j in range(1, ny - 1):
            row = (i * ny + j) * nz
            for v in range(row + 1, row + nz - 1):
                root = basin[v]
                while basin[root] != root:
                    root = basin[root]
                w = v
                while basin[w] != root:
                    following = basin[w]
                    basin[w] = root
                    w = following


@njit_cached
def _find_second_basins(
    key: Array, basin: Labels, near: IntArray, nx: int, ny: int, nz: int, known: float, other: Labels
) -> None:
    """The other basin below each voxel above what is known: NONE, or SEVERAL."""
    for i in range(1, nx - 1):
        for j in range(1, ny - 1):
            row = (i * ny + j) * nz
            for v in range(row + 1, row + nz - 1):
                k = key[v]
                if k <= known:
                    continue
                own, second = basin[v], NO_BASIN
                for step in near:
                    u = v + step
                    b = basin[u]
                    if b != own and b != second and (key[u] < k or (key[u] == k and u < v)):
                        if second == NO_BASIN:
                            second = b
                        else:
                            second = SEVERAL_BASINS
                            break
                other[v] = second


@njit_cached
def _select_saddles(key: Array, basin: Labels, other: Labels, near: IntArray, out: Labels) -> int:
    """Voxels where basins meet, without those that have the same two basins as a lower neighbour; ascending; how many."""
    found = 0
    for v in range(len(key)):
        second = other[v]
        if second == NO_BASIN:
            continue
        new = True
        if second != SEVERAL_BASINS:
            k, own = key[v], basin[v]
            for step in near:
                u = v + step
                a, b = basin[u], other[u]
                if ((a == own and b == second) or (a == second and b == own)) and (
                    key[u] < k or (key[u] == k and u < v)
                ):
                    new = False
                    break
        if new:
            out[found] = v
            found += 1
    return found


@njit_cached
def _find(basin: Labels, v: int) -> int:
    while basin[v] != v:
        basin[v] = basin[basin[v]]
        v = basin[v]
    return v


@njit_cached
def _sweep(
    key: Array,
    basin: Labels,
    near: IntArray,
    order: Labels,
    floor: float,
    left: int,
    births: IntArray,
    deaths: IntArray,
) -> int:
    """Join the basins below each saddle in turn, the older surviving, until `left` joins of minima up to the floor are made."""
    found = 0
    for v in order:
        k = key[v]
        elder = _find(basin, v)
        for step in near:
            u = v + step
            if key[u] < k or (key[u] == k and u < v):
                younger = _find(basin, u)
                if younger == elder:
                    continue
                if key[younger] < key[elder] or (key[younger] == key[elder] and younger < elder):
                    younger, elder = elder, younger
                basin[younger] = elder
                if key[younger] <= floor:
                    if key[younger] < k:
                        births[found], deaths[found] = younger, v
                        found += 1
                    left -= 1
                    if left == 0:
                        return found
    return found
