"""Compliance of a cantilever with all its pores, on voxels.

Trilinear elements weighted by their solid fraction; conjugate gradients with algebraic multigrid (PyAMG).
"""

from __future__ import annotations

import numpy as np
import pyamg
import skfem
from scipy import ndimage, sparse
from skfem.models.elasticity import lame_parameters, linear_elasticity

from tpmscad import fields

SUBSAMPLES = 2
"""Samples of the field along each edge of a voxel."""

LEAST_FRACTION = 0.2
"""Voxels with less solid are void."""


def element_matrix(size: float) -> np.ndarray:
    """Stiffness (24, 24) of a cube, Young's modulus 1, Poisson's ratio 0.3, corners in the order of `CORNERS`, x, y, z each."""
    mesh = skfem.MeshHex.init_tensor(*(np.array([0.0, size]),) * 3)
    basis = skfem.Basis(mesh, skfem.ElementVector(skfem.ElementHex1()))
    matrix = linear_elasticity(*lame_parameters(1.0, 0.3)).assemble(basis).toarray()
    number = [int(np.flatnonzero((size * np.array(c) == mesh.p.T).all(axis=1))[0]) for c in CORNERS]
    order = basis.nodal_dofs[:, number].T.ravel()
    return matrix[np.ix_(order, order)]


CORNERS = [(a, b, c) for a in (0, 1) for b in (0, 1) for c in (0, 1)]


def sample_fractions(field: fields.Field, box: tuple, count: int) -> tuple[np.ndarray, float]:
    """Solid fraction of each voxel, and the edge of a voxel, with `count` of them along x."""
    size = (box[1][0] - box[0][0]) / count
    axes = []
    for low, high in zip(*box, strict=True):
        n = round((high - low) / size) * SUBSAMPLES
        axes.append(low + (np.arange(n) + 0.5) * size / SUBSAMPLES)
    solid = field.on_grid(*axes) <= 0
    nx, ny, nz = (len(a) // SUBSAMPLES for a in axes)
    s = SUBSAMPLES
    return solid.reshape(nx, s, ny, s, nz, s).mean(axis=(1, 3, 5)), size


def resolve_compliance(field: fields.Field, box: tuple, count: int) -> dict[str, float]:
    """Compliance under a shear traction of total 1 per unit width at the right end, volume fraction, and loose parts.

    Clamped at the left end; `count` voxels along x. Parts that do not hang together with the largest one carry nothing.
    """
    fraction, size = sample_fractions(field, box, count)
    labels, parts = ndimage.label(fraction > LEAST_FRACTION)
    sizes = np.bincount(labels.ravel())[1:]
    kept = labels == 1 + np.argmax(sizes)
    cells = np.argwhere(kept)
    shape = np.array(kept.shape) + 1
    nodes = np.stack([np.ravel_multi_index((cells + corner).T, shape) for corner in CORNERS], axis=1)
    used, nodes = np.unique(nodes, return_inverse=True)
    nodes = nodes.reshape(-1, 8)
    unknowns = (3 * nodes[:, :, None] + np.arange(3)).reshape(len(cells), 24)
    values = fraction[kept][:, None, None] * element_matrix(size)
    rows, columns = np.repeat(unknowns, 24, axis=1), np.tile(unknowns, (1, 24))
    matrix = sparse.csr_matrix((values.ravel(), (rows.ravel(), columns.ravel())), (3 * used.size,) * 2)
    place = np.stack(np.unravel_index(used, shape), axis=1)
    load = np.zeros((used.size, 3))
    loaded = place[:, 0] == shape[0] - 1
    if not loaded.any():
        raise ValueError("the largest part does not reach the loaded end: use more voxels")
    load[loaded, 1] = -(box[1][2] - box[0][2]) / loaded.sum()
    free = np.repeat(place[:, 0] > 0, 3)
    x, y, z = ((place - place.mean(axis=0)) * size).T
    modes = np.zeros((used.size, 3, 6))
    modes[:, [0, 1, 2], [0, 1, 2]] = 1.0
    modes[:, 0, 3], modes[:, 1, 3] = -y, x
    modes[:, 1, 4], modes[:, 2, 4] = -z, y
    modes[:, 2, 5], modes[:, 0, 5] = -x, z
    system = matrix[free][:, free].tobsr((3, 3))
    solver = pyamg.smoothed_aggregation_solver(
        system, B=modes.reshape(-1, 6)[free], strength=("symmetric", {"theta": 0.0})
    )
    force = load.ravel()[free]
    residuals: list[float] = []
    u = solver.solve(force, tol=1e-7, accel="cg", maxiter=400, residuals=residuals)
    if residuals[-1] > 1e-5 * residuals[0]:
        raise RuntimeError(f"the solver stalled at {residuals[-1] / residuals[0]:.1e}")
    return {
        "compliance": float(force @ u) / (box[1][2] - box[0][2]),
        "volume fraction": float(fraction.mean()),
        "loose parts": int(parts - 1),
        "volume of loose parts, %": float(100 * (1 - sizes.max() / sizes.sum())),
    }
