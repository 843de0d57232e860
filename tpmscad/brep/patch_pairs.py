"""Places of two patches between which a segment is least, along a normal, or stationary, for many pairs of patches at once.

Patches are bicubic nets (n, 2, 4, 4, 3), places their own parameters on [0, 1], (n, 2, 2); steps stay within the patches.
"""

from __future__ import annotations

import numpy as np

from tpmscad._typing import Array
from tpmscad.brep.surface_cells import evaluate_cells

NEWTON_STEPS = 12
"""Towards the nearest places of two patches, or the end of a normal; four or five reach round-off."""

SETTLING_STEPS = 5
"""Towards a stationary distance, from the end of a normal."""

SINGULAR_RATIO = 1e-6
"""Curvatures of the squared distance below this fraction of the largest do not move the places: sides are parallel there."""

DAMPING = 1e-6
"""Of Gauss-Newton steps, relative to the diagonal: parallel sides are as near everywhere."""


def approach_places(nets: Array) -> Array:
    """Nearest places (n, 2, 2) of two patches in their parameters on [0, 1], by damped Gauss-Newton steps."""
    st = np.full((len(nets), 2, 2), 0.5)
    for _ in range(NEWTON_STEPS):
        (p, pu, pv), (q, qu, qv) = (evaluate_cells(nets[:, k], st[:, k]) for k in (0, 1))
        jacobian = np.stack([-pu, -pv, qu, qv], axis=2)
        slope = np.einsum("nck,nc->nk", jacobian, q - p)
        square = np.einsum("nck,ncl->nkl", jacobian, jacobian)
        square += (DAMPING * np.einsum("nkk->nk", square) + 1e-300)[:, None] * np.eye(4)
        st = np.clip(st - np.linalg.solve(square, slope[..., None]).reshape(-1, 2, 2), 0.0, 1.0)
    return st


def shoot_normals(nets: Array) -> Array:
    """Middles of the first patches and the places in the second where their normals end, (n, 2, 2), by Newton's method."""
    st = np.full((len(nets), 2, 2), 0.5)
    p, pu, pv = evaluate_cells(nets[:, 0], st[:, 0])
    normal = unit_vectors(np.cross(pu, pv))
    for _ in range(NEWTON_STEPS):
        q, qu, qv = evaluate_cells(nets[:, 1], st[:, 1])
        across = [a - (a * normal).sum(axis=1, keepdims=True) * normal for a in (qu, qv, q - p)]
        uu, uv, vv, ru, rv = ((across[a] * across[b]).sum(axis=1) for a, b in ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2)))
        step = np.stack([ru * vv - rv * uv, rv * uu - ru * uv], axis=1)
        st[:, 1] = np.clip(st[:, 1] - step / np.maximum(uu * vv - uv * uv, 1e-300)[:, None], 0.0, 1.0)
    return st


def settle_places(nets: Array, st: Array) -> Array:
    """Places (n, 2, 2) near those given where the distance is stationary, a saddle or a maximum, too, by Newton's method."""
    for _ in range(SETTLING_STEPS):
        (p, *dp), (q, *dq) = (evaluate_cells(nets[:, k], st[:, k], order=2) for k in (0, 1))
        away = q - p
        jacobian = np.stack([-dp[0], -dp[1], dq[0], dq[1]], axis=2)
        slope = np.einsum("nck,nc->nk", jacobian, away)
        curvature = np.einsum("nck,ncl->nkl", jacobian, jacobian)
        for at, (uu, uv, vv), sign in ((0, dp[2:], -1.0), (2, dq[2:], 1.0)):
            for (a, b), second in zip(((0, 0), (0, 1), (1, 0), (1, 1)), (uu, uv, uv, vv), strict=True):
                curvature[:, at + a, at + b] += sign * (away * second).sum(axis=1)
        inverse = np.linalg.pinv(curvature, rcond=SINGULAR_RATIO, hermitian=True)
        st = np.clip(st - np.einsum("nkl,nl->nk", inverse, slope).reshape(-1, 2, 2), 0.0, 1.0)
    return st


def unit_vectors(vectors: Array) -> Array:
    """Vectors (n, 3) divided by their lengths; zero ones stay."""
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-300))
