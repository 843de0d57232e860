"""What a fit of a level set is worth, measured on it: distances along the field's gradient, normals and joints of every patch.

What the patches of a fit miss: how far points of the level set are from their feet on the patches.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.fields.field import Field
from tpmscad.fields.linear_extension import LinearExtension
from tpmscad.levelset.fit.network_fit import NetworkFit
from tpmscad.levelset.quadmesh.patch_network import PatchNetwork
from tpmscad.parallel import ITEMS_PER_TASK, TaskRunner, run_serial
from tpmscad.splines.basis import bernstein_basis, evaluate_bezier_patches

PATCH_SAMPLES = 13
"""Samples along each parameter of a patch, borders included."""

HALF_SIDE_SAMPLES = 17
"""Samples along half a side: joints are measured half by half, so that a side meets the two beyond a T-vertex."""


@dataclass(frozen=True, slots=True, eq=False)
class PatchSamples:
    """Patches sampled: greatest and mean square distance (Q,), least cosine of the normal with the gradient (Q,), where the
    distance is greatest (Q, 3), and along their sides normals and curvature tensors: those of patch q are normals[row[q]], of
    (R, 4, m, 3), and bends[row[q]], of (R, 4, m, 3, 3); copies share theirs.
    """

    distance: Array
    square: Array
    cosine: Array
    where: Array
    row: IntArray
    normals: Array
    bends: Array


@dataclass(frozen=True, slots=True, eq=False)
class FitQuality:
    """What each patch is worth, and per half side (n,) of the net's curves, `half` of them being twice the curve and 0 or 1,
    rising: tangent jump in degrees, curvature jump and greatest curvature.
    """

    of: PatchSamples
    half: IntArray
    tangent_jump_deg: Array
    bend: Array
    curvature: Array

    @property
    def curve(self) -> IntArray:
        return self.half // 2


@dataclass(frozen=True, slots=True, eq=False)
class PreviousQuality:
    """Measures of an earlier net: which of its patches and curves each of a net's is, (Q,) and (C,), -1 for none, and which
    patches have changed, those that were none among them."""

    measured: FitQuality
    changed: BoolArray
    patch: IntArray
    curve: IntArray


def measure_fit(
    net: PatchNetwork,
    fit: NetworkFit,
    field: Field,
    before: PreviousQuality | None = None,
    work: TaskRunner = run_serial,
) -> FitQuality:
    """Measure every patch and every joint inside the box; what is known from `before` is not measured again."""
    own, copies = np.flatnonzero(fit.copies.original_patches), fit.copies
    row = np.searchsorted(own, copies.patch)
    m, count = 2 * HALF_SIDE_SAMPLES - 1, len(own)
    of = PatchSamples(
        distance=np.empty(count),
        square=np.empty(count),
        cosine=np.empty(count),
        where=np.empty((count, 3)),
        row=np.arange(count),
        normals=np.empty((count, 4, m, 3)),
        bends=np.empty((count, 4, m, 3, 3)),
    )
    wanted = own
    if before is not None:
        old = np.flatnonzero(~before.changed[own])
        known, patch = before.measured.of, before.patch[own[old]]
        for array, values in zip(_per_patch_arrays(of), _per_patch_arrays(known), strict=True):
            array[old] = values[patch]
        of.normals[old], of.bends[old] = known.normals[known.row[patch]], known.bends[known.row[patch]]
        wanted = own[before.changed[own]]
    parts = [
        at[i : i + ITEMS_PER_TASK] for _, at in group_by_degree(fit, wanted) for i in range(0, len(at), ITEMS_PER_TASK)
    ]
    done = work(sample_patches, [(field, np.stack([fit.patches[i] for i in part])) for part in parts])
    for part, found in zip(parts, done, strict=True):
        for array, values in zip(
            (*_per_patch_arrays(of), of.normals, of.bends),
            (*_per_patch_arrays(found), found.normals, found.bends),
            strict=True,
        ):
            array[row[part]] = values
    of = PatchSamples(
        of.distance[row], of.square[row], of.cosine[row], of.where[row] + copies.patch_shift, row, of.normals, of.bends
    )
    return FitQuality(of, *_measure_joints(net, of, before))


def _per_patch_arrays(of: PatchSamples) -> tuple[Array, ...]:
    return of.distance, of.square, of.cosine, of.where


def sample_patches(field: Field, poles: Array) -> PatchSamples:
    """Measures of patches of one degree, poles (n, p + 1, q + 1, 3)."""
    t = np.linspace(0.0, 1.0, PATCH_SAMPLES)
    p, q = poles.shape[1] - 1, poles.shape[2] - 1
    bu, bv, du, dv = bernstein_basis(p, t), bernstein_basis(q, t), bernstein_basis(p, t, 1), bernstein_basis(q, t, 1)
    points = evaluate_bezier_patches(bu, poles, bv)
    normal = np.cross(evaluate_bezier_patches(du, poles, bv), evaluate_bezier_patches(bu, poles, dv))
    value, slope = field.value_and_gradient(points)
    steep = np.linalg.norm(slope, axis=-1)
    d = np.abs(value) / np.maximum(steep, 1e-300)
    if isinstance(field, LinearExtension):
        # beyond the box there is no solid: borders that leave it between their ends are off by as much
        d += np.maximum(np.maximum(field.lo - points, points - field.hi).max(axis=-1), 0.0)
    length = np.linalg.norm(normal, axis=-1) * steep
    sides = [_evaluate_side(poles, s) for s in range(4)]
    return PatchSamples(
        distance=d.max(axis=1),
        square=(d**2).mean(axis=1),
        cosine=(np.einsum("nki,nki->nk", normal, slope) / np.maximum(length, 1e-300)).min(axis=1),
        where=points[np.arange(len(poles)), d.argmax(axis=1)],
        row=np.arange(len(poles)),
        normals=np.stack([n for n, _ in sides], axis=1),
        bends=np.stack([b for _, b in sides], axis=1),
    )


def group_by_degree(fit: NetworkFit, patches: IntArray | None = None) -> list[tuple[tuple[int, int], IntArray]]:
    """The degrees that occur among the patches (all of the fit's if None), each with the patches that have them."""
    of = np.arange(len(fit.patches)) if patches is None else patches
    each = np.array([fit.patches[i].shape[:2] for i in of]) - 1
    return [((int(p), int(q)), of[(each == (p, q)).all(axis=1)]) for p, q in np.unique(each, axis=0)]


def _evaluate_side(poles: Array, side: int) -> tuple[Array, Array]:
    """Unit normals (n, m, 3) and curvature tensors (n, m, 3, 3) along a side, run counter-clockwise."""
    t = np.linspace(0.0, 1.0, 2 * HALF_SIDE_SAMPLES - 1)
    end = np.array([1.0 if side in (1, 2) else 0.0])
    u, v = (t, end) if side in (0, 2) else (end, t)
    p, q = poles.shape[1] - 1, poles.shape[2] - 1
    d = {
        (i, j): evaluate_bezier_patches(bernstein_basis(p, u, i), poles, bernstein_basis(q, v, j))
        for i, j in ((1, 0), (0, 1), (2, 0), (1, 1), (0, 2))
    }  # fmt: skip
    normal = np.cross(d[1, 0], d[0, 1])
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-300)
    tangents = np.stack([d[1, 0], d[0, 1]], axis=-1)
    first = np.swapaxes(tangents, -1, -2) @ tangents
    dual = tangents @ _invert_symmetric_2x2(first)
    second = np.empty(first.shape)
    for (i, j), key in (((0, 0), (2, 0)), ((0, 1), (1, 1)), ((1, 0), (1, 1)), ((1, 1), (0, 2))):
        second[..., i, j] = np.einsum("nmi,nmi->nm", d[key], normal)
    bend = dual @ second @ np.swapaxes(dual, -1, -2)
    return (normal, bend) if side in (0, 1) else (normal[:, ::-1], bend[:, ::-1])


def _invert_symmetric_2x2(first: Array) -> Array:
    """Inverses of symmetric 2 x 2 matrices, large but finite where there is none: folded patches are measured, too."""
    a, b, c = first[..., 0, 0], first[..., 0, 1], first[..., 1, 1]
    adjugate = np.stack([np.stack([c, -b], axis=-1), np.stack([-b, a], axis=-1)], axis=-2)
    return adjugate / np.maximum(a * c - b * b, 1e-12 * (a + c) ** 2 + 1e-100)[..., None, None]


SIDE_SLICES = (slice(None, HALF_SIDE_SAMPLES), slice(HALF_SIDE_SAMPLES - 1, None), slice(None, None, 2))
"""Of a side's samples: either half, or all of a side that is half of a curve."""

JOINTS_PER_BATCH = 4096
"""Joints measured at once: 70 MB."""


def _measure_joints(
    net: PatchNetwork, of: PatchSamples, before: PreviousQuality | None
) -> tuple[IntArray, Array, Array, Array]:
    """Jumps across the half sides that two patches share; those between copies of the same two sides are measured once."""
    keys, sides, patches = [], [], []
    for piece in (0, 1, 2):
        q, s = np.nonzero(net.piece == piece)
        for half, part in ((0, 0), (1, 1)) if piece == 0 else ((piece - 1, 2),):
            keys.append(2 * net.curve[q, s] + half)
            patches.append(q)
            sides.append(np.column_stack([of.row[q], s, net.sense[q, s] < 0, np.full(len(q), part)]))
    key, side = np.concatenate(keys), np.concatenate(sides)
    order = np.argsort(key, kind="stable")
    pair = np.flatnonzero(key[order][:-1] == key[order][1:])
    a, b = order[pair], order[pair + 1]
    halves, joints = key[a], np.empty((3, len(a)))
    new = np.ones(len(a), bool)
    if before is not None:
        patch, curve = np.concatenate(patches), before.curve[halves // 2]
        new = before.changed[patch[a]] | before.changed[patch[b]] | (curve < 0)
        known = np.searchsorted(before.measured.half, 2 * curve[~new] + halves[~new] % 2)
        joints[:, ~new] = [
            m[known] for m in (before.measured.tangent_jump_deg, before.measured.bend, before.measured.curvature)
        ]
        a, b = a[new], b[new]
    distinct, index = np.unique(np.column_stack([side[a], side[b]]), axis=0, return_inverse=True)
    found = np.empty((3, len(distinct)))
    for start in range(0, len(distinct), JOINTS_PER_BATCH):
        rows = distinct[start : start + JOINTS_PER_BATCH]
        one, other = (_gather_side_samples(of, rows[:, k : k + 4]) for k in (0, 4))
        sine = np.linalg.norm(np.cross(one[0], other[0]), axis=-1)
        angle = np.arctan2(sine, np.einsum("nmi,nmi->nm", one[0], other[0]))
        size = np.maximum(*(np.linalg.norm(k, axis=(-2, -1)) for k in (one[1], other[1])))
        found[:, start : start + JOINTS_PER_BATCH] = (
            np.degrees(angle).max(axis=1),
            np.linalg.norm(one[1] - other[1], axis=(-2, -1)).max(axis=1),
            size.max(axis=1),
        )
    joints[:, new] = found[:, index.ravel()]
    return halves, *joints


def _gather_side_samples(of: PatchSamples, sides: IntArray) -> tuple[Array, Array]:
    """Normals (n, m, 3) and curvature tensors (n, m, 3, 3) along parts of sides: rows (row, side, whether run back, part)."""
    n, k = np.empty((len(sides), HALF_SIDE_SAMPLES, 3)), np.empty((len(sides), HALF_SIDE_SAMPLES, 3, 3))
    for back in (0, 1):
        for part, samples in enumerate(SIDE_SLICES):
            at = np.flatnonzero((sides[:, 2] == back) & (sides[:, 3] == part))
            row, side = sides[at, 0], sides[at, 1]
            for array, values in ((n, of.normals), (k, of.bends)):
                found = values[row, side]
                array[at] = (found[:, ::-1] if back else found)[:, samples]
    return n, k


FOOT_POINT_STEPS = 6
"""Newton steps of a foot on a patch."""

NEAREST_SAMPLES = (3, 24)
"""Samples from whose patches the nearest foot is taken, and for points that miss with them: near a side that runs askew the
nearest samples may all be of patches beyond it."""


def measure_distances_to_patches(fit: NetworkFit, points: Array, tol: float) -> Array:
    """Distances (n,) from points of the level set to their feet on the patches; those above half of tol with more care."""
    t = np.linspace(0.0, 1.0, PATCH_SAMPLES)
    samples, owner = [], []
    for (p, q), at in group_by_degree(fit):
        samples.append(
            evaluate_bezier_patches(
                bernstein_basis(p, t), np.stack([fit.patches[i] for i in at]), bernstein_basis(q, t)
            ).reshape(-1, 3)
        )
        owner.append(np.repeat(at, PATCH_SAMPLES**2))
    patch = np.concatenate(owner)
    u, v = (np.tile(g.ravel(), len(fit.patches)) for g in np.meshgrid(t, t, indexing="ij"))
    tree = cKDTree(np.concatenate(samples))
    best = np.full(len(points), np.inf)
    for count in NEAREST_SAMPLES:
        chosen = np.flatnonzero(best > 0.5 * tol)
        if not len(chosen):
            break
        _, near = tree.query(points[chosen], k=count)
        for k in range(count):
            i = near[:, k]
            for (p, q), at in group_by_degree(fit):
                rows = np.flatnonzero(np.isin(patch[i], at))
                if len(rows):
                    poles = np.stack([fit.patches[j] for j in at])[np.searchsorted(at, patch[i[rows]])]
                    distance = _foot_point_distances(poles, points[chosen[rows]], u[i[rows]], v[i[rows]], p, q)
                    best[chosen[rows]] = np.minimum(best[chosen[rows]], distance)
    return best


def _foot_point_distances(poles: Array, points: Array, u: Array, v: Array, p: int, q: int) -> Array:
    """Distances from points to patches, one each, from starting parameters: feet kept on the patches."""
    for _ in range(FOOT_POINT_STEPS):
        bu, bv, du, dv = (
            bernstein_basis(p, u),
            bernstein_basis(q, v),
            bernstein_basis(p, u, 1),
            bernstein_basis(q, v, 1),
        )
        across = np.einsum("nijx,nj->nix", poles, bv)
        residual = points - np.einsum("ni,nix->nx", bu, across)
        xu, xv = np.einsum("ni,nix->nx", du, across), np.einsum("ni,nijx,nj->nx", bu, poles, dv, optimize=True)
        a, b, c = (np.einsum("nx,nx->n", f, g) for f, g in ((xu, xu), (xu, xv), (xv, xv)))
        ru, rv = np.einsum("nx,nx->n", xu, residual), np.einsum("nx,nx->n", xv, residual)
        determinant = np.maximum(a * c - b * b, 1e-300)
        step_u, step_v = (c * ru - b * rv) / determinant, (a * rv - b * ru) / determinant
        stuck_u, stuck_v = (u + step_u < 0) | (u + step_u > 1), (v + step_v < 0) | (v + step_v > 1)
        step_v, step_u = np.where(stuck_u, rv / c, step_v), np.where(stuck_v, ru / a, step_u)
        u, v = np.clip(u + step_u, 0, 1), np.clip(v + step_v, 0, 1)
    foot = np.einsum("ni,nijx,nj->nx", bernstein_basis(p, u), poles, bernstein_basis(q, v), optimize=True)
    return np.linalg.norm(points - foot, axis=1)
