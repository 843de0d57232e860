"""What the patches of a fit miss: how far points of the level set are from their feet on the patches."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from tpmscad.patches.levelset.bezier import bezier, tensor
from tpmscad.patches.levelset.check import SAMPLES, shapes
from tpmscad.patches.levelset.fit import NetFit
from tpmscad.patches.levelset.layout.octree import Array

FEET = 6
"""Newton steps of a foot on a patch."""

NEAREST = (3, 24)
"""Samples from whose patches the nearest foot is taken, and for points that miss with them: near a side that runs askew the
nearest samples may all be of patches beyond it."""


def missed(fit: NetFit, points: Array, tol: float) -> Array:
    """Distances (n,) from points of the level set to their feet on the patches; those above half of tol with more care."""
    t = np.linspace(0.0, 1.0, SAMPLES)
    samples, owner = [], []
    for (p, q), at in shapes(fit):
        samples.append(tensor(bezier(p, t), np.stack([fit.patches[i] for i in at]), bezier(q, t)).reshape(-1, 3))
        owner.append(np.repeat(at, SAMPLES**2))
    patch = np.concatenate(owner)
    u, v = (np.tile(g.ravel(), len(fit.patches)) for g in np.meshgrid(t, t, indexing="ij"))
    tree = cKDTree(np.concatenate(samples))
    best = np.full(len(points), np.inf)
    for count in NEAREST:
        chosen = np.flatnonzero(best > 0.5 * tol)
        if not len(chosen):
            break
        _, near = tree.query(points[chosen], k=count)
        for k in range(count):
            i = near[:, k]
            for (p, q), at in shapes(fit):
                rows = np.flatnonzero(np.isin(patch[i], at))
                if len(rows):
                    poles = np.stack([fit.patches[j] for j in at])[np.searchsorted(at, patch[i[rows]])]
                    distance = _feet(poles, points[chosen[rows]], u[i[rows]], v[i[rows]], p, q)
                    best[chosen[rows]] = np.minimum(best[chosen[rows]], distance)
    return best


def _feet(poles: Array, points: Array, u: Array, v: Array, p: int, q: int) -> Array:
    """Distances from points to patches, one each, from starting parameters: feet kept on the patches."""
    for _ in range(FEET):
        bu, bv, du, dv = bezier(p, u), bezier(q, v), bezier(p, u, 1), bezier(q, v, 1)
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
    foot = np.einsum("ni,nijx,nj->nx", bezier(p, u), poles, bezier(q, v), optimize=True)
    return np.linalg.norm(points - foot, axis=1)
