"""Fits with fewer patches: simplification of a mesh whose fit passes, and removal of polygons whose patches keep failing.

`simplify_fit` simplifies the mesh of a fit that passes and fits it again, up to thrice, with wider limits of shape. Where patches
then fail, the edits of the mesh near them are undone, at first the latest ones and then deeper and farther ones, until all pass.

`merge_failing_polygons` is for fits of which very few leaves stay bad. Where the level set almost grazes the box, slivers along
the box stay folded however finely the leaves are split. Merging a sliver into its neighbour removes the failing patch.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from tpmscad._typing import BoolArray, IntArray
from tpmscad.levelset.level_set_fit import FitRequest, LevelSetFit, fit_level_set
from tpmscad.levelset.quadmesh.dual_mesh import QuadMesh
from tpmscad.levelset.quadmesh.octree import Octree
from tpmscad.levelset.quadmesh.simplification.collapses import plan_edits_from
from tpmscad.levelset.quadmesh.simplification.edit_history import EditHistory
from tpmscad.levelset.quadmesh.simplification.greedy_simplification import simplify_mesh
from tpmscad.levelset.quadmesh.simplification.polygon_mesh import MeshEdit, PolygonMesh, extract_mesh
from tpmscad.levelset.quadmesh.smoothing import dilate_vertices, smooth_vertices
from tpmscad.levelset.quadmesh.vectors import close_triangles

MAX_REFITS = 20
"""Largest number of simplified meshes that are fitted; all but the first are fitted again only where edits were undone."""

MAX_DISTORTIONS = (1.0, 1.3, 1.6)
"""Greatest distortion of polygons in each simplification, of the mesh of the one before. Wide limits from the start leave more
patches than narrow ones: a polygon that fails takes the merges round it with it."""

MAX_EARLY_REFITS = 6
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

MAX_BAD_LEAVES = 16
"""Largest number of bad leaves for which polygons are merged."""

MAX_FAILED_MERGES = 6
"""Largest number of merges in a row that do not reduce the number of bad leaves."""

SMOOTHED_RINGS = 2
SMOOTHING_SWEEPS = 40
"""Rings of polygons round a merge that are smoothed, and the number of sweeps."""


def simplify_fit(fit: LevelSetFit) -> LevelSetFit:
    """The fit with patches merged in up to three simplifications, or `fit` itself, as of periodic fields, whose periods match."""
    if fit.request.field.periods() is not None:
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
    fit = merge_failing_polygons(_fit_history(request, tree, history, MAX_EARLY_REFITS))
    return replace(fit, is_simplified=True)


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
        if not len(refit.bad_leaves) or not _undo_near(history, mesh, numbers, tree, refit.bad_leaves, times_bad):
            break
        mesh, numbers = history.mesh()
        refit = fit_level_set(request, tree, mesh, refit)
    return refit


def merge_failing_polygons(fit: LevelSetFit) -> LevelSetFit:
    """The fit with polygons of its few bad leaves merged away one by one, if the result passes, or else `fit` itself."""
    if fit.request.field.periods() is not None or not 0 < len(fit.bad_leaves) <= MAX_BAD_LEAVES:
        return fit
    best, merges, tries = fit, _candidate_merges(fit), MAX_FAILED_MERGES
    while len(best.bad_leaves) and tries and (edit := next(merges, None)) is not None:
        merged = fit_level_set(fit.request, fit.tree, _apply_merge(best, edit), best)
        tries -= 1
        if len(merged.bad_leaves) < len(best.bad_leaves):
            best, merges, tries = merged, _candidate_merges(merged), MAX_FAILED_MERGES
    return fit if len(best.bad_leaves) else best


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


def _candidate_merges(fit: LevelSetFit) -> Iterator[MeshEdit]:
    """Edits that remove a polygon all of whose vertices are from bad leaves."""
    polygons = PolygonMesh(fit.mesh)
    is_bad = np.isin(fit.mesh.leaf, fit.bad_leaves)
    numbers = [number for number, corners in polygons.corners_of.items() if is_bad[list(corners)].all()]
    return (edit for number in numbers for edit in plan_edits_from(polygons, number))


def _apply_merge(fit: LevelSetFit, edit: MeshEdit) -> QuadMesh:
    """The fit's mesh with an edit applied, smoothed round it."""
    mesh, tree = fit.mesh, fit.tree
    polygons = PolygonMesh(mesh)
    polygons.apply(edit)
    free = np.zeros(len(mesh.vertices), bool)
    free[list(edit.vertices)] = True
    merged, ids = extract_mesh(polygons, mesh.vertices, mesh.size, sorted(polygons.corners_of))
    free = dilate_vertices(merged, free[ids], SMOOTHED_RINGS)
    return smooth_vertices(merged, free, fit.request.field, tree.lo, tree.hi, SMOOTHING_SWEEPS)
