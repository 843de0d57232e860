"""A layer of which very few patches miss, with the polygons there merged into those beside them.

Where the surface all but grazes the box, slivers along the box stay folded however finely leaves are split: the section turns,
and the sliver's other side does not follow. Without the sliver nothing has to.
"""

from __future__ import annotations

from itertools import islice

import numpy as np

from tpmscad.patches.levelset.layer import Layer, fitted
from tpmscad.patches.levelset.layout.changes import changes
from tpmscad.patches.levelset.layout.collapse import Polygons, mesh_of
from tpmscad.patches.levelset.layout.octree import Array
from tpmscad.patches.levelset.layout.relax import settled, with_neighbours
from tpmscad.patches.levelset.work import Work, here

FEW, TRIED = 4, 8
"""Bad leaves at most, and mergers fitted; those that are not near them are not fitted again."""

RINGS, SWEEPS = 2, 40
"""Polygons round a merger that are relaxed, and sweeps."""


def mended(layer: Layer, tol: float, samples: Array, work: Work = here) -> Layer:
    """The layer with a polygon of its bad leaves merged away, if that passes; else the layer itself."""
    if layer.field.periods() is not None or not 0 < len(layer.bad) <= FEW:
        return layer
    mesh, tree = layer.mesh, layer.tree
    unlocked = np.zeros(len(mesh.vertices), bool)
    found = Polygons(mesh, unlocked)
    near = np.isin(mesh.cell, layer.bad)
    at = [number for number, polygon in found.polygon.items() if near[list(polygon)].all()]
    for change in islice((change for number in at for change in changes(found, number)), TRIED):
        polygons = Polygons(mesh, unlocked)
        polygons.apply(change)
        free = np.zeros(len(mesh.vertices), bool)
        free[list(change.vertices)] = True
        small, of = mesh_of(polygons, mesh.vertices, mesh.size, sorted(polygons.polygon))
        small = settled(small, with_neighbours(small, free[of], RINGS), layer.field, tree.lo, tree.hi, SWEEPS)
        result = fitted(layer.field, tree, small, tol, samples, layer, work)
        if not len(result.bad):
            return result
    return layer
