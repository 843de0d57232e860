"""One level set, meshed on an octree, fitted and measured: the patches that fail, and the leaves that are too coarse for them.

A patch fails if it is folded, if it is farther from the level set than the tolerance (or leaves the box), or if it meets another
patch at too large an angle. The degrees of failing patches are raised, from 5 to 7 and 9. Leaves of patches that still fail are
reported as bad, for the search (`adaptive_search`) to split. A fit of a refined or simplified mesh reuses the curves and patches
of the previous one between the same vertices.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.fields.field import Field
from tpmscad.levelset.fit.box_curves import find_crossing_curves, measure_overshoot, sample_box_curves
from tpmscad.levelset.fit.fit_quality import FitQuality, PreviousQuality, measure_distances_to_patches, measure_fit
from tpmscad.levelset.fit.network_fit import NetworkFit, WarmStart, fit_network
from tpmscad.levelset.quadmesh.dual_mesh import QuadMesh, build_dual_mesh
from tpmscad.levelset.quadmesh.octree import Octree
from tpmscad.levelset.quadmesh.patch_network import NetworkMatch, PatchNetwork, build_patch_network, match_networks
from tpmscad.levelset.quadmesh.periodicity import find_translated_copies, snap_translated_vertices
from tpmscad.levelset.quadmesh.smoothing import smooth_from_start, smooth_mesh
from tpmscad.levelset.quadmesh.vectors import corner_sines, normalize
from tpmscad.parallel import TaskRunner, run_serial

PATCH_DEGREES = (5, 7, 9)
"""Degrees of curves and patches, the first for all and the others for those that fail."""

MAX_TANGENT_JUMP_DEG = 0.01
"""Largest angle between the normals of two patches along their joint, which the fit makes zero but for round-off."""

MIN_NORMAL_COSINE = 0.95
"""Least cosine of the angle between a patch's normal and the gradient. Two sides of a wall that both satisfy it cannot cross."""

MAX_OVERSHOOT_FRACTION = 1e-3
"""Largest overshoot of a curve in a face of the box, as a fraction of the tolerance: caps with larger ones intersect
themselves."""

MAX_HOPELESS_FRACTION = 0.3
"""Largest fraction of hopeless patches for which higher degrees are tried: with more of them the mesh is too coarse."""

HOPELESS_DISTANCE_TOLS = 8.0
"""Distance of a patch from the level set, in tolerances, above which a higher degree is not expected to bring it within one."""

MIN_CORNER_SINE = 0.02
MIN_CORNER_NORMAL_COSINE = -0.8
"""Least signed corner sine of a polygon that is fitted at all, and least cosine between the normals at two of its corners."""

MIN_BOX_SECTION_COSINE = -0.3
"""Least cosine between the normals of the surface's section with the box at the two ends of a side."""

MIN_SIDE_FRACTION = 1e-3
"""Least length of a side in sizes of the leaves at its ends: vertices that are pulled out of the box may come to rest on
others."""

MAX_SAMPLE_DISTANCE_RATIO = 4.0
"""Samples of the level set are projected with more starts if they are farther from the patches than this multiple of the distance
from the patches to the level set."""


@dataclass(frozen=True, slots=True, eq=False)
class FitRequest:
    """What is to be fitted: {field = 0} within `tol` in both directions, tested at `surface_samples` (n, 3) of it."""

    field: Field
    tol: float
    surface_samples: Array
    run_tasks: TaskRunner = run_serial


@dataclass(frozen=True, slots=True, eq=False)
class PatchFailures:
    """Patches (Q,) that are folded, that are inaccurate or leave the box, and that are not smooth with their other neighbours."""

    folded: BoolArray
    inaccurate: BoolArray
    rough: BoolArray

    @property
    def failing(self) -> BoolArray:
        """Patches (Q,) that fail for any reason."""
        return self.folded | self.inaccurate | self.rough

    def describe(self) -> str:
        """How many patches fail for each reason."""
        reasons = ((self.folded, "folded"), (self.inaccurate, "too far off"), (self.rough, "not smooth"))
        return ", ".join(f"{np.count_nonzero(mask)} {word}" for mask, word in reasons if mask.any())


@dataclass(frozen=True, slots=True, eq=False)
class LevelSetFit:
    """A fitted and measured level set.

    `failing` (Q,) marks patches that fail, `short` these and those nearest to samples that no patch reaches, `sample_distances`
    (n,) are the distances from the request's samples to the patches (empty if patches fail), `bad_leaves` are too coarse, and
    `failure_text` says why. `is_simplified`: whether the mesh was simplified before it was fitted.
    """

    request: FitRequest
    tree: Octree
    mesh: QuadMesh
    network: PatchNetwork
    fit: NetworkFit
    quality: FitQuality
    failing: BoolArray
    short: BoolArray
    sample_distances: Array
    bad_leaves: IntArray
    failure_text: str
    is_simplified: bool = False

    @property
    def leaves_of_short(self) -> IntArray:
        """Bad leaves, and those that the patches come from which fall short: a merged one lies in others than the samples."""
        return np.union1d(self.bad_leaves, self.network.leaf[self.short].ravel())

    @property
    def bad_volume(self) -> float:
        """Volume of the bad leaves, which a split does not raise, unlike their number."""
        return float((self.tree.size[self.bad_leaves] ** 3).sum() * np.prod(self.tree.cell_edges))

    @property
    def bad_fraction(self) -> float:
        """Number of bad leaves relative to the number of leaves with patches."""
        return len(self.bad_leaves) / max(1, len(np.unique(self.network.leaf)))

    @property
    def fixed(self) -> BoolArray:
        """Coordinates (V, 3) of the network's vertices that lie on the box."""
        fixed = np.zeros((len(self.network.vertices), 3), bool)
        fixed[: len(self.mesh.fixed)] = self.mesh.fixed
        return fixed


@dataclass(frozen=True, slots=True, eq=False)
class _FittedNetwork:
    """A network, its fit and quality, and the degrees of its curves (C,) and patches (Q,)."""

    network: PatchNetwork
    fit: NetworkFit
    quality: FitQuality
    curve_degree: IntArray
    patch_degree: IntArray


def mesh_level_set(tree: Octree, field: Field, coarser: QuadMesh | None = None) -> tuple[QuadMesh, IntArray]:
    """The smoothed mesh on an octree, and the leaves of polygons that no fit could save.

    `coarser` is the mesh of a coarser octree, of which vertices are reused where the octree has not changed.
    """
    mesh = smooth_mesh(build_dual_mesh(tree, field), field, tree.lo, tree.hi, coarser=coarser)
    folded = np.asarray(_find_hopeless_corners(mesh, field).any(axis=1))
    if coarser is not None and folded.any():
        again = smooth_from_start(mesh, folded, field, tree.lo, tree.hi)
        if _find_hopeless_corners(again, field).any(axis=1).sum() < folded.sum():
            mesh = again
    mesh = snap_translated_vertices(mesh, field, tree)
    bad_corners = mesh.leaf[mesh.corners[_find_hopeless_corners(mesh, field)]]
    turning_sides = mesh.leaf[mesh.side_ends[_find_turning_box_sides(mesh, field)]]
    return mesh, np.unique(np.concatenate([_find_degenerate_leaves(mesh), bad_corners, turning_sides.ravel()]))


def fit_level_set(
    request: FitRequest, tree: Octree, mesh: QuadMesh, previous: LevelSetFit | None = None
) -> LevelSetFit:
    """Fit and measure a mesh of the level set, raising the degrees of failing patches.

    Patches of a `previous` fit between the same vertices are reused unless they failed.
    """
    network = build_patch_network(mesh, request.field)
    fitted = _fit_lowest_degrees(request, tree, network, previous)
    failures = classify_failures(fitted, tree, request.tol)
    # once more with the highest degree: raised patches raise sides of their neighbours, which may fail then
    for degree in (*PATCH_DEGREES[1:], PATCH_DEGREES[-1]):
        weak = _select_weak_patches(request, fitted, failures) & (fitted.patch_degree < degree)
        if not weak.any():
            break
        fitted = _raise_degree(request, fitted, weak, degree)
        failures = classify_failures(fitted, tree, request.tol)
    return _find_bad_leaves(request, tree, mesh, fitted, failures)


def classify_failures(fitted: _FittedNetwork | LevelSetFit, tree: Octree, tol: float) -> PatchFailures:
    """The patches that fail, by reason; a tangent jump at a folded or inaccurate patch is that patch's failure only."""
    network, quality = fitted.network, fitted.quality
    box_curves = sample_box_curves(network, fitted.fit)
    leaving = measure_overshoot(network, box_curves, tree) > MAX_OVERSHOOT_FRACTION * tol
    crossing = find_crossing_curves(network, box_curves)
    # negated, so that patches that are not finite fail
    folded = ~(quality.min_normal_cosine >= MIN_NORMAL_COSINE) | crossing[network.curve].any(axis=1)
    inaccurate = ~(quality.distance <= tol) | leaving[network.curve].any(axis=1)
    steep = np.zeros(len(network.ends), bool)
    steep[quality.curve[quality.tangent_jump_deg > MAX_TANGENT_JUMP_DEG]] = True
    steep[network.curve[folded | inaccurate].ravel()] = False
    return PatchFailures(folded, inaccurate, np.asarray(steep[network.curve].any(axis=1)))


def _fit_lowest_degrees(
    request: FitRequest, tree: Octree, network: PatchNetwork, previous: LevelSetFit | None
) -> _FittedNetwork:
    """The network fitted with the lowest degree, except what is reused of a previous fit, with its degree."""
    field, run_tasks = request.field, request.run_tasks
    n_curves, n_patches = len(network.ends), len(network.curve)
    keep_curves, keep_patches = np.zeros(n_curves, bool), np.zeros(n_patches, bool)
    curves, normals, patches = ([np.empty(0)] * n for n in (n_curves, n_curves, n_patches))
    curve_degree, patch_degree = np.full(n_curves, PATCH_DEGREES[0]), np.full(n_patches, PATCH_DEGREES[0])
    known = None
    if previous is not None:
        match = _drop_failing(match_networks(network, previous.network), network, previous)
        keep_curves, keep_patches = match.previous_curve >= 0, match.previous_patch >= 0
        for i in np.flatnonzero(keep_curves):
            curves[i] = previous.fit.curves[match.previous_curve[i]]
            normals[i] = previous.fit.normals[match.previous_curve[i]]
            curve_degree[i] = len(curves[i]) - 1
        for i in np.flatnonzero(keep_patches):
            patches[i] = previous.fit.patches[match.previous_patch[i]]
            patch_degree[i] = min(patches[i].shape[:2]) - 1
        known = PreviousQuality(previous.quality, ~keep_patches, match.previous_patch, match.previous_curve)
    network, copies = find_translated_copies(network, field, tree, keep_curves, keep_patches)
    curve_degree, patch_degree = curve_degree[copies.curve], patch_degree[copies.patch]
    warm_start = WarmStart(NetworkFit(curves, normals, patches, copies), ~keep_curves, ~keep_patches)
    fit = fit_network(network, field, curve_degree, patch_degree, warm_start, run_tasks)
    return _FittedNetwork(network, fit, measure_fit(network, fit, field, known, run_tasks), curve_degree, patch_degree)


def _select_weak_patches(request: FitRequest, fitted: _FittedNetwork, failures: PatchFailures) -> BoolArray:
    """Patches (Q,) whose degrees are worth raising: those that fail, and none if too many are folded or very far off."""
    hopeless = failures.folded | (fitted.quality.distance > HOPELESS_DISTANCE_TOLS * request.tol)
    return failures.failing & (hopeless.mean() <= MAX_HOPELESS_FRACTION)


def _raise_degree(request: FitRequest, fitted: _FittedNetwork, weak: BoolArray, degree: int) -> _FittedNetwork:
    """The network with weak patches (Q,), their copies and their sides fitted again with a degree."""
    network, copies = fitted.network, fitted.fit.copies
    weak = copies.patches_with_copies(weak)
    patch_degree = np.where(weak, degree, fitted.patch_degree)
    refit = np.zeros(len(network.ends), bool)
    refit[network.curve[weak].ravel()] = True
    refit = copies.curves_with_copies(refit)
    curve_degree = np.where(refit, degree, fitted.curve_degree)
    refit[network.n_sides :] |= refit[network.split_curve]
    changed = weak | refit[network.curve].any(axis=1)
    warm_start = WarmStart(fitted.fit, refit, changed)
    fit = fit_network(network, request.field, curve_degree, patch_degree, warm_start, request.run_tasks)
    itself = np.arange(len(network.curve)), np.arange(len(network.ends))
    known = PreviousQuality(fitted.quality, changed, *itself)
    quality = measure_fit(network, fit, request.field, known, request.run_tasks)
    return _FittedNetwork(network, fit, quality, curve_degree, patch_degree)


def _find_bad_leaves(
    request: FitRequest, tree: Octree, mesh: QuadMesh, fitted: _FittedNetwork, failures: PatchFailures
) -> LevelSetFit:
    """The fit with the leaves of failing patches, or else of samples too far from the patches, and of degenerate sides."""
    network, fit, quality = fitted.network, fitted.fit, fitted.quality
    failing, text = failures.failing, failures.describe()
    short = failing.copy()
    leaves, distances = np.unique(network.leaf[failing]), np.zeros(0)
    if not len(leaves):
        samples = request.surface_samples
        expected = MAX_SAMPLE_DISTANCE_RATIO * float(quality.distance.max())
        distances, nearest = measure_distances_to_patches(fit, samples, min(request.tol, expected), request.tol)
        leaves = np.unique(locate_leaves(tree, samples[distances > request.tol]))
        short[nearest] = True
        text = f"{len(leaves)} parts of the surface missed" if len(leaves) else text
    degenerate = _find_degenerate_leaves(mesh)
    if len(degenerate):
        leaves = np.union1d(leaves, degenerate)
        text = "edges without length, or two between the same vertices" + (f", {text}" if text else "")
    return LevelSetFit(request, tree, mesh, network, fit, quality, failing, short, distances, leaves, text)


def _drop_failing(match: NetworkMatch, network: PatchNetwork, previous: LevelSetFit) -> NetworkMatch:
    """The match without the curves that bound a failing patch of the previous fit, and without the patches beside these.

    Such patches are fitted from the lowest degree again: they may pass with their new neighbours, and degree elevations that did
    not help are discarded.
    """
    spoilt = np.zeros(len(previous.network.ends) + 1, bool)  # the last one stands for curves without a match
    spoilt[previous.network.curve[previous.failing].ravel()] = True
    curve = np.where(spoilt[match.previous_curve], -1, match.previous_curve)
    curve[network.n_sides + np.flatnonzero(curve[network.split_curve] < 0)] = -1
    return NetworkMatch(curve, np.where((curve[network.curve] < 0).any(axis=1), -1, match.previous_patch))


def _find_hopeless_corners(mesh: QuadMesh, field: Field) -> BoolArray:
    """Corners (Q, 4) at which a polygon is folded, or from which the surface turns too far to another corner of it."""
    normals = normalize(field.gradient(mesh.vertices))
    triangular = mesh.corners[:, 3] < 0
    result = np.zeros(mesh.corners.shape, bool)
    for rows, n in ((np.flatnonzero(~triangular), 4), (np.flatnonzero(triangular), 3)):
        if len(rows):
            corners = mesh.corners[rows, :n]
            at_corners = normals[corners]
            cosine = (at_corners @ np.swapaxes(at_corners, 1, 2)).min(axis=2)
            folded = corner_sines(mesh.vertices, corners, normals) < MIN_CORNER_SINE
            result[rows, :n] = folded | (cosine < MIN_CORNER_NORMAL_COSINE)
    return result


def _find_turning_box_sides(mesh: QuadMesh, field: Field) -> IntArray:
    """Sides on the box along which the surface's section with the box turns too far."""
    on_box = np.flatnonzero(mesh.side_plane >= 0)
    normal = field.gradient(mesh.vertices[mesh.side_ends[on_box]])
    normal[np.arange(len(on_box)), :, mesh.side_plane[on_box] // 2] = 0.0
    normal = normalize(normal)
    return on_box[np.einsum("si,si->s", normal[:, 0], normal[:, 1]) < MIN_BOX_SECTION_COSINE]


def _find_degenerate_leaves(mesh: QuadMesh) -> IntArray:
    """Leaves at the ends of sides that join the same two vertices as another side, or have next to no length."""
    ends = np.sort(mesh.side_ends, axis=1)
    _, index, count = np.unique(ends, axis=0, return_inverse=True, return_counts=True)
    length = np.linalg.norm(mesh.vertices[ends[:, 0]] - mesh.vertices[ends[:, 1]], axis=1)
    degenerate = (count[index.ravel()] > 1) | (length < MIN_SIDE_FRACTION * mesh.size[ends].min(axis=1))
    return np.unique(mesh.leaf[ends[degenerate]])


def locate_leaves(tree: Octree, points: Array) -> IntArray:
    """The leaf (n,) that contains each point (n, 3)."""
    cell = np.clip(((points - tree.lo) / tree.cell_edges).astype(int), 0, tree.shape - 1)
    return tree.leaves_at(cell)
