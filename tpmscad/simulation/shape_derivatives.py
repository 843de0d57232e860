"""Shape derivatives of effective properties: how they change as the nodes of the mesh move.

The fluctuations minimise the energy, so only the explicit change counts: with the gradient of the velocity V, div V of the energy
density and -grad(u) grad(V) of the gradients. It is the exact derivative of what the mesh gives. Source: Sokolowski and Zolesio,
Introduction to Shape Optimization (1992), 2.10 and 3.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array
from tpmscad.meshing.volume_mesh import VolumeMesh
from tpmscad.simulation.periodic_cell import (
    VOIGT,
    CellEquations,
    CellProperties,
    IsotropicMaterial,
    assemble,
    solve_equations,
)


@dataclass(frozen=True, slots=True, eq=False)
class CellDerivatives:
    """Derivatives of the stiffness (6, 6), the conductivity (3, 3) and the volume fraction for one velocity of the nodes."""

    stiffness: Array
    conductivity: Array
    volume_fraction: float


def differentiate_cell(
    mesh: VolumeMesh, material: IsotropicMaterial, velocities: Array
) -> tuple[CellProperties, list[CellDerivatives]]:
    """Properties of a periodic cell, and their derivatives for each of some periodic velocities of its nodes, (k, n, 3).

    Raises InvalidRequest and KernelError as `solve_cell` does.
    """
    equations, box = assemble(mesh), float(np.prod(mesh.periods))
    found, displacements, temperatures = solve_equations(equations, material, box)
    strain = np.zeros((6, 3, 3))
    for k, (a, b) in enumerate(VOIGT):
        strain[k, a, b] += 0.5
        strain[k, b, a] += 0.5
    fluctuation = np.stack([_gradient(equations, displacements[:, :, k]) for k in range(6)])
    heat = _gradient(equations, temperatures.T)
    weights = equations.basis.dx / box
    derivatives = []
    for velocity in velocities:
        speed = _gradient(equations, velocity.T)
        dilation = np.einsum("aaeq->eq", speed) * weights
        turned = np.einsum("kaceq,cbeq->kabeq", fluctuation, speed)
        stress = _stress(fluctuation + strain[..., None, None], material)
        energy = np.einsum("kabeq,labeq,eq->kl", stress, fluctuation + strain[..., None, None], dilation)
        change = np.einsum("kabeq,labeq,eq->kl", stress, turned, weights)
        flux = heat + np.eye(3)[..., None, None]
        spread = np.einsum("kaeq,laeq,eq->kl", flux, flux, dilation)
        turn = np.einsum("kbeq,lceq,cbeq,eq->kl", flux, heat, speed, weights, optimize=True)
        derivatives.append(
            CellDerivatives(
                energy - change - change.T, material.conductivity * (spread - turn - turn.T), float(dilation.sum())
            )
        )
    return found, derivatives


def _gradient(equations: CellEquations, values: Array) -> Array:
    """Derivatives of components (k, n) given on nodes along x, y and z at the quadrature points: (k, 3, elements, points)."""
    return np.stack([equations.basis.interpolate(each[equations.node_of]).grad for each in values])


def _stress(gradients: Array, material: IsotropicMaterial) -> Array:
    """Stresses of displacement gradients, (..., 3, 3, elements, points) each."""
    first, second = material.lame
    trace = np.einsum("kaaeq->keq", gradients)
    stress = second * (gradients + np.swapaxes(gradients, 1, 2))
    for a in range(3):
        stress[:, a, a] += first * trace
    return stress
