"""Fits with fewer patches: the mesh of a fit that passes is simplified and fitted again, up to thrice, in wider limits of shape.

Where patches then fail, the edits of the mesh near them are undone, at first the latest ones and then deeper and farther ones,
until all pass.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from tpmscad._typing import BoolArray, IntArray
from tpmscad.levelset.level_set_fit import FitRequest, LevelSetFit, fit_level_set
from tpmscad.levelset.quadmesh.dual_mesh import QuadMesh
from tpmscad.levelset.quadmesh.octree import Octree
from tpmscad.levelset.quadmesh.simplification.edit_history import EditHistory
from tpmscad.levelset.quadmesh.simplification.greedy_simplification import simplify_mesh
from tpmscad.levelset.quadmesh.vectors import close_triangles

MAX_REFITS = 20
"""Largest number of simplified meshes that are fitted; all but the first are fitted again only where edits were undone."""

MAX_DISTORTIONS = (1.0, 1.3, 1.6)
"""Greatest distortion of polygons in each simplification, of the mesh of the one before. Wide limits from the start leave more
patches than narrow ones: a polygon that fails takes the merges round it with it."""

MAX_EARLY_REFITS = 8
"""The same of a mesh that is simplified before anything is fitted, some of whose original polygons may fail."""

MIN_GAIN, MIN_GAIN_PATCHES = 0.35, 1500
"""Fraction of the patches that a simplification has to remove for the next one to be tried, where it leaves more patches than
this number: the next one removes a third of that fraction, and takes a fifth of the time of the solid, seconds for so many."""

MAX_SIDE_DISTANCE_TOLS = 16.0
"""Greatest distance of the cubic sides of merged polygons from the level set, in tolerances: of those farther off one in twenty
fails, and takes thirty others with it."""

MAX_FAILING_FRACTION = 1.0 / 3.0
"""Fraction of failing patches above which the simplification of a fit of more than `MIN_GAIN_PATCHES` is given up. Where the
level set has details between the sides of the polygons, as that of a segmentation has, half of them do; the edits are then undone
down to nearly the mesh that there was (4029 to 3866 patches, 1881 to 1842), and take a third to a half of the time of the solid.
Smaller fits take about a second."""


def simplify_fit(fit: LevelSetFit) -> LevelSetFit:
    """The fit with patches merged in up to three simplifications, or `fit` itself.

    Periods of a periodic field match, and stay so unless its mesh was simplified before it was fitted.
    """
    if fit.request.field.periods() is not None and not fit.is_simplified:
        return fit
    for max_distortion in MAX_DISTORTIONS[1:] if fit.is_simplified else MAX_DISTORTIONS:
        simplified = _simplify_once(fit, max_distortion)
        if simplified is None:  # wider limits would fail all the more
            break
        before, after = len(fit.network.curve), len(simplified.network.curve)
        if after < before:
            fit = simplified
        if after > max(MIN_GAIN_PATCHES, (1.0 - MIN_GAIN) * before):
            break
    return fit


def _simplify_once(fit: LevelSetFit, max_distortion: float) -> LevelSetFit | None:
    """Fit of a simplified mesh, None if none passes, and `fit` itself if there is nothing to simplify."""
    history = _simplify_mesh(fit.request, fit.tree, fit.mesh, max_distortion)
    if not history.edits:
        return fit
    max_failing = MAX_FAILING_FRACTION if len(fit.network.curve) > MIN_GAIN_PATCHES else 1.0
    refit = _fit_history(fit.request, fit.tree, history, MAX_REFITS, fit, max_failing)
    return None if len(refit.bad_leaves) else refit


def fit_simplified_mesh(request: FitRequest, tree: Octree, mesh: QuadMesh) -> LevelSetFit:
    """The fit of a mesh that is simplified within the narrowest limit before it is fitted, which may have bad leaves."""
    history = _simplify_mesh(request, tree, mesh, MAX_DISTORTIONS[0])
    return replace(_fit_history(request, tree, history, MAX_EARLY_REFITS), is_simplified=True)


def _simplify_mesh(request: FitRequest, tree: Octree, mesh: QuadMesh, max_distortion: float) -> EditHistory:
    side_distance = MAX_SIDE_DISTANCE_TOLS * request.tol
    return simplify_mesh(mesh, request.field, tree.lo, tree.hi, max_distortion, side_distance)


def _fit_history(
    request: FitRequest,
    tree: Octree,
    history: EditHistory,
    max_refits: int,
    previous: LevelSetFit | None = None,
    max_failing: float = 1.0,
) -> LevelSetFit:
    """The last fit of a simplified mesh, of which edits are undone until all patches pass.

    The first one if more than a part `max_failing` of its patches fail.
    """
    times_bad = np.zeros(len(tree.size), np.int64)
    mesh, numbers = history.mesh()
    refit = fit_level_set(request, tree, mesh, previous)
    if refit.failing.mean() > max_failing:
        return refit
    for _ in range(max_refits - 1):
        if not len(refit.bad_leaves) or not _undo_near(history, mesh, numbers, tree, refit.leaves_of_short, times_bad):
            break
        mesh, numbers = history.mesh()
        refit = fit_level_set(request, tree, mesh, refit)
    return refit


def _undo_near(
    history: EditHistory, mesh: QuadMesh, numbers: IntArray, tree: Octree, bad_leaves: IntArray, times_bad: IntArray
) -> bool:
    """Undo edits near bad leaves, the deeper the more often a leaf was bad; whether any was undone. Updates `times_bad` (N,).

    Where nothing is left to undo at that depth, a greater one is tried.
    """
    times_bad[bad_leaves] += 1
    undone = False
    for depth in np.unique(times_bad[bad_leaves]).tolist():
        leaves = bad_leaves[times_bad[bad_leaves] == depth]
        failing = numbers[_select_polygons_near_leaves(mesh, tree, leaves)].tolist()
        reached = next((n for n in range(depth, MAX_REFITS + 1) if history.undo(failing, n)), None)
        if reached is not None:
            times_bad[leaves], undone = reached, True
    return undone


def _select_polygons_near_leaves(mesh: QuadMesh, tree: Octree, leaves: IntArray) -> BoolArray:
    """Polygons (Q,) with all vertices from these leaves, or else with some, or else at the vertices nearest to them."""
    chosen = np.isin(mesh.leaf, leaves)
    corners = close_triangles(mesh.corners)
    inside = np.asarray(chosen[corners].all(axis=1))
    if inside.any():
        return inside
    if not chosen.any():
        chosen[cKDTree(mesh.vertices).query(tree.leaf_centres(leaves))[1]] = True
    return np.asarray(chosen[corners].any(axis=1))
