"""An exchanger's conformal mesh of three regions, and steady conduction through it.

    python -m benchmarks.exchanger [--cells 2] [--size 1.3]

A cube of gyroid cells of 10 mm with a wall of 1 mm. Channel + is hot at its openings X-, channel - is cold at its openings X+;
all else is adiabatic. The wall conducts 20 times as well as the fluids at rest. scikit-fem's second-order elements; the heat
through an interface is the sum of the wall's reactions at its nodes.
"""

from __future__ import annotations

import argparse
import time

import build123d as bd
import numpy as np
import skfem
from scipy.sparse import diags
from scipy.sparse.linalg import LinearOperator, cg
from skfem.helpers import dot, grad

import tpmscad
from tests.meshing.mesh_facets import interior_facets
from tpmscad._typing import Array
from tpmscad.meshing.library_meshes import skfem_order
from tpmscad.meshing.volume_mesh import VolumeMesh

CONDUCTIVITY = {"wall": 20.0, "channel +": 1.0, "channel -": 1.0}
TOLERANCE = 1e-13


def check_interfaces(mesh: VolumeMesh) -> None:
    """Print whether the facets between regions have an element of each on either side, on the same nodes."""
    ((_, nodes),) = mesh.cells.items()
    ((_, facets),) = mesh.facets.items()
    inner = interior_facets(mesh.cells, mesh.facets)
    for name, numbers in mesh.facet_groups.items():
        if " | " not in name:
            continue
        on = np.unique(facets[numbers])
        missing = [np.setdiff1d(on, nodes[mesh.cell_groups[region]]).size for region in name.split(" | ")]
        print(
            f"{name}: {len(numbers)} facets, {len(on)} nodes, {missing} not of each region; all inside: {inner[numbers].all()}"
        )
    apart = len(mesh.points) - len(np.unique(mesh.points.round(9), axis=0))
    named = sum(len(numbers) for name, numbers in mesh.facet_groups.items() if " | " in name)
    print(f"nodes at the place of another: {apart}; facets inside that are no interface: {inner.sum() - named}")


def conduct(mesh: VolumeMesh) -> dict[str, float]:
    """Heat from the hot openings, into the cold ones, and what each region gives to another."""
    basis = skfem.Basis(mesh.to_skfem(), skfem.ElementTetP2())
    ((kind, nodes),) = mesh.cells.items()
    node_of = np.empty(basis.N, np.int64)
    node_of[basis.element_dofs] = nodes[:, skfem_order(kind)].T
    matrices = {}
    for region, value in CONDUCTIVITY.items():
        part = skfem.Basis(basis.mesh, basis.elem, elements=mesh.cell_groups[region])
        matrices[region] = value * skfem.BilinearForm(lambda u, v, w: dot(grad(u), grad(v))).assemble(part)
    matrix = sum(matrices.values())
    sets = mesh.node_sets

    def dofs(name: str) -> Array:
        return np.flatnonzero(np.isin(node_of, sets[name]))

    hot, cold = dofs("channel +: opening X-"), dofs("channel -: opening X+")
    values = np.zeros(basis.N)
    values[hot] = 1.0
    free = np.setdiff1d(np.arange(basis.N), np.concatenate([hot, cold]))
    inner = matrix[free][:, free]
    scale = diags(1.0 / inner.diagonal())
    solved, failed = cg(
        inner,
        -(matrix @ values)[free],
        rtol=TOLERANCE,
        atol=0.0,
        maxiter=5000,
        M=LinearOperator(inner.shape, scale.dot),
    )
    if failed:
        raise SystemExit("conduction has not converged")
    values[free] = solved
    reactions = matrix @ values
    heat = {"from the hot openings": reactions[hot].sum(), "into the cold openings": -reactions[cold].sum()}
    for channel, sign in (("channel +", 1.0), ("channel -", -1.0)):
        heat[f"through wall | {channel}"] = sign * (matrices["wall"] @ values)[dofs(f"wall | {channel}")].sum()
    heat["unknowns"] = len(free)
    return {key: float(value) for key, value in heat.items()}


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cells", type=int, default=2)
    parser.add_argument("--size", type=float, default=1.3)
    given = parser.parse_args()
    edge = 10.0 * given.cells
    body = bd.Pos(edge / 2, edge / 2, edge / 2) * bd.Box(edge, edge, edge)
    parts = tpmscad.fluid_domains(body, "gyroid", cell=10, thickness=1, tol=0.02, progress=False)
    begun = time.process_time()
    mesh = parts.mesh(given.size, progress=False)
    print(f"{mesh}\n{time.process_time() - begun:.0f} CPU s; volume {mesh.volume / edge**3 - 1:+.1e} off the body's")
    for name, model in parts.domains.items():
        print(f"{name}: {mesh.cell_volumes[mesh.cell_groups[name]].sum() / model.volume - 1:+.1e} off its volume")
    check_interfaces(mesh)
    begun = time.process_time()
    heat = conduct(mesh)
    first = heat["from the hot openings"]
    for key, value in heat.items():
        print(f"{key:36} {value:.9g}" + ("" if key == "unknowns" else f"   {value / first - 1:+.1e}"))
    print(f"solved in {time.process_time() - begun:.0f} CPU s")


if __name__ == "__main__":
    main()
