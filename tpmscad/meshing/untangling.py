"""Curved tetrahedra that overlap themselves are mended by straightening the fewest edges."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.meshing.element_shapes import TETRA_EDGES, jacobian_coefficients
from tpmscad.meshing.volume_mesh import VolumeMesh

MAX_PASSES = 4
"""Passes over the inverted elements: to straighten an edge may invert a neighbour."""


def untangle(mesh: VolumeMesh) -> VolumeMesh:
    """The mesh of second-order tetrahedra with edges of inverted elements made straight, those on facets last.

    `straightened` of the result counts, with those before, the edges on facets, whose middles are then on a chord instead of the
    exact surface.
    Elements whose corners are in the wrong order stay inverted.
    """
    if "tetra10" not in mesh.cells:
        return mesh
    cells = mesh.cells["tetra10"]
    on_facet = np.zeros(len(mesh.points), bool)
    for nodes in mesh.facets.values():
        on_facet[nodes] = True
    repeated, shift = mesh.periodic_ties()
    periods = np.where(np.isnan(mesh.periods), 0.0, mesh.periods)
    points, moved = mesh.points.copy(), np.zeros(len(mesh.points), bool)
    for movable in (~on_facet, np.ones_like(on_facet)):
        for _ in range(MAX_PASSES):
            bad = jacobian_coefficients("tetra10", points, cells).min(axis=1) <= 0.0
            if not bad.any():
                break
            middles, chords = _middles_of_edges(cells[bad], points, movable)
            images = np.isin(repeated, repeated[middles])
            points[middles] = chords
            points[repeated[middles]] = chords - shift[middles] * periods
            points[images] = points[repeated[images]] + shift[images] * periods
            moved |= images
    straightened = mesh.straightened + int((moved & on_facet).sum())
    return replace(mesh, points=points, straightened=straightened)


def _middles_of_edges(cells: IntArray, points: Array, movable: BoolArray) -> tuple[IntArray, Array]:
    """Nodes in the middle of the edges of elements that may be moved, and the middles of the chords."""
    ends = cells[:, np.array(TETRA_EDGES)]
    middles, first = np.unique(cells[:, 4:].ravel(), return_index=True)
    keep = movable[middles]
    return middles[keep], points[ends.reshape(-1, 2)[first[keep]]].mean(axis=1)
