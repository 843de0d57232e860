"""The merge tree of a sampled function: its minima, and the saddle at which each basin merges with an older one.

Steepest descent assigns every voxel to a minimum; the voxels of one minimum are its basin. A saddle is a voxel where two basins
meet and that has no lower neighbour where the same two basins meet. Only these candidates, one voxel in twenty of a smooth field,
are sorted and swept with a union-find forest in which the lower minimum survives (elder rule). Voxels of equal value are ordered
by their index. Basins may be given beforehand for all voxels up to some value.

Keys are padded by one voxel on every side: with +inf for no neighbour, or with -inf for an exterior, whose minimum is voxel 0.
"""

from __future__ import annotations

import numpy as np

from tpmscad._compiled_loops import njit_cached
from tpmscad._typing import Array, IntArray
from tpmscad.topology.voxels import Labels, find_root, neighbour_offsets

UNASSIGNED = np.int32(-1)
"""Basin of a voxel that has not been assigned yet."""

NO_BASIN, SEVERAL_BASINS = np.int32(-1), np.int32(-2)
"""Markers for a voxel whose lower neighbours lie in no second basin, or in several."""


def pad_keys(values: Array, sign: int, around: float) -> Array:
    """Keys sign * values, padded by one voxel of value `around` on every side."""
    keys = np.full(tuple(n + 2 for n in values.shape), around)
    np.multiply(values, float(sign), out=keys[1:-1, 1:-1, 1:-1])
    return keys


def compute_merges(
    keys: Array, basins: Labels, neighbours: int, recorded_below: float, n_known_minima: int
) -> tuple[IntArray, IntArray]:
    """Minima and the saddles at which they merge, as flat indices of the padded arrays; pairs of equal keys are omitted.

    `basins`: UNASSIGNED, or the minimum of the voxel's basin (0: the exterior); overwritten. Minima above `recorded_below` are
    not recorded. `n_known_minima`: number of minima up to that value, or 0 if it is unknown. `neighbours`: 6 or 26.
    """
    offsets = neighbour_offsets(keys.shape, neighbours)
    nx, ny, nz = keys.shape
    flat, basin = keys.reshape(-1), basins.reshape(-1)
    minima = _descend(flat, basin, offsets, nx, ny, nz)
    _resolve(basin, nx, ny, nz)
    other = np.full(flat.size, NO_BASIN)
    _find_second_basins(flat, basin, offsets, nx, ny, nz, recorded_below if n_known_minima else -np.inf, other)
    candidates = np.empty(flat.size, np.int32)
    candidates = candidates[: _select_saddles(flat, basin, other, offsets, candidates)].copy()
    order = candidates[np.argsort(flat[candidates], kind="stable")]
    capacity = n_known_minima if n_known_minima else minima + 1
    births, deaths = np.empty(capacity, np.int64), np.empty(capacity, np.int64)
    remaining = capacity - 1 if n_known_minima else minima
    n_pairs = _sweep(flat, basin, offsets, order, recorded_below, remaining, births, deaths)
    return births[:n_pairs], deaths[:n_pairs]


@njit_cached
def _descend(key: Array, basin: Labels, offsets: IntArray, nx: int, ny: int, nz: int) -> int:
    """Assign every unassigned voxel to its lowest neighbour, minima to themselves; the number of minima."""
    minima = 0
    for i in range(1, nx - 1):
        for j in range(1, ny - 1):
            row = (i * ny + j) * nz
            for v in range(row + 1, row + nz - 1):
                if basin[v] >= 0:
                    continue
                best, low = v, key[v]
                for step in offsets:
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
    """Assign every voxel to the minimum at the end of its descent, with path compression."""
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
    key: Array, basin: Labels, offsets: IntArray, nx: int, ny: int, nz: int, known: float, other: Labels
) -> None:
    """Second basin among the lower neighbours of each voxel above `known`; NO_BASIN or SEVERAL_BASINS otherwise."""
    for i in range(1, nx - 1):
        for j in range(1, ny - 1):
            row = (i * ny + j) * nz
            for v in range(row + 1, row + nz - 1):
                k = key[v]
                if k <= known:
                    continue
                own, second = basin[v], NO_BASIN
                for step in offsets:
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
def _select_saddles(key: Array, basin: Labels, other: Labels, offsets: IntArray, out: Labels) -> int:
    """Write ascending indices of voxels where basins meet and no lower neighbour has the same two basins; their number."""
    found = 0
    for v in range(len(key)):
        second = other[v]
        if second == NO_BASIN:
            continue
        new = True
        if second != SEVERAL_BASINS:
            k, own = key[v], basin[v]
            for step in offsets:
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
def _sweep(
    key: Array,
    basin: Labels,
    offsets: IntArray,
    order: Labels,
    recorded_below: float,
    remaining: int,
    births: IntArray,
    deaths: IntArray,
) -> int:
    """Unite the basins below each saddle in turn, until `remaining` minima up to the recorded value have merged; the pairs."""
    n_pairs = 0
    for v in order:
        k = key[v]
        elder = find_root(basin, v)
        for step in offsets:
            u = v + step
            if key[u] < k or (key[u] == k and u < v):
                younger = find_root(basin, u)
                if younger == elder:
                    continue
                if key[younger] < key[elder] or (key[younger] == key[elder] and younger < elder):
                    younger, elder = elder, younger
                basin[younger] = elder
                if key[younger] <= recorded_below:
                    if key[younger] < k:
                        births[n_pairs], deaths[n_pairs] = younger, v
                        n_pairs += 1
                    remaining -= 1
                    if remaining == 0:
                        return n_pairs
    return n_pairs
