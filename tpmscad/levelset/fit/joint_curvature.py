"""Curvature of a fit across its joints: how far it is from continuous (G2), measured once on the fit that is kept."""

from __future__ import annotations

import numpy as np

from tpmscad._typing import Array
from tpmscad.levelset.fit.fit_quality import (
    HALF_SIDE_SAMPLES,
    counter_clockwise,
    find_joints,
    gather_along_sides,
    group_by_degree,
    joint_batches,
    side_parameters,
)
from tpmscad.levelset.fit.network_fit import NetworkFit
from tpmscad.levelset.quadmesh.patch_network import PatchNetwork
from tpmscad.levelset.quadmesh.vectors import MIN_DIVISOR
from tpmscad.splines.basis import bernstein_basis, evaluate_bezier_patches


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
