"""Elasticity of a structure with all its pores, on voxels; compliance of a cantilever.

Trilinear elements weighted by their solid fraction; conjugate gradients with algebraic multigrid (PyAMG).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pyamg
import skfem
from scipy import ndimage, sparse
from skfem.models.elasticity import lame_parameters, linear_elasticity

from tpmscad import fields

SUBSAMPLES = 4
"""Samples of the field along each edge of a voxel."""

LEAST_FRACTION = 0.05
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


@dataclass(frozen=True, slots=True)
class VoxelSystem:
    """Stiffness matrix of the largest part; its nodes (n, 3) in steps of `size` from the corner of the box of voxels `shape`.

    The volume fraction and the volume of loose parts are those of all voxels.
    """

    matrix: sparse.csr_matrix
    nodes: np.ndarray
    size: float
    shape: tuple[int, ...]
    volume_fraction: float
    loose_parts: int
    loose_fraction: float

    def solve(self, free: np.ndarray, *forces: np.ndarray) -> list[np.ndarray]:
        """Displacements (3 n) that are zero but where `free` (3 n), for each of the nodal forces (3 n)."""
        x, y, z = ((self.nodes - self.nodes.mean(axis=0)) * self.size).T
        modes = np.zeros((len(self.nodes), 3, 6))
        modes[:, [0, 1, 2], [0, 1, 2]] = 1.0
        modes[:, 0, 3], modes[:, 1, 3] = -y, x
        modes[:, 1, 4], modes[:, 2, 4] = -z, y
        modes[:, 2, 5], modes[:, 0, 5] = -x, z
        fixed = sparse.diags((~free).astype(float))
        kept = sparse.diags(free.astype(float))
        system = (kept @ self.matrix @ kept + fixed).tobsr((3, 3))
        near_null = modes.reshape(-1, 6) * free[:, None]
        solver = pyamg.smoothed_aggregation_solver(system, B=near_null, strength=("symmetric", {"theta": 0.0}))
        found = []
        for force in forces:
            residuals: list[float] = []
            found.append(solver.solve(force * free, tol=1e-7, accel="cg", maxiter=400, residuals=residuals))
            if residuals[-1] > 1e-5 * residuals[0]:
                raise RuntimeError(f"the solver stalled at {residuals[-1] / residuals[0]:.1e}")
        return found


def assemble(field: fields.Field, box: tuple, count: int) -> VoxelSystem:
    """The largest part of the solid of a field in a box, of `count` voxels along x."""
    fraction, size = sample_fractions(field, box, count)
    labels, parts = ndimage.label(fraction > LEAST_FRACTION)
    sizes = np.bincount(labels.ravel())[1:]
    kept = labels == 1 + np.argmax(sizes)
    cells = np.argwhere(kept)
    shape = np.array(kept.shape) + 1
    nodes = np.stack([np.ravel_multi_index((cells + corner).T, shape) for corner in CORNERS], axis=1)
    used, nodes = np.unique(nodes, return_inverse=True)
    nodes = nodes.reshape(-1, 8)
    unknowns = (3 * nodes[:, :, None] + np.arange(3)).reshape(len(cells), 24).astype(np.int32)
    values = fraction[kept][:, None, None] * element_matrix(size)
    rows, columns = np.repeat(unknowns, 24, axis=1), np.tile(unknowns, (1, 24))
    matrix = sparse.csr_matrix((values.ravel(), (rows.ravel(), columns.ravel())), (3 * used.size,) * 2)
    place = np.stack(np.unravel_index(used, shape), axis=1)
    return VoxelSystem(
        matrix, place, size, kept.shape, float(fraction.mean()), int(parts - 1), float(1 - sizes.max() / sizes.sum())
    )


def resolve_compliance(field: fields.Field, box: tuple, count: int) -> dict[str, float]:
    """Compliance under a shear traction of total 1 per unit width at the right end, volume fraction, and loose parts.

    Clamped at the left end; `count` voxels along x. Parts that do not hang together with the largest one carry nothing.
    """
    system = assemble(field, box, count)
    depth = box[1][2] - box[0][2]
    load = np.zeros(system.nodes.shape)
    loaded = system.nodes[:, 0] == system.shape[0]
    if not loaded.any():
        raise ValueError("the largest part does not reach the loaded end: use more voxels")
    load[loaded, 1] = -depth / loaded.sum()
    force = load.ravel()
    (u,) = system.solve(np.repeat(system.nodes[:, 0] > 0, 3), force)
    return {
        "compliance": float(force @ u) / depth,
        "volume fraction": system.volume_fraction,
        "loose parts": system.loose_parts,
        "volume of loose parts, %": 100 * system.loose_fraction,
    }


def confined_moduli(field: fields.Field, box: tuple, count: int, axes: tuple[int, ...] = (0, 1, 2)) -> list[float]:
    """Mean stress over strain along axes, where rigid smooth plates on all six faces of the box allow no other strain."""
    system = assemble(field, box, count)
    volume = float(np.prod(np.array(system.shape) * system.size))
    free = ((system.nodes > 0) & (system.nodes < np.array(system.shape))).ravel()
    unit = [(system.size * system.nodes * (np.arange(3) == axis)).ravel() for axis in axes]
    found = system.solve(free, *(-(system.matrix @ u) for u in unit))
    return [float((u + v) @ (system.matrix @ (u + v))) / volume for u, v in zip(unit, found, strict=True)]
