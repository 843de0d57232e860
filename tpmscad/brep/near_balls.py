"""Pairs of balls that come near each other, whatever their sizes: the broad phase of searches among chords, cells and struts.

A search with the radius of the largest ball would pair every small one with all others around it. Balls are sorted by the octave
of their radius, and octaves are searched against each other; the pairs are counted before they are made.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from tpmscad._typing import Array, IntArray
from tpmscad.memory_limit import require_memory

BYTES_PER_PAIR = 100
"""Memory taken at the peak for each pair, with what is worked out for it."""

MAX_OCTAVES = 40
"""Radii below the greatest one by more count as one octave."""


def find_near_balls(
    center: Array, radius: Array, reach: float, what: str, remedy: str, others: tuple[Array, Array] | None = None
) -> tuple[IntArray, IntArray]:
    """Numbers (p,), (p,) of the balls (n, 3), (n,) nearer than `reach` to each other, or to `others`, (m, 3) and (m,).

    Of balls among themselves the first number of a pair is the lesser one. OutOfMemory, in the words `what` and `remedy`, if the
    pairs would not fit.
    """
    one = _sort_by_octaves(center, radius)
    other = one if others is None else _sort_by_octaves(*others)
    due, total = [], 0.0
    for a, (own, own_tree, own_radius) in enumerate(one):
        for met, met_tree, met_radius in other if others is not None else other[a:]:
            due.append((own, own_tree, met, met_tree, own_radius + met_radius + reach))
            count = float(own_tree.count_neighbors(met_tree, due[-1][-1]))
            total += count if own is not met else 0.5 * (count - len(own))
    require_memory(total, BYTES_PER_PAIR, f"{total:.3g} pairs of {what}", remedy)
    rows, columns = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
    radii = radius if others is None else others[1]
    for own, own_tree, met, met_tree, far in due:
        if own is met:
            i, j = own[own_tree.query_pairs(far, output_type="ndarray").T]
            apart = np.linalg.norm(center[i] - center[j], axis=1)
        else:
            found = own_tree.sparse_distance_matrix(met_tree, far, output_type="ndarray")
            i, j, apart = own[found["i"]], met[found["j"]], found["v"]
        near = apart <= radius[i] + radii[j] + reach
        i, j = i[near], j[near]
        rows.append(i if others is not None else np.minimum(i, j))
        columns.append(j if others is not None else np.maximum(i, j))
    return np.concatenate(rows), np.concatenate(columns)


def _sort_by_octaves(center: Array, radius: Array) -> list[tuple[IntArray, cKDTree, float]]:
    """The balls of each octave of the radius: their numbers, the tree of their centres, and their greatest radius."""
    if not len(radius):
        return []
    largest = max(float(radius.max()), np.finfo(float).tiny)
    octave = np.floor(-np.log2(np.maximum(radius / largest, 0.5**MAX_OCTAVES))).astype(np.int64)
    members = [np.flatnonzero(octave == each) for each in np.unique(octave).tolist()]
    return [(own, cKDTree(center[own]), float(radius[own].max())) for own in members]
