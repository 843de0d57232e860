"""A layer that passes, made again with fewer patches: its layout simplified, and changes undone where the fit then misses."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from tpmscad.patches.levelset.layer import TYPICAL_DEG, Layer, fitted
from tpmscad.patches.levelset.layout.dual import Mesh
from tpmscad.patches.levelset.layout.history import History
from tpmscad.patches.levelset.layout.octree import Array, Ints, Mask, Octree
from tpmscad.patches.levelset.layout.simplify import simplified
from tpmscad.patches.levelset.layout.vectors import filled
from tpmscad.patches.levelset.work import Work, here

ATTEMPTS = 20
"""Layouts fitted at most. All but the first are fitted again only where changes were undone."""


def fewer(layer: Layer, tol: float, samples: Array, work: Work = here) -> Layer:
    """The layer of a simplified layout that passes, too, or else the layer itself.

    Layers of periodic fields stay as they are: their periods are alike.
    """
    if layer.field.periods() is not None:
        return layer
    simple = simplified(layer.mesh, layer.field, layer.tree.lo, layer.tree.hi)
    if not simple.history:
        return layer
    history = History(layer.mesh, simple, layer.field, layer.tree.lo, layer.tree.hi)
    missed_before = np.zeros(len(layer.tree.size), np.int64)
    found = layer
    for _ in range(ATTEMPTS):
        mesh, numbers = history.mesh()
        found = fitted(layer.field, layer.tree, mesh, tol, samples, found, work)
        if not len(found.bad):
            jump = found.measured.jump
            return found if not len(jump) or np.percentile(jump, 95) <= TYPICAL_DEG else layer
        missed_before[found.bad] += 1
        undone = False
        for levels in np.unique(missed_before[found.bad]).tolist():
            leaves = found.bad[missed_before[found.bad] == levels]
            bad = numbers[_polygons_at(mesh, layer.tree, leaves)].tolist()
            # where nothing is left to undo that near, what misses is undone from further away
            reached = next((n for n in range(levels, ATTEMPTS + 1) if history.undo(bad, n)), None)
            if reached is not None:
                missed_before[leaves], undone = reached, True
        if not undone:
            break
    return layer


def _polygons_at(mesh: Mesh, tree: Octree, leaves: Ints) -> Mask:
    """Polygons (Q,) of which all vertices are from these leaves, or else some, or else those round the nearest vertices."""
    there = np.isin(mesh.cell, leaves)
    corners = filled(mesh.corners)
    whole = np.asarray(there[corners].all(axis=1))
    if whole.any():
        return whole
    if not there.any():
        there[cKDTree(mesh.vertices).query(tree.points(tree.origin[leaves] + 0.5 * tree.size[leaves][:, None]))[1]] = (
            True
        )
    return np.asarray(there[corners].any(axis=1))
