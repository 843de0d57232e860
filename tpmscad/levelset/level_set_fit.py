"""One level set laid out on an octree, fitted and measured: what passes, and which leaves are too coarse for the rest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.fields.field import Field
from tpmscad.levelset.fit import fit_quality
from tpmscad.levelset.fit.box_curves import find_crossing_curves, measure_overshoot, sample_box_curves
from tpmscad.levelset.fit.fit_quality import measure_distances_to_patches as missed_by
from tpmscad.levelset.fit.network_fit import NetworkFit, fit_network
from tpmscad.levelset.quadmesh import octree
from tpmscad.levelset.quadmesh.dual_mesh import QuadMesh, build_dual_mesh
from tpmscad.levelset.quadmesh.octree import Octree
from tpmscad.levelset.quadmesh.patch_network import NetworkMatch, PatchNetwork, build_patch_network, match_networks
from tpmscad.levelset.quadmesh.periodicity import find_translated_copies, snap_translated_vertices
from tpmscad.levelset.quadmesh.smoothing import corner_sines, smooth_mesh
from tpmscad.levelset.quadmesh.vectors import normalize
from tpmscad.parallel import TaskRunner, run_serial

PATCH_DEGREES = (5, 7, 9)

MAX_TANGENT_JUMP_DEG = 2.0
MIN_NORMAL_COSINE = 0.95
"""Least cosine of a patch's normal with the gradient: far from folded. No two sides of a wall can cross and both have it."""

MIN_CORNER_SINE, MIN_CORNER_NORMAL_COSINE = 0.02, -0.8
"""Polygons with a corner of a lesser sine, or two corners whose normals have a lesser cosine, are not worth a fit."""

MIN_SIDE_FRACTION = 1e-3
"""Sides are at least this part of the leaves at their ends. Vertices that polygons pull out of the box come to rest on others."""

MIN_SECTION_NORMAL_COSINE = -0.3
"""Least cosine between the normals of the surface's section with the box at the ends of a side."""

P95_TANGENT_JUMP_DEG = 0.5
"""Tangent jump that at most one joint in twenty may exceed; degrees are raised beside those that do."""

MAX_OVERSHOOT_FRACTION = 1e-3
"""Part of tol by which sides in the box's faces may leave them between their ends: beyond that caps cross themselves."""

MAX_FAILING_FRACTION = 0.1
"""Above this share of failing patches higher degrees are not tried: the layout is too coarse."""


@dataclass(frozen=True, slots=True, eq=False)
class LevelSetFit:
    """One level set, fitted and measured; `bad` leaves of its tree are too coarse, and `why` says what was seen there."""

    field: Field
    tree: Octree
    mesh: QuadMesh
    net: PatchNetwork
    fit: NetworkFit
    measured: fit_quality.FitQuality
    wrong: BoolArray
    """Patches (Q,) that are folded, too far off or not smooth."""
    missed: Array
    bad: IntArray
    failure_text: str

    @property
    def bad_volume(self) -> float:
        """The volume of the bad leaves: their number grows with every split."""
        return float((self.tree.size[self.bad] ** 3).sum() * np.prod(self.tree.step))

    @property
    def bad_fraction(self) -> float:
        return len(self.bad) / max(1, len(np.unique(self.net.cell)))

    @property
    def fixed(self) -> BoolArray:
        """Which coordinates of the net's vertices (V, 3) lie on the box."""
        fixed = np.zeros((len(self.net.vertices), 3), bool)
        fixed[: len(self.mesh.fixed)] = self.mesh.fixed
        return fixed


def mesh_level_set(tree: Octree, field: Field, before: QuadMesh | None = None) -> tuple[QuadMesh, IntArray]:
    """The relaxed layout on a tree, and the leaves whose polygons no fit could save: turned over, or two sides in one.

    `before`: the layout of a coarser tree, of which vertices are kept where the tree has not changed.
    """
    mesh = snap_translated_vertices(
        smooth_mesh(build_dual_mesh(tree, field), field, tree.lo, tree.hi, before=before), field, tree
    )
    slope = field.gradient(mesh.vertices)
    normal = normalize(slope)
    bad = [_find_degenerate_leaves(mesh)]
    three = mesh.corners[:, 3] < 0
    for corners in (mesh.corners[~three], mesh.corners[three][:, :3]):
        if len(corners):
            wrong = corner_sines(mesh.vertices, corners, normal) < MIN_CORNER_SINE
            each = normal[corners]
            wrong |= (each @ np.swapaxes(each, 1, 2)).min(axis=2) < MIN_CORNER_NORMAL_COSINE
            bad.append(mesh.cell[corners[wrong]])
    bad.append(mesh.cell[mesh.side_ends[_find_turning_box_sides(mesh, slope)]].ravel())
    return mesh, np.unique(np.concatenate(bad))


def _find_turning_box_sides(mesh: QuadMesh, slope: Array) -> IntArray:
    """Sides on the box along which the surface's section turns too far."""
    on_box = np.flatnonzero(mesh.side_plane >= 0)
    inside = slope[mesh.side_ends[on_box]]
    inside[np.arange(len(on_box)), :, mesh.side_plane[on_box] // 2] = 0.0
    inside = normalize(inside)
    return on_box[np.einsum("si,si->s", inside[:, 0], inside[:, 1]) < MIN_SECTION_NORMAL_COSINE]


def fit_level_set(
    field: Field,
    tree: Octree,
    mesh: QuadMesh,
    tol: float,
    samples: Array,
    before: LevelSetFit | None = None,
    work: TaskRunner = run_serial,
) -> LevelSetFit:
    """Fit a layout; degrees are raised where patches miss, then what still misses names its leaves.

    `before`: an earlier layer; patches between the same vertices as one of its own that was not wrong are not fitted again.
    """
    net = build_patch_network(mesh, field)
    curve_degree, patch_degree = np.full(len(net.ends), PATCH_DEGREES[0]), np.full(len(net.curve), PATCH_DEGREES[0])
    if before is None:
        net, copies = find_translated_copies(net, field, tree)
        fit = fit_network(net, field, curve_degree, patch_degree, work=work, copies=copies)
        measured = fit_quality.measure_fit(net, fit, field, work=work)
    else:
        same = _drop_failing(match_networks(net, before.net), net, before)
        old_curves, old_patches = same.curve[same.curve >= 0], same.patch[same.patch >= 0]
        known, done = same.curve >= 0, same.patch >= 0
        net, copies = find_translated_copies(net, field, tree, (known, done))
        curves, patches = [np.empty(0)] * len(known), [np.empty(0)] * len(done)
        for i, k in zip(np.flatnonzero(known), old_curves, strict=True):
            curves[i] = before.fit.curves[k]
        for i, k in zip(np.flatnonzero(done), old_patches, strict=True):
            patches[i] = before.fit.patches[k]
        curve_degree[known] = [len(before.fit.curves[k]) - 1 for k in old_curves]
        patch_degree[done] = [min(before.fit.patches[k].shape[:2]) - 1 for k in old_patches]
        curve_degree, patch_degree = curve_degree[copies.curve], patch_degree[copies.patch]
        fit = fit_network(
            net, field, curve_degree, patch_degree, (NetworkFit(curves, patches, copies), ~known, ~done), work
        )
        measured = fit_quality.measure_fit(
            net, fit, field, fit_quality.PreviousQuality(before.measured, ~done, same.patch, same.curve), work
        )
    for degree in PATCH_DEGREES[1:]:
        folded, coarse, rough = _classify_failures(net, fit, measured, tree, tol)
        weak = folded | coarse | rough
        many = weak.mean() > MAX_FAILING_FRACTION
        weak |= _find_patches_at_steep_joints(net, measured)
        if many or not weak.any():
            break
        weak = copies.patches_with_copies(weak)
        patch_degree = np.where(weak, degree, patch_degree)
        raised = np.zeros(len(net.ends), bool)
        raised[net.curve[weak].ravel()] = True
        raised = copies.curves_with_copies(raised)
        curve_degree = np.where(raised, degree, curve_degree)
        raised[net.n_sides :] |= raised[net.middle_of]
        changed = weak | raised[net.curve].any(axis=1)
        fit = fit_network(net, field, curve_degree, patch_degree, (fit, raised, changed), work)
        of_same = fit_quality.PreviousQuality(measured, changed, np.arange(len(net.curve)), np.arange(len(net.ends)))
        measured = fit_quality.measure_fit(net, fit, field, of_same, work)
    folded, coarse, rough = _classify_failures(net, fit, measured, tree, tol)
    wrong, missed = folded | coarse | rough, np.zeros(0)
    leaves = np.unique(net.cell[wrong])
    why = ", ".join(
        f"{np.count_nonzero(m)} {word}"
        for m, word in ((folded, "folded"), (coarse, "too far off"), (rough, "not smooth"))
        if m.any()
    )
    if not len(leaves):
        missed = missed_by(fit, samples, min(tol, 4 * float(measured.of.distance.max())))
        leaves = np.unique(_locate_leaves(tree, samples[missed > tol]))
        why = f"{len(leaves)} parts of the surface missed" if len(leaves) else why
    degenerate = _find_degenerate_leaves(mesh)
    if len(degenerate):
        leaves = np.union1d(leaves, degenerate)
        why = "edges without length, or two between the same vertices" + (f", {why}" if why else "")
    return LevelSetFit(field, tree, mesh, net, fit, measured, wrong, missed, leaves, why)


def split_numbered_leaves(tree: Octree, leaves: IntArray) -> Octree:
    """The tree with the leaves of these numbers split."""
    chosen = np.zeros(len(tree.size), bool)
    chosen[leaves] = True
    return octree.split_leaves(tree, chosen)


def _classify_failures(
    net: PatchNetwork, fit: NetworkFit, measured: fit_quality.FitQuality, tree: Octree, tol: float
) -> tuple[BoolArray, BoolArray, BoolArray]:
    """Patches (Q,) that are folded, too far off or beyond the box, or meet another of the rest with a kink."""
    sections = sample_box_curves(net, fit)
    leaving = measure_overshoot(net, sections, tree) > MAX_OVERSHOOT_FRACTION * tol
    folded = (measured.of.cosine < MIN_NORMAL_COSINE) | find_crossing_curves(net, sections)[net.curve].any(axis=1)
    coarse = (measured.of.distance > tol) | leaving[net.curve].any(axis=1)
    steep = np.zeros(len(net.ends), bool)
    steep[measured.curve[measured.tangent_jump_deg > MAX_TANGENT_JUMP_DEG]] = True
    steep[net.curve[folded | coarse].ravel()] = False  # the kink is theirs, not their neighbours'
    return folded, coarse, np.asarray(steep[net.curve].any(axis=1))


def _drop_failing(same: NetworkMatch, net: PatchNetwork, before: LevelSetFit) -> NetworkMatch:
    """What is kept of an earlier layer without the sides of its wrong patches: with what is round these now they may well pass
    as they are first fitted, and degrees that were raised in vain stay behind."""
    spoilt = np.zeros(len(before.net.ends) + 1, bool)
    spoilt[before.net.curve[before.wrong].ravel()] = True
    curve = np.where(spoilt[same.curve], -1, same.curve)
    on_spoilt = np.flatnonzero(curve[net.middle_of] < 0)
    curve[net.n_sides + on_spoilt] = -1
    return NetworkMatch(curve, np.where((curve[net.curve] < 0).any(axis=1), -1, same.patch))


def _find_patches_at_steep_joints(net: PatchNetwork, measured: fit_quality.FitQuality) -> BoolArray:
    """Patches (Q,) beside the steeper joints, where too many are above the typical."""
    steep = np.zeros(len(net.ends), bool)
    if len(measured.tangent_jump_deg) and np.percentile(measured.tangent_jump_deg, 95) > 0.8 * P95_TANGENT_JUMP_DEG:
        steep[measured.curve[measured.tangent_jump_deg > P95_TANGENT_JUMP_DEG]] = True
    return np.asarray(steep[net.curve].any(axis=1))


def _find_degenerate_leaves(mesh: QuadMesh) -> IntArray:
    """Leaves of the ends of sides that join the same two vertices as another, or have next to no length."""
    ends = np.sort(mesh.side_ends, axis=1)
    _, index, count = np.unique(ends, axis=0, return_inverse=True, return_counts=True)
    length = np.linalg.norm(mesh.vertices[ends[:, 0]] - mesh.vertices[ends[:, 1]], axis=1)
    odd = (count[index.ravel()] > 1) | (length < MIN_SIDE_FRACTION * mesh.size[ends].min(axis=1))
    return np.unique(mesh.cell[ends[odd]])


def _locate_leaves(tree: Octree, points: Array) -> IntArray:
    cell = np.clip(((points - tree.lo) / tree.step).astype(int), 0, tree.shape - 1)
    return tree.leaf[tuple(cell.T)].astype(np.int64)
