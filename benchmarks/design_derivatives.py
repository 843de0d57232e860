"""How volume, area, stiffness and conductivity of a sheet change with its thickness, offset and cell.

    python -m benchmarks.design_derivatives gyroid --cell 10 --thickness 1

Volume and area per cell follow from Steiner's formula on the exact surface. Stiffness and conductivity are differentiated on
hexahedra whose nodes move as the two offset surfaces do. The fluctuations minimise the energy, so only the explicit change
counts: with the gradient of the velocity V, div V of the energy density and -grad(u) grad(V) of the gradients. It is the exact
derivative of what the mesh gives. Source: Sokolowski and Zolesio, Introduction to Shape Optimization (1992), 2.10 and 3. What
depends on ratios of lengths alone is homogeneous in them, so the derivative with respect to the cell follows from the others.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from typing import Any

import numpy as np

import tpmscad
from tpmscad import surfaces
from tpmscad._typing import Array
from tpmscad.errors import InvalidRequest
from tpmscad.meshing.volume_mesh import VolumeMesh
from tpmscad.simulation.periodic_cell import (
    VOIGT,
    CellEquations,
    CellProperties,
    IsotropicMaterial,
    assemble,
    solve_equations,
)

STEP = 1e-3
"""Of the thickness: step of the central differences of nodes, whose motion is nearly linear."""

CUTS = (3, 1)
"""Cuts of each patch's wall along it and through it."""

MATERIAL = IsotropicMaterial()


@dataclass(frozen=True, slots=True, eq=False)
class DesignDerivatives:
    """Properties of one cell, and for "thickness", "offset" and "cell" a dict of their derivatives, per mm.

    volume (mm3), area (mm2, of both sides of the wall), stiffness (6, 6) and conductivity (3, 3); the last two are None if they
    were not asked for.
    """

    volume: float
    area: float
    stiffness: Array | None
    conductivity: Array | None
    derivatives: dict[str, dict[str, Any]]


def differentiate_design(
    surface: str,
    *,
    cell: float = 1.0,
    thickness: float,
    shift: float = 0.0,
    reference: str | None = None,
    material: IsotropicMaterial | None = MATERIAL,
) -> DesignDerivatives:
    """Derivatives of a sheet of `thickness`, whose middle lies `shift` beside the surface, both in mm as is `cell`.

    Without a material there are no stiffness and conductivity. Raises InvalidRequest if the surface has no hexahedra.
    """
    reference = reference or tpmscad.catalogue.find_surface(surface).references[0]
    measures = surfaces.cell_measures(surface, reference)
    low, high = ((shift + side * thickness / 2) / cell for side in (-1, 1))
    area = [measures.swept_area(offset) * cell**2 for offset in (low, high)]
    rate = [measures.swept_area_rate(offset) * cell for offset in (low, high)]
    volume = (measures.swept_volume(high) - measures.swept_volume(low)) * cell**3
    derivatives: dict[str, dict[str, Any]] = {
        "thickness": {"volume": sum(area) / 2, "area": (rate[1] - rate[0]) / 2},
        "offset": {"volume": area[1] - area[0], "area": rate[0] + rate[1]},
        "cell": {},
    }
    stiffness = conductivity = None
    if material is not None:
        mesh, velocities = _move_mesh(surface, cell, thickness, shift, reference)
        found, moved = differentiate_cell(mesh, material, velocities)
        stiffness, conductivity = found.stiffness, found.conductivity
        for name, change in zip(("thickness", "offset"), moved, strict=True):
            derivatives[name] |= change
    for name, value, degree in (
        ("volume", volume, 3),
        ("area", sum(area), 2),
        ("stiffness", stiffness, 0),
        ("conductivity", conductivity, 0),
    ):
        if value is not None:
            by_lengths = thickness * derivatives["thickness"][name] + shift * derivatives["offset"][name]
            derivatives["cell"][name] = (degree * value - by_lengths) / cell
    return DesignDerivatives(volume, sum(area), stiffness, conductivity, derivatives)


def _move_mesh(surface: str, cell: float, thickness: float, shift: float, reference: str) -> tuple[VolumeMesh, Array]:
    """Hexahedra of one cell, and the velocities of nodes by thickness and by offset (2, n, 3)."""
    step = STEP * thickness

    def mesh(thicker: float, higher: float) -> VolumeMesh:
        offset = (shift + higher - (thickness + thicker) / 2, shift + higher + (thickness + thicker) / 2)
        model = tpmscad.lattice(
            surface, cell=cell, offset=offset, reference=reference, boundary="natural", progress=False
        )
        found = model.hexahedra(2, CUTS)
        if set(found.periodic) < set("xyz"):
            raise InvalidRequest(f"the hexahedra of the {model.name} do not repeat along x, y and z: no derivatives")
        return found

    velocities = [
        (mesh(*(step * d for d in way)).points - mesh(*(-step * d for d in way)).points) / (2 * step)
        for way in ((1.0, 0.0), (0.0, 1.0))
    ]
    return mesh(0.0, 0.0), np.array(velocities)


def differentiate_cell(
    mesh: VolumeMesh, material: IsotropicMaterial, velocities: Array
) -> tuple[CellProperties, list[dict[str, Array]]]:
    """Properties of a periodic cell, and the derivatives of "stiffness" (6, 6) and "conductivity" (3, 3) for each velocity.

    The velocities of nodes (k, n, 3) are periodic. Raises InvalidRequest and KernelError as `solve_cell` does.
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
            {
                "stiffness": energy - change - change.T,
                "conductivity": material.conductivity * (spread - turn - turn.T),
            }
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


def main() -> None:
    """Print the properties of a sheet and their derivatives."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("surface")
    for name, default in (("cell", 1.0), ("thickness", None), ("shift", 0.0)):
        parser.add_argument(f"--{name}", type=float, default=default, required=default is None)
    options = parser.parse_args()
    found = differentiate_design(options.surface, cell=options.cell, thickness=options.thickness, shift=options.shift)
    print(f"volume {found.volume:.6g} mm3, area {found.area:.6g} mm2")
    print(f"stiffness\n{found.stiffness}\nconductivity\n{found.conductivity}")
    for name, of in found.derivatives.items():
        print(f"by {name}, per mm: volume {of['volume']:.6g}, area {of['area']:.6g}")
        print(f"stiffness\n{of['stiffness']}\nconductivity\n{of['conductivity']}")


if __name__ == "__main__":
    main()
