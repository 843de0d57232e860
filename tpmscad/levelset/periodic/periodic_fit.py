"""Bezier patches of a periodic level set, or of its normal offset: one patch of each orbit, fitted and measured.

The patches lie over the polygons of a `PeriodicMesh`. All curves and patches have one degree, the lowest at which every patch is
within the tolerance. Curves, the normals along them, and patches that an isometry maps to themselves are given that symmetry to
the last bits, so that copies meet to round-off. Conditions of tangent continuity (`fit.joint_normals`) hold for means of patches
that meet them, and the isometries keep the gradient's side, so that a normal moves with its curve.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.brep.deviation import Deviation
from tpmscad.fields.field import Field
from tpmscad.fields.kinds.normal_distance import NormalDistance
from tpmscad.levelset.fit.fit_quality import PatchSamples, sample_patches
from tpmscad.levelset.fit.joint_normals import EndShapes, fit_normals, measure_second_forms
from tpmscad.levelset.fit.network_curves import fit_curves
from tpmscad.levelset.fit.network_fit import fit_patches
from tpmscad.levelset.fit.patch_samples import foot_point_distances, least_foot_distances
from tpmscad.levelset.periodic.periodic_mesh import PeriodicMesh, periodic_tree, wrap_into_period
from tpmscad.levelset.quadmesh.vectors import normalize
from tpmscad.rigid_motion import Motion
from tpmscad.splines.basis import bernstein_basis, evaluate_bezier_patches

DEGREES = (5, 6, 7, 8, 9, 10, 11, 12)
"""Candidate degrees. Beyond 12 the normal equations of the fit lose the digits that smooth joints need."""

MAX_TANGENT_JUMP_DEG = 0.01
"""Greatest angle between the normals of two patches along their common side, which the fit makes zero but for round-off."""

MIN_NORMAL_COSINE = 0.95
"""Least cosine of the angle between a patch's normal and that of the level set: above it no patch folds."""

SAMPLES_PER_SIDE = 7
NEAREST_PATCHES = (4, 24)
"""Samples along each parameter of the patches, and the numbers of those nearest to a point from which its foot point is sought,
first try and retry."""

SAME_PLACE_TOL = 1e-6
"""Distance, in the least period, within which images of a curve or patch by isometries are the same one, and relative difference
of the squares of their lengths: far above the round-off of a fit, far below a side."""


@dataclass(frozen=True, slots=True, eq=False)
class PeriodicFit:
    """Patches over the representatives of a mesh: poles (P, p + 1, p + 1, 3), with their measured quality.

    `deviation` is that from the level set in both directions; `tangent_jump_deg` (n,) the greatest angle along each side of the
    representatives, `min_normal_cosine` that of any patch. `met` says whether all limits hold.
    """

    mesh: PeriodicMesh
    poles: Array
    deviation: Deviation
    tangent_jump_deg: Array
    min_normal_cosine: float
    met: bool

    @property
    def degree(self) -> int:
        """Degree of the patches along both parameters."""
        return self.poles.shape[1] - 1


@dataclass(frozen=True, slots=True, eq=False)
class _Sides:
    """The sides of all polygons, reduced to one curve for each orbit.

    `start`, `step` (C, 3): positions of the ends of a curve, the second relative to the first. Side i of polygon q is the curve
    curve[q, i] moved by motion[q][i]; `sense` (Q, 4) is -1 where it runs against the curve.
    """

    ends: Array
    curve: IntArray
    motion: Motion
    sense: IntArray


def fit_periodic_patches(
    field: Field, mesh: PeriodicMesh, isometries: Motion, offset: float, samples: Array, tol: float
) -> PeriodicFit:
    """The patches of the surface at the normal `offset` from {field = 0}, with the lowest degree that meets `tol`.

    `samples` (n, 3) are points of {field = 0} at which the patches are tested too. Where no degree meets the limits the best fit
    is returned, one that does not fold if there is any: compare `met`.
    """
    distance = NormalDistance(field) - offset
    sides = _reduce_sides(mesh, isometries)
    best: PeriodicFit | None = None
    for degree in DEGREES:
        poles = _fit_poles(distance, field, mesh, isometries, sides, offset, degree)
        fit = _measure(distance, field, mesh, sides, poles, offset, samples, tol)
        if best is None or is_better_fit(fit, best):
            best = fit
        if fit.met:
            break
    assert best is not None
    return best


def is_better_fit(fit: PeriodicFit, other: PeriodicFit) -> bool:
    """Whether a fit is better than another: it alone meets the limits, or alone has no fold, or else deviates less."""

    def rank(of: PeriodicFit) -> tuple[bool, bool, float]:
        return not of.met, of.min_normal_cosine < MIN_NORMAL_COSINE, of.deviation.max

    return rank(fit) < rank(other)


def offset_points(field: Field, points: Array, offset: float) -> Array:
    """Points (..., 3) of {field = 0} moved along the unit normal."""
    return np.asarray(points + offset * normalize(field.gradient(points)))


def _reduce_sides(mesh: PeriodicMesh, isometries: Motion) -> _Sides:
    """One curve for each orbit of sides, found by the middles of the sides' chords and the direction of the sides."""
    polygons = np.arange(len(mesh.corners))
    points = mesh.corner_points(polygons)
    after = np.roll(points, -1, axis=1)
    middle, chord = (points + after).reshape(-1, 3) / 2, (after - points).reshape(-1, 3)
    period = mesh.period
    tree = periodic_tree(middle, period)
    tolerance = SAME_PLACE_TOL * float(period.min())
    n = len(middle)
    curve, sense = np.full(n, -1), np.zeros(n, np.int64)
    rotation, translation = np.zeros((n, 3, 3)), np.zeros((n, 3))
    representative = np.repeat(np.isin(polygons, mesh.representatives), 4)
    ends: list[Array] = []
    for k in np.flatnonzero(representative):
        if curve[k] >= 0:
            continue
        images = isometries.apply(middle[k])
        found = tree.query_ball_point(wrap_into_period(images, period), tolerance)
        directions = isometries.apply_to_vectors(chord[k])
        for g, hits in enumerate(found):
            for j in hits:
                if curve[j] >= 0:
                    continue
                along = float(directions[g] @ chord[j])
                if abs(abs(along) - float(chord[k] @ chord[k])) > SAME_PLACE_TOL * float(chord[k] @ chord[k]):
                    continue
                curve[j], sense[j] = len(ends), 1 if along > 0 else -1
                rotation[j] = isometries.rotation[g]
                shift = np.rint((middle[j] - images[g]) / period) * period
                translation[j] = isometries.translation[g] + shift
        ends.append(np.stack([points.reshape(-1, 3)[k], after.reshape(-1, 3)[k]]))
    return _Sides(
        np.array(ends),
        curve.reshape(-1, 4),
        Motion(rotation.reshape(-1, 4, 3, 3), translation.reshape(-1, 4, 3)),
        sense.reshape(-1, 4),
    )


def _fit_poles(
    distance: Field, field: Field, mesh: PeriodicMesh, isometries: Motion, sides: _Sides, offset: float, degree: int
) -> Array:
    """Poles of the patches over the representatives of the mesh."""
    ends = offset_points(field, sides.ends, offset)
    free = np.zeros((len(ends), 3), bool)
    shapes = EndShapes(*measure_second_forms(distance, ends, float(mesh.period.max())))
    curves = fit_curves(distance, ends[:, 0], ends[:, 1], free, degree, shapes)
    curves, _ = _symmetrise_curves(curves, curves, isometries, mesh.period)
    curves, normals = _symmetrise_curves(curves, fit_normals(distance, curves, shapes), isometries, mesh.period)
    chosen = mesh.representatives
    border, along = [], []
    for i in range(4):
        motion, curve = sides.motion[chosen, i][:, None], sides.curve[chosen, i]
        forwards = sides.sense[chosen, i, None, None] > 0
        poles, vectors = motion.apply(curves[curve]), motion.apply_to_vectors(normals[curve])
        border.append(np.where(forwards, poles, poles[:, ::-1]))
        along.append(np.where(forwards, vectors, vectors[:, ::-1]))
    patches = fit_patches(distance, border, along)
    return _symmetrise_patches(patches, isometries, mesh.period)


def _symmetrise_curves(curves: Array, normals: Array, isometries: Motion, period: Array) -> tuple[Array, Array]:
    """Curves and normals along them (C, p + 1, 3) averaged over the isometries that map a curve to itself, either way round."""
    tolerance = SAME_PLACE_TOL * float(period.min())
    result = np.zeros((2, *curves.shape))
    for k, (poles, vectors) in enumerate(zip(curves, normals, strict=True)):
        count = 0
        for step in (1, -1):
            images = isometries[:, None].apply(poles[::step])
            shift = np.rint((poles[[0, -1]].mean(axis=0) - images[:, [0, -1]].mean(axis=1)) / period) * period
            images = images + shift[:, None]
            same = np.abs(images[:, [0, -1]] - poles[[0, -1]]).max(axis=(1, 2)) < tolerance
            same &= np.abs(images - poles).max(axis=(1, 2)) < 1e3 * tolerance
            turned = isometries[:, None].apply_to_vectors(vectors[::step])
            result[:, k] += images[same].sum(axis=0), turned[same].sum(axis=0)
            count += int(same.sum())
        result[:, k] /= count
    return result[0], result[1]


def _symmetrise_patches(patches: Array, isometries: Motion, period: Array) -> Array:
    """Patches (P, p + 1, p + 1, 3) averaged over the isometries that map them to themselves."""
    tolerance = SAME_PLACE_TOL * float(period.min())
    corner = ([0, -1, -1, 0], [0, 0, -1, -1])
    result = np.zeros(patches.shape)
    for k, poles in enumerate(patches):
        count = 0
        for transposed in (poles, poles.transpose(1, 0, 2)):
            for candidate in (
                transposed,
                transposed[::-1],
                transposed[:, ::-1],
                transposed[::-1, ::-1],
            ):
                images = isometries[:, None, None].apply(candidate)
                ends = images[:, corner[0], corner[1]]
                shift = np.rint((poles[corner].mean(axis=0) - ends.mean(axis=1)) / period) * period
                same = np.abs(ends + shift[:, None] - poles[corner]).max(axis=(1, 2)) < tolerance
                result[k] += (images[same] + shift[same, None, None]).sum(axis=0)
                count += int(same.sum())
        result[k] /= count
    return result


def _measure(
    distance: Field,
    field: Field,
    mesh: PeriodicMesh,
    sides: _Sides,
    poles: Array,
    offset: float,
    samples: Array,
    tol: float,
) -> PeriodicFit:
    """The fit of these poles with its quality."""
    quality = sample_patches(distance, poles)
    jump = _tangent_jumps(mesh, sides, quality)
    to_patches = distances_to_copies(mesh, poles, offset_points(field, samples, offset), tol)
    forth, back = float(quality.distance.max()), float(to_patches.max(initial=0.0))
    cosine = float(quality.min_normal_cosine.min())
    met = bool(max(forth, back) <= tol and cosine >= MIN_NORMAL_COSINE and jump.max() <= MAX_TANGENT_JUMP_DEG)
    rms = float(np.sqrt(quality.mean_square_distance.mean()))
    return PeriodicFit(mesh, poles, Deviation(max(forth, back), rms, forth, back), jump, cosine, met)


def _tangent_jumps(mesh: PeriodicMesh, sides: _Sides, quality: PatchSamples) -> Array:
    """Greatest angle in degrees (n,) between the normals along every side of the representatives."""
    row, motion, tolerance = mesh.representative_row, mesh.polygon_motion, SAME_PLACE_TOL * float(mesh.period.min())
    pairs = periodic_tree(mesh.side_middles(), mesh.period).query_pairs(tolerance, output_type="ndarray")
    pairs = pairs[np.isin(pairs // 4, mesh.representatives).any(axis=1)]
    # normals along all sides in the frame of the side's curve, so that the two uses of a side compare
    normals = []
    for side in pairs.T:
        q, i = side // 4, side % 4
        n = motion[q][:, None].apply_to_vectors(quality.side_normals[row[q], i])
        n *= motion[q].handedness[:, None, None]
        normals.append(np.where(sides.sense[q, i, None, None] > 0, n, n[:, ::-1]))
    forward = np.einsum("nmi,nmi->nm", *normals)
    backward = np.einsum("nmi,nmi->nm", normals[0], normals[1][:, ::-1])
    # the two uses run along the same curve, whose sense is stated for each
    cosine = np.abs(np.where((np.abs(forward).min(1) >= np.abs(backward).min(1))[:, None], forward, backward))
    return np.asarray(np.degrees(np.arccos(np.minimum(cosine, 1.0))).max(axis=1))


def distances_to_copies(mesh: PeriodicMesh, poles: Array, points: Array, tol: float) -> Array:
    """Distances (n,) from points (n, 3) to the nearest of all copies of the patches, exact where they are below half of `tol`."""
    period = mesh.period
    t = np.linspace(0.0, 1.0, SAMPLES_PER_SIDE)
    degree = poles.shape[1] - 1
    basis = bernstein_basis(degree, t)
    grid = evaluate_bezier_patches(basis, poles, basis)
    row = mesh.representative_row
    flat = mesh.polygon_motion[:, None].apply(grid[row]).reshape(-1, 3)
    tree, wrapped = periodic_tree(flat, period), wrap_into_period(points, period)
    u, v = (g.ravel() for g in np.meshgrid(t, t, indexing="ij"))

    def measure(chosen: IntArray, at: IntArray) -> Array:
        polygon, sample = at // len(u), at % len(u)
        near = points[chosen] - np.rint((points[chosen] - flat[at]) / period) * period
        local = mesh.polygon_motion[polygon].apply_inverse(near)
        return foot_point_distances(poles, row[polygon], local, u[sample], v[sample])

    def nearest(chosen: IntArray, k: int) -> IntArray:
        return np.asarray(tree.query(wrapped[chosen], k=k)[1])

    return least_foot_distances(len(points), tol, NEAREST_PATCHES, nearest, measure)
