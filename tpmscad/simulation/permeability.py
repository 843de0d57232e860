"""Permeability of a periodic channel: slow viscous flow by Taylor-Hood elements, velocity of second and pressure of first order.

A unit pressure gradient along each axis drives the flow, which sticks to the walls: -lap u + grad p = e, div u = 0. The mean
velocity over the whole cell is the permeability (Darcy's law). The pressure is found by conjugate gradients on the Schur
complement, preconditioned by the mass matrix. Source: Elman, Silvester and Wathen, Finite Elements and Fast Iterative Solvers
(2014), 4.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import LinearOperator, cg, splu

from tpmscad._lazy_import import import_extra
from tpmscad._typing import Array, IntArray
from tpmscad.errors import InvalidRequest, KernelError
from tpmscad.meshing.library_meshes import skfem_order
from tpmscad.meshing.volume_mesh import VolumeMesh
from tpmscad.simulation.periodic_cell import CellEquations, assemble

TOLERANCE = 1e-8
"""Relative residual of the pressure; the error of the permeability is of its square."""

MAX_ITERATIONS = 300
"""Iterations of the pressure: several times as many as porous cells need, so that a solve that does not converge is told."""


def permeability(mesh: VolumeMesh) -> Array:
    """Permeability (3, 3), in squares of the mesh's unit, of the channel that a periodic mesh of tetrahedra of order 2 fills.

    Raises InvalidRequest if the mesh is not one, and KernelError if the pressure does not converge.
    """
    if set(mesh.cells) != {"tetra10"}:
        raise InvalidRequest(
            "flow is solved on tetrahedra of second order, periodic: mesh(size, 2, True) of the channel"
        )
    equations = assemble(mesh)
    _, column = np.unique(mesh.periodic_ties()[0], return_inverse=True)
    free = _free_columns(mesh, column)
    laplacian = _reduce(sum(equations.products[a][a] for a in range(3)), equations.reduction, free)
    divergence, mass = _pressure_forms(mesh, equations, column)
    gradients = [(part @ equations.reduction).tocsc()[:, free] for part in divergence]
    factors = splu(
        laplacian.tocsc(), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True}, diag_pivot_thresh=0.0
    )
    weights = np.asarray(equations.reduction.T @ _node_weights(equations))[free]

    def schur(p: Array) -> Array:
        return np.asarray(sum(g @ factors.solve(g.T @ p) for g in gradients))

    n = mass.shape[0]
    scale = 1.0 / mass.diagonal()
    found = np.zeros((3, 3))
    for axis in range(3):
        driven = factors.solve(weights)
        pressure, failed = cg(
            LinearOperator((n, n), schur),
            gradients[axis] @ driven,
            rtol=TOLERANCE,
            atol=0.0,
            maxiter=MAX_ITERATIONS,
            M=LinearOperator((n, n), lambda r: scale * r),
        )
        if failed:
            raise KernelError("solve", f"the pressure has not converged after {MAX_ITERATIONS} iterations")
        for row in range(3):
            load = (weights if row == axis else 0.0) - gradients[row].T @ pressure
            found[row, axis] = weights @ factors.solve(load)
    return 0.5 * (found + found.T) / float(np.prod(mesh.periods))


def _free_columns(mesh: VolumeMesh, column: IntArray) -> IntArray:
    """Distinct periodic nodes that are not on walls: facets that do not lie in a periodic side of the box."""
    (facets,) = mesh.facets.values()
    is_open = np.zeros(len(facets), bool)
    for pairs in mesh.periodic.values():
        for side in pairs.T:
            is_open |= np.isin(facets, side).all(axis=1)
    return np.setdiff1d(np.arange(column.max() + 1), column[facets[~is_open]])


def _reduce(matrix: Any, reduction: Any, free: IntArray) -> Any:
    """A matrix of all nodes on the free periodic ones."""
    return (reduction.T @ matrix @ reduction).tocsr()[free][:, free]


def _pressure_forms(mesh: VolumeMesh, equations: CellEquations, column: IntArray) -> tuple[list[Any], Any]:
    """Integrals of p d_a u, (periodic corners, nodes) for each axis, and the mass matrix of the pressure."""
    skfem = import_extra("skfem", "permeability", "simulation")
    ((kind, nodes),) = mesh.cells.items()
    basis = equations.basis
    linear = skfem.Basis(basis.mesh, skfem.ElementTetP1(), quadrature=basis.quadrature)
    corner = np.empty(linear.N, np.int64)
    corner[linear.element_dofs] = column[nodes[:, skfem_order(kind)][:, :4]].T
    used, number = np.unique(corner, return_inverse=True)
    fold = sparse.csr_matrix((np.ones(linear.N), (number, np.arange(linear.N))), (len(used), linear.N))
    parts = []
    for axis in range(3):
        form = skfem.BilinearForm(lambda u, p, w, a=axis: p * u.grad[a]).assemble(basis, linear).tocoo()
        part = sparse.csr_matrix((form.data, (form.row, equations.node_of[form.col])), (linear.N, basis.N))
        parts.append(fold @ part)
    mass = skfem.BilinearForm(lambda u, p, w: u * p).assemble(linear)
    return parts, fold @ mass @ fold.T


def _node_weights(equations: CellEquations) -> Array:
    """Integral of each node's function (n,)."""
    skfem = import_extra("skfem", "permeability", "simulation")
    weights = np.empty(equations.basis.N)
    weights[equations.node_of] = skfem.LinearForm(lambda v, w: 1.0 * v).assemble(equations.basis)
    return weights
