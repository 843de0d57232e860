"""Measured quality of a fit: its distance from the level set in both directions, folds, and continuity across curves.

- From the patches to the level set: |f| / |grad f|, the distance to first order, on a grid of samples of every patch.
- From the level set to the patches: the distance of samples of the level set from their foot points (orthogonal projections).
- Folds: the least cosine of the angle between a patch's normal and the gradient.
- Joints: along every half of a curve that two patches share, the largest angle between their normals. The curvatures there, which
  decide nothing, are measured once on the fit that is kept (`measure_curvature_jump`).

Copies share the measurements of their originals. What a previous quality holds of unchanged patches and joints is reused.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.spatial import cKDTree

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.fields.field import Field
from tpmscad.fields.kinds.linear_extension import LinearExtension
from tpmscad.levelset.fit.network_fit import ITEMS_PER_TASK, NetworkFit
from tpmscad.levelset.fit.patch_samples import (
    evaluate_points_and_normals,
    foot_point_distances,
    least_foot_distances,
    measure_samples,
)
from tpmscad.levelset.quadmesh.patch_network import WHOLE, PatchNetwork
from tpmscad.levelset.quadmesh.vectors import MIN_DIVISOR
from tpmscad.parallel import TaskRunner, run_serial, split_batches
from tpmscad.splines.basis import bernstein_basis, evaluate_bezier_patches

PATCH_SAMPLES = 13
"""Samples along each parameter of a patch, the sides included."""

HALF_SIDE_SAMPLES = 17
"""Samples along half a side. Joints are measured by halves, since a side may meet two others beyond a T-vertex."""

SIDE_PARTS = (slice(None, HALF_SIDE_SAMPLES), slice(HALF_SIDE_SAMPLES - 1, None), slice(None, None, 2))
"""Samples of a side that lie on half a curve: its first half, its second half, or all of a side that is half a curve itself."""
FIRST_PART, SECOND_PART, WHOLE_SIDE = 0, 1, 2

JOINTS_PER_BATCH = 4096
"""Joints measured at once, which takes 70 MB."""

NEAREST_SAMPLES = (3, 24)
"""Number of nearest patch samples used as starts of the projection, first try and retry. Near an oblique patch side the nearest
samples may all belong to the neighbouring patch."""

TREE_LEAF_SAMPLES = 32
"""Patch samples in a leaf of the tree in which the nearest ones are found."""


@dataclass(frozen=True, slots=True, eq=False)
class PatchSamples:
    """Measurements of R patches.

    `distance`, `mean_square_distance`, `min_normal_cosine` (R,): largest and mean square distance from the level set, and least
    cosine of the normal with the gradient. `side_normals` (R, 4, m, 3): unit normals along the sides, counter-clockwise.
    """

    distance: Array
    mean_square_distance: Array
    min_normal_cosine: Array
    side_normals: Array

    def arrays(self) -> tuple[Array, ...]:
        """All arrays, in the order of the fields."""
        return self.distance, self.mean_square_distance, self.min_normal_cosine, self.side_normals


@dataclass(frozen=True, slots=True, eq=False)
class FitQuality:
    """Quality of all Q patches and n joints of a network.

    `samples` holds the measurements of the originals, `row` (Q,) which of them is each patch's. `half_curve` (n,), rising, is the
    half of a curve that a joint lies on: 2 * curve, + 1 for the second half; `tangent_jump_deg` (n,) is the largest tangent jump
    along it.
    """

    samples: PatchSamples
    row: IntArray
    half_curve: IntArray
    tangent_jump_deg: Array

    @property
    def curve(self) -> IntArray:
        """The curve (n,) of each joint."""
        return self.half_curve // 2

    @property
    def distance(self) -> Array:
        """Largest distance (Q,) of each patch from the level set."""
        return self.samples.distance[self.row]

    @property
    def mean_square_distance(self) -> Array:
        """Mean square distance (Q,) of each patch from the level set."""
        return self.samples.mean_square_distance[self.row]

    @property
    def min_normal_cosine(self) -> Array:
        """Least cosine (Q,) of the angle between each patch's normal and the gradient."""
        return self.samples.min_normal_cosine[self.row]


@dataclass(frozen=True, slots=True, eq=False)
class PreviousQuality:
    """Quality of a previous network, and the `patch` (Q,) and `curve` (C,) of it that each of a network's is, -1 for none.

    `changed` (Q,) marks the patches to be measured again, among them all that are -1.
    """

    quality: FitQuality
    changed: BoolArray
    patch: IntArray
    curve: IntArray


@dataclass(frozen=True, slots=True, eq=False)
class Joints:
    """Joints (n,) by rising `half_curve`, with the two patches (n, 2) and the two sides (n, 8) that meet there.

    A side is four numbers: row of the samples, side, whether it runs against the curve, part of the side.
    """

    half_curve: IntArray
    patches: IntArray
    sides: IntArray


def measure_fit(
    network: PatchNetwork,
    fit: NetworkFit,
    field: Field,
    previous: PreviousQuality | None = None,
    run_tasks: TaskRunner = run_serial,
) -> FitQuality:
    """Measure every patch, and every joint inside the box, except those known from a previous quality."""
    originals = np.flatnonzero(fit.copies.original_patches)
    row = np.searchsorted(originals, fit.copies.patch)
    samples, numbers = _empty_samples(len(originals)), originals
    if previous is not None:
        known, kept = previous.quality, np.flatnonzero(~previous.changed[originals])
        known_rows = known.row[previous.patch[originals[kept]]]
        for array, values in zip(samples.arrays(), known.samples.arrays(), strict=True):
            array[kept] = values[known_rows]
        numbers = originals[previous.changed[originals]]
    batches = [batch for _, group in group_by_degree(fit, numbers) for batch in split_batches(group, ITEMS_PER_TASK)]
    measured = run_tasks(sample_patches, [(field, np.stack([fit.patches[i] for i in batch])) for batch in batches])
    for batch, found in zip(batches, measured, strict=True):
        for array, values in zip(samples.arrays(), found.arrays(), strict=True):
            array[row[batch]] = values
    joints = find_joints(network, row)
    return FitQuality(samples, row, joints.half_curve, _measure_tangent_jumps(joints, samples, previous))


def sample_patches(field: Field, poles: Array) -> PatchSamples:
    """Measurements of patches of one degree, poles (n, p + 1, q + 1, 3)."""
    p, q = poles.shape[1] - 1, poles.shape[2] - 1
    points, normals = evaluate_points_and_normals(
        poles, _sample_basis(p, PATCH_SAMPLES), _sample_basis(q, PATCH_SAMPLES)
    )
    value, gradient = field.value_and_gradient(points)
    box = np.full(3, -np.inf), np.full(3, np.inf)
    if isinstance(field, LinearExtension):  # the solid ends at the box: a side that bulges out of it is off by as much
        box = np.array(field.lo), np.array(field.hi)
    side_normals = np.stack([_normals_along_side(poles, side) for side in range(4)], axis=1)
    distance, mean_square, cosine = measure_samples(points, normals, value, gradient, *box)
    return PatchSamples(distance, mean_square, cosine, side_normals)


@lru_cache(maxsize=32)
def _sample_basis(degree: int, count: int) -> tuple[Array, Array]:
    """Bernstein polynomials and their derivatives, (count, degree + 1) each, at uniform parameters."""
    t = np.linspace(0.0, 1.0, count)
    return bernstein_basis(degree, t), bernstein_basis(degree, t, 1)


def group_by_degree(fit: NetworkFit, patches: IntArray | None = None) -> list[tuple[tuple[int, int], IntArray]]:
    """Pairs of degrees that occur among the patches (all of the fit's if None), each with the patches that have them."""
    numbers = np.arange(len(fit.patches)) if patches is None else patches
    degrees = np.array([fit.patches[i].shape[:2] for i in numbers]) - 1
    return [((int(p), int(q)), numbers[(degrees == (p, q)).all(axis=1)]) for p, q in np.unique(degrees, axis=0)]


def measure_distances_to_patches(fit: NetworkFit, points: Array, tol: float, limit: float) -> tuple[Array, IntArray]:
    """Distances (n,) from points of the level set to the patches, exact where they are below half of `tol`.

    And of the points that are farther than `limit` the patches nearest to them.
    """
    t = np.linspace(0.0, 1.0, PATCH_SAMPLES)
    groups = group_by_degree(fit)
    poles_of_group = [np.stack([fit.patches[i] for i in numbers]) for _, numbers in groups]
    group, row = np.empty((2, len(fit.patches)), np.int64)
    samples, owner = [], []
    for k, (((p, q), numbers), poles) in enumerate(zip(groups, poles_of_group, strict=True)):
        group[numbers], row[numbers] = k, np.arange(len(numbers))
        samples.append(evaluate_bezier_patches(bernstein_basis(p, t), poles, bernstein_basis(q, t)).reshape(-1, 3))
        owner.append(np.repeat(numbers, PATCH_SAMPLES**2))
    patch = np.concatenate(owner)
    u, v = (np.tile(g.ravel(), len(fit.patches)) for g in np.meshgrid(t, t, indexing="ij"))
    # the samples are searched once: a tree that is built three times faster is worth more than one that is searched faster
    tree = cKDTree(np.concatenate(samples), leafsize=TREE_LEAF_SAMPLES, compact_nodes=False, balanced_tree=False)

    def measure(chosen: IntArray, start: IntArray) -> Array:
        distance = np.empty(len(chosen))
        for k, poles in enumerate(poles_of_group):
            rows = np.flatnonzero(group[patch[start]] == k)
            at = start[rows]
            distance[rows] = foot_point_distances(poles, row[patch[at]], points[chosen[rows]], u[at], v[at])
        return distance

    def nearest(chosen: IntArray, k: int) -> IntArray:
        return np.asarray(tree.query(points[chosen], k=k)[1], np.int64)

    distances = least_foot_distances(len(points), tol, NEAREST_SAMPLES, nearest, measure)
    missed = np.flatnonzero(distances > limit)
    return distances, np.unique(patch[nearest(missed, 1).ravel()])


def _empty_samples(count: int) -> PatchSamples:
    m = 2 * HALF_SIDE_SAMPLES - 1
    return PatchSamples(np.empty(count), np.empty(count), np.empty(count), np.empty((count, 4, m, 3)))


def side_parameters(side: int) -> tuple[Array, Array]:
    """Parameters u and v of the samples of a side, one of them a single number, in ascending order."""
    t = np.linspace(0.0, 1.0, 2 * HALF_SIDE_SAMPLES - 1)
    end = np.array([1.0 if side in (1, 2) else 0.0])
    return (t, end) if side in (0, 2) else (end, t)


def counter_clockwise(values: Array, side: int) -> Array:
    """Values (n, m, ...) at ascending parameters of a side, in counter-clockwise order."""
    return values if side in (0, 1) else values[:, ::-1]


def _normals_along_side(poles: Array, side: int) -> Array:
    """Unit normals (n, m, 3) along a side, counter-clockwise."""
    across, degree = (poles.shape[1] - 1, poles.shape[2] - 1)[:: 1 if side in (1, 3) else -1]
    along = _sample_basis(degree, 2 * HALF_SIDE_SAMPLES - 1)
    values, slopes = _sample_basis(across, PATCH_SAMPLES)
    row = slice(-1, None) if side in (1, 2) else slice(0, 1)
    end = values[row], slopes[row]
    _, normal = evaluate_points_and_normals(poles, *((along, end) if side in (0, 2) else (end, along)))
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), MIN_DIVISOR)
    return counter_clockwise(normal, side)


def find_joints(network: PatchNetwork, row: IntArray) -> Joints:
    """The halves of curves on which two patches meet, by the row (Q,) of each patch in the samples."""
    halves, patches, sides = [], [], []
    for piece in (0, 1, 2):
        q, s = np.nonzero(network.piece == piece)
        for half, part in ((0, FIRST_PART), (1, SECOND_PART)) if piece == WHOLE else ((piece - 1, WHOLE_SIDE),):
            halves.append(2 * network.curve[q, s] + half)
            patches.append(q)
            sides.append(np.column_stack([row[q], s, network.sense[q, s] < 0, np.full(len(q), part)]))
    half, patch, side = np.concatenate(halves), np.concatenate(patches), np.concatenate(sides)
    order = np.argsort(half, kind="stable")
    first = np.flatnonzero(half[order][:-1] == half[order][1:])
    a, b = order[first], order[first + 1]
    return Joints(half[a], np.column_stack([patch[a], patch[b]]), np.column_stack([side[a], side[b]]))


def _measure_tangent_jumps(joints: Joints, samples: PatchSamples, previous: PreviousQuality | None) -> Array:
    """Largest tangent jumps (n,) along joints, in degrees; joints of copies of the same two sides are measured once."""
    jumps, new = np.empty(len(joints.half_curve)), np.ones(len(joints.half_curve), bool)
    if previous is not None:
        known, curve = previous.quality, previous.curve[joints.half_curve // 2]
        new = previous.changed[joints.patches].any(axis=1) | (curve < 0)
        rows = np.searchsorted(known.half_curve, 2 * curve[~new] + joints.half_curve[~new] % 2)
        jumps[~new] = known.tangent_jump_deg[rows]
    distinct, index = np.unique(joints.sides[new], axis=0, return_inverse=True)
    measured = np.empty(len(distinct))
    for batch in joint_batches(len(distinct)):
        one, other = (gather_along_sides(samples.side_normals, distinct[batch, k : k + 4]) for k in (0, 4))
        sine = np.linalg.norm(np.cross(one, other), axis=-1)
        measured[batch] = np.degrees(np.arctan2(sine, np.einsum("nmi,nmi->nm", one, other))).max(axis=1)
    jumps[new] = measured[index.ravel()]
    return jumps


def joint_batches(count: int) -> list[slice]:
    """Slices of at most JOINTS_PER_BATCH of so many joints."""
    return [slice(start, start + JOINTS_PER_BATCH) for start in range(0, count, JOINTS_PER_BATCH)]


def gather_along_sides(values: Array, sides: IntArray) -> Array:
    """Values (n, k, ...) along sides (n, 4) of `Joints`, in the curve's direction, of (R, 4, m, ...) counter-clockwise."""
    result = np.empty((len(sides), HALF_SIDE_SAMPLES, *values.shape[3:]))
    for against in (0, 1):
        for part, chosen in enumerate(SIDE_PARTS):
            rows = np.flatnonzero((sides[:, 2] == against) & (sides[:, 3] == part))
            along = values[sides[rows, 0], sides[rows, 1]]
            result[rows] = (along[:, ::-1] if against else along)[:, chosen]
    return result


def measure_curvature_jump(network: PatchNetwork, fit: NetworkFit) -> tuple[float, float]:
    """The largest difference of the curvature tensors of two patches along their joint, and the largest curvature there.

    Both in the Frobenius norm, in 1 / model units (`brep.edge_continuity` takes the spectral norm).
    """
    originals = np.flatnonzero(fit.copies.original_patches)
    row = np.searchsorted(originals, fit.copies.patch)
    curvatures = np.empty((len(originals), 4, 2 * HALF_SIDE_SAMPLES - 1, 3, 3))
    for _, numbers in group_by_degree(fit, originals):
        poles = np.stack([fit.patches[i] for i in numbers])
        for side in range(4):
            curvatures[row[numbers], side] = _curvatures_along_side(poles, side)
    sides = np.unique(find_joints(network, row).sides, axis=0)
    jump = size = 0.0
    for batch in joint_batches(len(sides)):
        one, other = (gather_along_sides(curvatures, sides[batch, k : k + 4]) for k in (0, 4))
        jump = max(jump, float(np.linalg.norm(one - other, axis=(-2, -1)).max()))
        size = max(size, *(float(np.linalg.norm(each, axis=(-2, -1)).max()) for each in (one, other)))
    return jump, size


def _curvatures_along_side(poles: Array, side: int) -> Array:
    """Curvature tensors (n, m, 3, 3) along a side, counter-clockwise.

    The tensor is the second fundamental form as a symmetric matrix in space, zero along the normal.
    """
    u, v = side_parameters(side)
    p, q = poles.shape[1] - 1, poles.shape[2] - 1
    d = {
        (i, j): evaluate_bezier_patches(bernstein_basis(p, u, i), poles, bernstein_basis(q, v, j))
        for i, j in ((1, 0), (0, 1), (2, 0), (1, 1), (0, 2))
    }  # fmt: skip
    normal = np.cross(d[1, 0], d[0, 1])
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), MIN_DIVISOR)
    tangents = np.stack([d[1, 0], d[0, 1]], axis=-1)
    first_form = np.swapaxes(tangents, -1, -2) @ tangents
    dual = tangents @ _invert_symmetric_2x2(first_form)
    second_form = np.empty(first_form.shape)
    for (i, j), key in (((0, 0), (2, 0)), ((0, 1), (1, 1)), ((1, 0), (1, 1)), ((1, 1), (0, 2))):
        second_form[..., i, j] = np.einsum("nmi,nmi->nm", d[key], normal)
    return counter_clockwise(dual @ second_form @ np.swapaxes(dual, -1, -2), side)


def _invert_symmetric_2x2(matrix: Array) -> Array:
    """Inverses of symmetric matrices (..., 2, 2), large but finite for singular ones: degenerate patches have them."""
    a, b, c = matrix[..., 0, 0], matrix[..., 0, 1], matrix[..., 1, 1]
    adjugate = np.stack([np.stack([c, -b], axis=-1), np.stack([-b, a], axis=-1)], axis=-2)
    return adjugate / np.maximum(a * c - b * b, 1e-12 * (a + c) ** 2 + 1e-100)[..., None, None]
