"""A layer that passes, made again with fewer patches: its layout simplified, and left as it was where the fit then misses."""

from __future__ import annotations

import numpy as np

from tpmscad.patches.levelset.layer import TYPICAL_DEG, Layer, fitted
from tpmscad.patches.levelset.layout.dual import Mesh
from tpmscad.patches.levelset.layout.octree import Array, Mask
from tpmscad.patches.levelset.layout.simplify import simplified
from tpmscad.patches.levelset.work import Work, here

ATTEMPTS = 6
"""Simplified layouts fitted; of eleven blends most passed the second, all but one within three."""


def fewer(layer: Layer, tol: float, samples: Array, work: Work = here) -> Layer:
    """The layer of a simplified layout that passes, too, or else the layer itself.

    Where a fit misses, the vertices that its polygons were merged from are kept where they were in the next attempt, in
    later ones with those around them. Layers of periodic
    fields stay as they are: their periods are alike.
    """
    if layer.field.periods() is not None:
        return layer
    mesh, tree = layer.mesh, layer.tree
    locked = np.zeros(len(mesh.vertices), bool)
    for attempt in range(ATTEMPTS):
        small = simplified(mesh, layer.field, tree.lo, tree.hi, locked)
        if len(small.mesh.corners) == len(mesh.corners):
            break
        found = fitted(layer.field, tree, small.mesh, tol, samples, None, work)
        if not len(found.bad):
            jump = found.measured.jump
            return found if not len(jump) or np.percentile(jump, 95) <= TYPICAL_DEG else layer
        again = locked | np.isin(small.mesh.cell[small.into], found.bad) | np.isin(mesh.cell, found.bad)
        for _ in range(attempt - 1 if (again != locked).any() else attempt + 1):
            again = _with_neighbours(mesh, again)
        if (again == locked).all():
            break
        locked = again
    return layer


def _with_neighbours(mesh: Mesh, vertices: Mask) -> Mask:
    """The vertices (V,) and those that share a polygon with them."""
    result = vertices.copy()
    corners = np.where(mesh.corners < 0, mesh.corners[:, :1], mesh.corners)
    result[corners[vertices[corners].any(axis=1)]] = True
    return result
