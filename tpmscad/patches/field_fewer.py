"""A layer that passes, made again with fewer patches: its layout simplified, and left as it was where the fit then misses."""

from __future__ import annotations

import numpy as np

from tpmscad.patches.field_layer import Layer, fitted
from tpmscad.patches.field_work import Work, here
from tpmscad.patches.layout.octree import Array
from tpmscad.patches.layout.simplify import simplified

ATTEMPTS = 5
"""Simplified layouts fitted; of nine blends each passed within three."""

TYPICAL_DEG = 0.4
"""Tangent jump at the 95th percentile up to which simplified layouts are taken: below what solids are held to."""


def fewer(layer: Layer, tol: float, samples: Array, work: Work = here) -> Layer:
    """The layer of a simplified layout that passes, too, or else the layer itself.

    Where a fit misses, the vertices that its polygons were merged from are kept apart in the next attempt. Layers of periodic
    fields stay as they are: their periods are alike.
    """
    if layer.field.periods() is not None:
        return layer
    mesh, tree = layer.mesh, layer.tree
    locked = np.zeros(len(mesh.vertices), bool)
    for _ in range(ATTEMPTS):
        small = simplified(mesh, layer.field, tree.lo, tree.hi, locked)
        if len(small.mesh.corners) == len(mesh.corners):
            break
        found = fitted(layer.field, tree, small.mesh, tol, samples, None, work)
        if not len(found.bad):
            jump = found.measured.jump
            return found if not len(jump) or np.percentile(jump, 95) <= TYPICAL_DEG else layer
        again = locked | np.isin(small.mesh.cell[small.into], found.bad) | np.isin(mesh.cell, found.bad)
        if (again == locked).all():
            break
        locked = again
    return layer
