"""A layer of which very few patches miss, with the polygons there merged into those beside them.

Where the surface all but grazes the box, slivers along the box stay folded however finely leaves are split: the section turns,
and the sliver's other side does not follow. Without the sliver nothing has to.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from tpmscad.patches.levelset.layer import Layer, fitted
from tpmscad.patches.levelset.layout.changes import changes
from tpmscad.patches.levelset.layout.collapse import Change, Polygons, mesh_of
from tpmscad.patches.levelset.layout.dual import Mesh
from tpmscad.patches.levelset.layout.octree import Array
from tpmscad.patches.levelset.layout.relax import settled, with_neighbours
from tpmscad.patches.levelset.work import Work, here

FEW, TRIED = 8, 6
"""Bad leaves at most, and mergers fitted in turn that leave as many; patches that are not near them are not fitted again."""

RINGS, SWEEPS = 2, 40
"""Polygons round a merger that are relaxed, and sweeps."""


def mended(layer: Layer, tol: float, samples: Array, work: Work = here, few: int = FEW) -> Layer:
    """The layer with polygons of its bad leaves, if these are `few`, merged away one by one, where that passes; else itself."""
    if layer.field.periods() is not None or not 0 < len(layer.bad) <= few:
        return layer
    found, ahead, left = layer, _mergers(layer), TRIED
    while len(found.bad) and left and (change := next(ahead, None)) is not None:
        result = fitted(layer.field, layer.tree, _merged(found, change), tol, samples, found, work)
        left -= 1
        if len(result.bad) < len(found.bad):
            found, ahead, left = result, _mergers(result), TRIED
    return layer if len(found.bad) else found


def _mergers(layer: Layer) -> Iterator[Change]:
    """Changes that take away a polygon all of whose vertices are of bad leaves."""
    found = Polygons(layer.mesh)
    near = np.isin(layer.mesh.cell, layer.bad)
    at = [number for number, polygon in found.polygon.items() if near[list(polygon)].all()]
    return (change for number in at for change in changes(found, number))


def _merged(layer: Layer, change: Change) -> Mesh:
    """The layer's layout with a change made, relaxed round it."""
    mesh, tree = layer.mesh, layer.tree
    polygons = Polygons(mesh)
    polygons.apply(change)
    free = np.zeros(len(mesh.vertices), bool)
    free[list(change.vertices)] = True
    small, of = mesh_of(polygons, mesh.vertices, mesh.size, sorted(polygons.polygon))
    return settled(small, with_neighbours(small, free[of], RINGS), layer.field, tree.lo, tree.hi, SWEEPS)
