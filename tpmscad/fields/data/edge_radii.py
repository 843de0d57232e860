"""Radii at both ends of the edges of a graph."""

from __future__ import annotations

import numpy as np

from tpmscad._typing import Array, IntArray


def order_ends(edges: IntArray, radii: Array) -> tuple[IntArray, Array]:
    """The edges (m, 2) with the node of the lower number first, and their radii (m, 2) with them."""
    turned = (edges[:, 0] > edges[:, 1])[:, None]
    return np.where(turned, edges[:, ::-1], edges), np.where(turned, radii[:, ::-1], radii)


def greatest_radii(count: int, edges: IntArray, radii: Array) -> Array:
    """The greatest radius (count,) of the ends of edges (m, 2), with radii (m, 2), at each of so many points."""
    ends = np.zeros(count)
    np.maximum.at(ends, edges, radii)
    return ends
