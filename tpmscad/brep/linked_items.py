"""Connected components of items that are joined in pairs, or by what they share."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from tpmscad._typing import IntArray


def label_linked(n: int, pairs: IntArray) -> IntArray:
    """The component of each of n items joined by `pairs` (P, 2): (n,), numbered in the order of their first items."""
    graph = coo_array((np.ones(len(pairs), bool), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    return connected_components(graph, directed=False)[1].astype(np.int64)


def label_sharing(n: int, item: IntArray, shared: IntArray) -> IntArray:
    """The component of each of n items, where all `item` (P,) with an equal number `shared` (P,) >= 0 are joined: (n,)."""
    pairs = np.column_stack([item, n + shared])
    return label_linked(n + 1 + int(shared.max(initial=-1)), pairs)[:n]
