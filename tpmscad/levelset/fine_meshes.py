"""Meshes finer than the tolerance asks, as of rough images: what is found out before they are simplified.

Leaves of the octree follow the noise of the image. Most polygons of such a mesh would be fitted only to be merged, so it is
simplified first. A simplified mesh does not tell which leaves to split. These are found beforehand: where the few polygons of
poor shape cannot be fitted, and where samples of the level set are far from the mesh.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from tpmscad._typing import Array, IntArray
from tpmscad.fields.field import Field
from tpmscad.levelset.level_set_fit import PATCH_DEGREES, FitRequest, LevelSetFit, fit_level_set, locate_leaves
from tpmscad.levelset.quadmesh.dual_mesh import QuadMesh
from tpmscad.levelset.quadmesh.octree import Octree
from tpmscad.levelset.quadmesh.quality import corner_distortion, interior_distortion, measure_side_distances
from tpmscad.levelset.quadmesh.smoothing import extract_submesh
from tpmscad.levelset.quadmesh.vectors import normalize

MIN_POLYGONS = 2000
"""Least number of polygons of a mesh that is simplified before it is fitted: smaller ones take seconds in any order."""

FINE_QUANTILE, FINE_SIDE_TOLS = 0.95, 1.0
"""A mesh is finer than the tolerance asks if this quantile of the distances of its cubic sides from the level set is at most
this fraction of the tolerance."""

N_POLYGONS_MEASURED = 2000
"""Polygons of which the sides are measured for that."""

MAX_PERIODS = 40.0
"""Periods in the box up to which the mesh of a periodic field is simplified, too, although they then differ. A blend of a
gyroid and a Schwarz P rod in a ball has 3,460 faces in 52 s, and 8,900 in 59 s if its periods stay alike, of 15 in its box; of
35 it has 9,270 in 99 s, and 26,990 in 112 s."""

MIN_RISKY_INTERIOR, MIN_RISKY_CORNER = 0.7, 1.05
"""Interior and corner distortions of a polygon above which its patch may fail. Patches fold, too, where two corners lie in one
leaf, which the surface passes twice."""


def is_finer_than_asked(request: FitRequest, tree: Octree, mesh: QuadMesh) -> bool:
    """Whether a mesh has many polygons, and most of them are far within the tolerance."""
    count = len(mesh.corners)
    if count < MIN_POLYGONS or _count_periods(request.field, tree) > MAX_PERIODS:
        return False
    chosen = mesh.corners[:: max(1, count // N_POLYGONS_MEASURED)]
    normals = normalize(request.field.gradient(mesh.vertices))
    distance = measure_side_distances(request.field, mesh.vertices, normals, mesh.fixed, chosen)
    return bool(np.quantile(distance, FINE_QUANTILE) <= FINE_SIDE_TOLS * request.tol)


def _count_periods(field: Field, tree: Octree) -> float:
    """Volume of the box in periods of the field, 0 if it has none; a direction in which nothing changes is one period."""
    edges, periods = tree.hi - tree.lo, np.array(field.periods() or np.full(3, np.inf))
    return float(np.prod(edges / np.where(periods > 0, periods, edges)))


def fit_risky_polygons(
    request: FitRequest, tree: Octree, mesh: QuadMesh, previous: LevelSetFit | None
) -> LevelSetFit | None:
    """The fit of the polygons of poor shape, and of those round patches that need a higher degree; samples are not measured.

    Patches of a `previous` fit are reused. None if all polygons are of good shape.
    """
    alone = replace(request, surface_samples=np.empty((0, 3)))
    normals = normalize(request.field.gradient(mesh.vertices))
    surface = mesh.vertices, normals, mesh.fixed, mesh.corners
    risky = interior_distortion(request.field, *surface) > MIN_RISKY_INTERIOR
    risky |= corner_distortion(*surface) > MIN_RISKY_CORNER
    # on the box a leaf has a vertex in its face besides
    sheet = np.where(mesh.fixed.any(axis=1), -1 - np.arange(len(mesh.leaf)), mesh.leaf)
    leaf = np.sort(np.where(mesh.corners < 0, len(mesh.vertices) + mesh.leaf.max() + 1, sheet[mesh.corners]), axis=1)
    risky |= (np.diff(leaf, axis=1) == 0).any(axis=1)
    if not risky.any():
        return None
    part, ids = extract_submesh(mesh, risky)
    fit = fit_level_set(alone, tree, part, previous)
    if len(fit.bad_leaves):
        return fit
    raised = np.array([len(poles) - 1 > PATCH_DEGREES[0] for poles in fit.fit.patches], bool)
    corners = fit.network.corners[raised]
    steep = np.zeros(len(mesh.vertices), bool)
    steep[ids[corners[(corners >= 0) & (corners < len(ids))]]] = True
    beside = ~risky & (steep[mesh.corners] & (mesh.corners >= 0)).any(axis=1)
    return fit_level_set(alone, tree, extract_submesh(mesh, risky | beside)[0], fit) if beside.any() else fit


def find_missed_leaves(tree: Octree, mesh: QuadMesh, samples: Array) -> IntArray:
    """Leaves with samples (n, 3) of the level set that are farther from the mesh's nearest vertex than its longest side."""
    ends = mesh.side_ends
    longest = np.zeros(len(mesh.vertices))
    np.maximum.at(longest, ends, np.linalg.norm(mesh.vertices[ends[:, 0]] - mesh.vertices[ends[:, 1]], axis=1)[:, None])
    distance, nearest = cKDTree(mesh.vertices).query(samples)
    return np.unique(locate_leaves(tree, samples[distance > longest[nearest]]))
