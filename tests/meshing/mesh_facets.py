"""Faces of elements by the number of elements that have them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from tpmscad._typing import BoolArray, IntArray
from tpmscad.meshing.element_shapes import SHAPES
from tpmscad.meshing.facet_search import tabulate_faces


def boundary_facets(cells: Mapping[str, IntArray]) -> dict[str, IntArray]:
    """Faces of elements that one element alone has, with outward normals, by kind."""
    result = {}
    for kind, table in tabulate_faces(cells).items():
        corners = np.sort(table.nodes[:, : SHAPES[kind].corners], axis=1)
        _, first, count = np.unique(corners, axis=0, return_index=True, return_counts=True)
        result[kind] = table.nodes[np.sort(first[count == 1])]
    return result


def interior_facets(cells: Mapping[str, IntArray], facets: Mapping[str, IntArray]) -> BoolArray:
    """Whether each facet (n,) has an element on either side."""
    tables = tabulate_faces(cells)
    found = [np.zeros(0, bool)]
    for kind, nodes in facets.items():
        n_corners = SHAPES[kind].corners
        keys = np.sort(np.concatenate([tables[kind].nodes[:, :n_corners], nodes[:, :n_corners]]), axis=1)
        _, of, count = np.unique(keys, axis=0, return_inverse=True, return_counts=True)
        found.append(count[of.ravel()[-len(nodes) :]] == 3)
    return np.concatenate(found)
