"""Elastic stiffness and conductivity of a periodic cell by finite elements of second order.

The displacement is a uniform strain plus a periodic fluctuation, which minimises the energy: the effective stiffness
is the least energy over the volume of the cell, void included. The same holds of temperature gradients and conduction.
Source: Michel, Moulinec and Suquet, Comput. Methods Appl. Mech. Engrg. 172 (1999) 109. Strains are in Voigt's order 11, 22, 33,
23, 13, 12 with engineering shear.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
from scipy import sparse

from tpmscad._lazy_import import import_extra
from tpmscad._typing import Array, IntArray
from tpmscad.errors import InvalidRequest
from tpmscad.meshing.element_shapes import SHAPES, ElementShape
from tpmscad.meshing.library_meshes import skfem_order
from tpmscad.meshing.volume_mesh import VolumeMesh
from tpmscad.simulation.multigrid import solve

VOIGT = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))
"""Indices of each component."""

ELEMENTS: Mapping[str, tuple[str, int, str]] = MappingProxyType(
    {"tetra10": ("ElementTetP2", 4, "tetra"), "hexahedron27": ("ElementHex2", 5, "hexahedron")}
)
"""For each kind of element scikit-fem's, the degree of polynomials integrated exactly (twice that of the gradients, and more for
curved elements), and the kind of first order on the same corners."""


@dataclass(frozen=True, slots=True)
class IsotropicMaterial:
    """Young's modulus, Poisson's ratio and conductivity of the solid."""

    youngs_modulus: float = 1.0
    poisson_ratio: float = 0.3
    conductivity: float = 1.0

    @property
    def lame(self) -> tuple[float, float]:
        """Lame's constants lambda and mu."""
        e, nu = self.youngs_modulus, self.poisson_ratio
        return e * nu / ((1.0 + nu) * (1.0 - 2.0 * nu)), e / (2.0 * (1.0 + nu))

    @property
    def stiffness(self) -> Array:
        """Stiffness (6, 6) in Voigt's notation."""
        first, second = self.lame
        matrix = np.diag([2.0 * second] * 3 + [second] * 3)
        matrix[:3, :3] += first
        return matrix


@dataclass(frozen=True, slots=True, eq=False)
class CellProperties:
    """What one mesh gives: stiffness (6, 6) and conductivity (3, 3) of the cell, volume fraction, unknowns and iterations."""

    stiffness: Array
    conductivity: Array
    volume_fraction: float
    unknowns: int
    iterations: int


@dataclass(frozen=True, slots=True, eq=False)
class CellEquations:
    """Integrals over the solid: products[a][b] of d_a u and d_b v as matrices of all nodes, means (3, n) of d_a v, its volume.

    reduction takes values on the periodic nodes to all nodes, prolongation those on periodic corners to periodic nodes. basis is
    scikit-fem's, whose degrees of freedom are the nodes node_of.
    """

    basis: Any
    node_of: IntArray

    products: list[list[Any]]
    means: Array
    volume: float
    reduction: Any
    prolongation: Any


def solve_cell(mesh: VolumeMesh, material: IsotropicMaterial) -> CellProperties:
    """Stiffness and conductivity of the cell that a periodic mesh of second-order tetrahedra or hexahedra of 27 nodes fills.

    Raises InvalidRequest if the mesh is not one; KernelError if the solver does not converge.
    """
    return solve_equations(assemble(mesh), material, float(np.prod(mesh.periods)))[0]


def solve_equations(
    equations: CellEquations, material: IsotropicMaterial, box: float
) -> tuple[CellProperties, Array, Array]:
    """What the equations give, and the fluctuations: of displacements (3, n, 6) for unit strains, of temperatures (n, 3)."""
    conductivity, temperatures, first = solve_conduction(equations, material, box)
    stiffness, displacements, second = solve_elasticity(equations, material, box)
    unknowns = 3 * equations.reduction.shape[1]
    found = CellProperties(stiffness, conductivity, equations.volume / box, unknowns, max(first, second))
    return found, displacements, temperatures


def assemble(mesh: VolumeMesh) -> CellEquations:
    """The integrals, by scikit-fem, with nodes numbered as in the mesh.

    Raises InvalidRequest if the mesh is not periodic, or not of second order.
    """
    if len(mesh.cells) != 1 or not set(mesh.cells) <= set(ELEMENTS) or not set("xyz") <= set(mesh.periodic):
        raise InvalidRequest(
            "a cell is solved on elements of second order, periodic along x, y and z: mesh(size, 2, True) or hexahedra(2)"
        )
    skfem = import_extra("skfem", "homogenised properties", "simulation")
    ((kind, nodes),) = mesh.cells.items()
    element, degree, first_order = ELEMENTS[kind]
    basis = skfem.Basis(mesh.to_skfem(), getattr(skfem, element)(), intorder=degree)
    node_of = np.empty(basis.N, np.int64)
    node_of[basis.element_dofs] = nodes[:, skfem_order(kind)].T
    products: list[list[Any]] = [[None] * 3 for _ in range(3)]
    for a in range(3):
        for b in range(a, 3):
            form = skfem.BilinearForm(lambda u, v, w, a=a, b=b: u.grad[a] * v.grad[b])
            found = form.assemble(basis).tocoo()
            size = (basis.N, basis.N)
            products[a][b] = sparse.csr_matrix((found.data, (node_of[found.row], node_of[found.col])), size)
            products[b][a] = products[a][b].T.tocsr()
    means = np.zeros((3, basis.N))
    for a in range(3):
        means[a, node_of] = skfem.LinearForm(lambda v, w, a=a: v.grad[a]).assemble(basis)
    reduction, column = _reduction(mesh)
    return CellEquations(
        basis,
        node_of,
        products,
        means,
        float(basis.dx.sum()),
        reduction,
        _prolongation(nodes, column, SHAPES[kind], SHAPES[first_order]),
    )


def _reduction(mesh: VolumeMesh) -> tuple[Any, IntArray]:
    """The matrix from the distinct periodic nodes to all nodes, and the column of each node."""
    repeated, _ = mesh.periodic_ties()
    _, column = np.unique(repeated, return_inverse=True)
    count = len(column)
    return sparse.csr_matrix((np.ones(count), (np.arange(count), column))), column


def _prolongation(nodes: IntArray, column: IntArray, shape: ElementShape, first_order: ElementShape) -> Any:
    """The matrix from corners to all periodic nodes: the shape functions of first order at the nodes of the second."""
    corners = np.unique(column[nodes[:, : shape.corners]])
    number = np.full(column.max() + 1, -1, np.int64)
    number[corners] = np.arange(len(corners))
    rows, first = np.unique(column[nodes], return_index=True)
    element, local = np.divmod(first, nodes.shape[1])
    weights = first_order.values(shape.nodes)[local]
    columns = number[column[nodes[element, : shape.corners]]]
    own, at = np.nonzero(np.abs(weights) > 1e-12)
    entries = (weights[own, at], (rows[own], columns[own, at]))
    return sparse.csr_matrix(entries, (len(number), len(corners)))


def solve_conduction(equations: CellEquations, material: IsotropicMaterial, box: float) -> tuple[Array, Array, int]:
    """Conductivity (3, 3), fluctuations of temperatures (n, 3), and iterations."""
    reduce = equations.reduction
    matrix = (reduce.T @ sum(equations.products[a][a] for a in range(3)) @ reduce).tocsr()
    loads = reduce.T @ equations.means.T
    solution = solve(matrix, -loads, equations.prolongation, float(np.linalg.norm(equations.means)))
    energy = equations.volume * np.eye(3) + loads.T @ solution.values
    conductivity = material.conductivity * 0.5 * (energy + energy.T) / box
    return conductivity, reduce @ solution.values, solution.iterations


def solve_elasticity(equations: CellEquations, material: IsotropicMaterial, box: float) -> tuple[Array, Array, int]:
    """Stiffness (6, 6), fluctuations of displacements (3, n, 6), and iterations."""
    first, second = material.lame
    reduce, products = equations.reduction, equations.products
    trace = sum(products[a][a] for a in range(3))
    blocks = [
        [
            # products[a][b] integrates d_a u d_b v, with v of the row: u_b of the column enters by lambda d_b u_b d_a v_a
            reduce.T
            @ (first * products[b][a] + second * products[a][b] + (second * trace if a == b else 0.0 * trace))
            @ reduce
            for b in range(3)
        ]
        for a in range(3)
    ]
    matrix = sparse.bmat(blocks, format="csr")
    free = _strain_loads(equations.means, material)
    loads = np.concatenate([reduce.T @ free[a] for a in range(3)])
    prolongation = sparse.block_diag([equations.prolongation] * 3, format="csr")
    solution = solve(matrix, -loads, prolongation, float(np.linalg.norm(free)))
    energy = equations.volume * material.stiffness + loads.T @ solution.values
    displacements = np.stack([reduce @ part for part in np.split(solution.values, 3)])
    return 0.5 * (energy + energy.T) / box, displacements, solution.iterations


def _strain_loads(means: Array, material: IsotropicMaterial) -> Array:
    """Loads (3, n, 6) of the stresses of six unit strains: components by nodes by strains."""
    stress = np.zeros((6, 3, 3))
    for column in range(6):
        for row, (a, b) in enumerate(VOIGT):
            stress[column, a, b] = stress[column, b, a] = material.stiffness[row, column]
    return np.einsum("kab,bn->ank", stress, means)
