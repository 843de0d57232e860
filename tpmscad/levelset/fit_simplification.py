"""A layer that passes, made again with fewer patches: its layout simplified, and changes undone where the fit then misses.

A layer of which very few patches miss, with the polygons there merged into those beside them.

Where the surface all but grazes the box, slivers along the box stay folded however finely leaves are split: the section turns,
and the sliver's other side does not follow. Without the sliver nothing has to.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.spatial import cKDTree

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.levelset.level_set_fit import P95_TANGENT_JUMP_DEG, LevelSetFit, fit_level_set
from tpmscad.levelset.quadmesh.dual_mesh import QuadMesh
from tpmscad.levelset.quadmesh.octree import Octree
from tpmscad.levelset.quadmesh.simplification.edit_history import EditHistory
from tpmscad.levelset.quadmesh.simplification.greedy_simplification import simplify_mesh
from tpmscad.levelset.quadmesh.simplification.polygon_mesh import MeshEdit, PolygonMesh, extract_mesh
from tpmscad.levelset.quadmesh.simplification.strip_collapses import plan_edits_from
from tpmscad.levelset.quadmesh.smoothing import dilate_vertices, smooth_vertices
from tpmscad.levelset.quadmesh.vectors import close_triangles
from tpmscad.parallel import TaskRunner, run_serial

MAX_REFITS = 20
"""Layouts fitted at most. All but the first are fitted again only where changes were undone."""


def simplify_fit(layer: LevelSetFit, tol: float, samples: Array, work: TaskRunner = run_serial) -> LevelSetFit:
    """The layer of a simplified layout that passes, too, or else the layer itself.

    Layers of periodic fields stay as they are: their periods are alike.
    """
    if layer.field.periods() is not None:
        return layer
    simple = simplify_mesh(layer.mesh, layer.field, layer.tree.lo, layer.tree.hi)
    if not simple.history:
        return layer
    history = EditHistory(layer.mesh, simple, layer.field, layer.tree.lo, layer.tree.hi)
    missed_before = np.zeros(len(layer.tree.size), np.int64)
    found = layer
    for _ in range(MAX_REFITS):
        mesh, numbers = history.mesh()
        found = fit_level_set(layer.field, layer.tree, mesh, tol, samples, found, work)
        if not len(found.bad):
            jump = found.measured.tangent_jump_deg
            return found if not len(jump) or np.percentile(jump, 95) <= P95_TANGENT_JUMP_DEG else layer
        missed_before[found.bad] += 1
        undone = False
        for levels in np.unique(missed_before[found.bad]).tolist():
            leaves = found.bad[missed_before[found.bad] == levels]
            bad = numbers[_select_polygons_near_leaves(mesh, layer.tree, leaves)].tolist()
            # where nothing is left to undo that near, what misses is undone from further away
            reached = next((n for n in range(levels, MAX_REFITS + 1) if history.undo(bad, n)), None)
            if reached is not None:
                missed_before[leaves], undone = reached, True
        if not undone:
            break
    return layer


def _select_polygons_near_leaves(mesh: QuadMesh, tree: Octree, leaves: IntArray) -> BoolArray:
    """Polygons (Q,) of which all vertices are from these leaves, or else some, or else those round the nearest vertices."""
    there = np.isin(mesh.cell, leaves)
    corners = close_triangles(mesh.corners)
    whole = np.asarray(there[corners].all(axis=1))
    if whole.any():
        return whole
    if not there.any():
        there[cKDTree(mesh.vertices).query(tree.points(tree.origin[leaves] + 0.5 * tree.size[leaves][:, None]))[1]] = (
            True
        )
    return np.asarray(there[corners].any(axis=1))


MAX_BAD_LEAVES, MAX_FAILED_MERGES = 8, 6
"""Bad leaves at most, and mergers fitted in turn that leave as many; patches that are not near them are not fitted again."""

SMOOTHED_RINGS, SMOOTHING_SWEEPS = 2, 40
"""Polygons round a merger that are relaxed, and sweeps."""


def merge_failing_polygons(
    layer: LevelSetFit, tol: float, samples: Array, work: TaskRunner = run_serial, few: int = MAX_BAD_LEAVES
) -> LevelSetFit:
    """The layer with polygons of its bad leaves, if these are `few`, merged away one by one, where that passes; else itself."""
    if layer.field.periods() is not None or not 0 < len(layer.bad) <= few:
        return layer
    found, ahead, left = layer, _candidate_merges(layer), MAX_FAILED_MERGES
    while len(found.bad) and left and (change := next(ahead, None)) is not None:
        result = fit_level_set(layer.field, layer.tree, _apply_merge(found, change), tol, samples, found, work)
        left -= 1
        if len(result.bad) < len(found.bad):
            found, ahead, left = result, _candidate_merges(result), MAX_FAILED_MERGES
    return layer if len(found.bad) else found


def _candidate_merges(layer: LevelSetFit) -> Iterator[MeshEdit]:
    """Changes that take away a polygon all of whose vertices are of bad leaves."""
    found = PolygonMesh(layer.mesh)
    near = np.isin(layer.mesh.cell, layer.bad)
    at = [number for number, polygon in found.polygon.items() if near[list(polygon)].all()]
    return (change for number in at for change in plan_edits_from(found, number))


def _apply_merge(layer: LevelSetFit, change: MeshEdit) -> QuadMesh:
    """The layer's layout with a change made, relaxed round it."""
    mesh, tree = layer.mesh, layer.tree
    polygons = PolygonMesh(mesh)
    polygons.apply(change)
    free = np.zeros(len(mesh.vertices), bool)
    free[list(change.vertices)] = True
    small, of = extract_mesh(polygons, mesh.vertices, mesh.size, sorted(polygons.polygon))
    return smooth_vertices(
        small, dilate_vertices(small, free[of], SMOOTHED_RINGS), layer.field, tree.lo, tree.hi, SMOOTHING_SWEEPS
    )
