"""An exchanger's conformal mesh of three regions, steady conduction through it, and flow and heat by OpenFOAM.

    python -m benchmarks.exchanger [--cells 2] [--size 1.3]
    python -m benchmarks.exchanger --openfoam FOLDER [--size 2 1.2] [--stubs 10] [--cell-size 0.1 0.07]
    python -m benchmarks.exchanger --openings [--surface gyroid] [--case cylinder] [--transition 10] [--file PART + - CELL WALL]

A cube of gyroid cells of 10 mm with a wall of 1 mm. Channel + is hot at its openings X-, channel - is cold at its openings X+;
all else is adiabatic. The wall conducts 20 times as well as the fluids at rest. scikit-fem's second-order elements; the heat
through an interface is the sum of the wall's reactions at its nodes.

With --openfoam, cases are written into the folder and run, if OpenFOAM is installed: a box of 30 x 20 x 20 in cross flow, whose
channels open at two sides each, at each size, and a period of one channel of a gyroid at porosity 1/2 at each cell size, whose
pressure drop is compared with the permeability by finite elements.

With --openings, exchangers whose channels open at some faces only are made in several bodies: CPU seconds, whether the
certificate is met, by how much the volumes miss the body's, the part of the body that is wall, the pieces of wall and channels,
and the area of each opening. --file takes a CAD file instead, the plane faces at which the channels + and - open, cell and wall.
"""

from __future__ import annotations

import argparse
import re
import resource
import shutil
import subprocess
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import build123d as bd
import numpy as np
import skfem
from scipy.sparse import diags
from scipy.sparse.linalg import LinearOperator, cg
from skfem.helpers import dot, grad

import tpmscad
from tests.meshing.mesh_facets import interior_facets
from tpmscad._typing import Array
from tpmscad.kernel.body_import.cad_body import read_bodies
from tpmscad.meshing.library_meshes import skfem_order
from tpmscad.meshing.openfoam_case import PASCAL_PER_UNIT, WATER_VISCOSITY
from tpmscad.meshing.volume_mesh import VolumeMesh
from tpmscad.simulation.permeability import permeability

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


def run_case(mesh: VolumeMesh, folder: Path, velocity: float) -> str:
    """Write a case and run it; what it prints."""
    mesh.write_openfoam(folder, velocity=velocity)
    begun = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
    done = subprocess.run([folder / "Allrun"], capture_output=True, text=True, check=False)
    seconds = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - begun
    print(f"{folder.name}: {mesh.n_cells} tetrahedra, {seconds:.0f} CPU s\n{done.stdout}{done.stderr}", flush=True)
    return done.stdout


def run_exchanger(folder: Path, sizes: list[float], stubs: float) -> None:
    """Flow and heat of the exchanger with openings, in front of which there are stubs of a length."""
    domains = tpmscad.fluid_domains(
        bd.Box(30, 20, 20),
        "gyroid",
        cell=10,
        thickness=1,
        tol=0.1,
        phase=(0.1, 0.2, 0.3),
        openings={"+": "<X,>X", "-": "<Y,>Y"},
        transition=6,  # as measured; without it channels end with creases
        progress=False,
    )
    for size in sizes:
        mesh = domains.mesh(size, order=1, progress=False)
        run_case(mesh.add_stubs(stubs) if stubs else mesh, folder / f"exchanger_{size:g}", 0.01)


def run_period(folder: Path, sizes: list[float]) -> None:
    """Pressure drop over a period of a gyroid's channel, at a Reynolds number far below 1, against the permeability."""
    channel = tpmscad.lattice("gyroid", cell=1.0, volume_fraction=0.5, kind="skeletal", progress=False)
    known = np.trace(permeability(channel.mesh(0.08, periodic=True, progress=False))) / 3
    speed = 1e-4  # m/s
    for size in sizes:
        mesh = channel.mesh(size, order=1, periodic=True, progress=False)
        found = re.search(r"pressure drop (\S+) Pa", run_case(mesh, folder / f"period_{size:g}", speed))
        if found:
            value = WATER_VISCOSITY * 1e3 * speed * mesh.volume * PASCAL_PER_UNIT / float(found[1])
            print(
                f"permeability {value:.4e} mm2, {value / known - 1:+.1%} off {known:.4e} by finite elements\n",
                flush=True,
            )


def _make_cylinder() -> bd.Part:
    """A cylinder of diameter 30 and height 30 with a port on each of four sides."""
    ports = [bd.Rot(0, 0, 90 * k) * bd.Pos(14, 0, 0) * bd.Rot(0, 90, 0) * bd.Cylinder(5, 8) for k in range(4)]
    return bd.Cylinder(15, 30) + ports


def _make_shell() -> bd.Part:
    """A half ring of 12 x 14 between radii of 18 and 30."""
    ring = bd.Pos(24, 0, 0) * bd.Rectangle(12, 14)
    return bd.revolve(bd.Rot(90, 0, 0) * ring, bd.Axis.Z, 180)


CROSS, COUNTER = {"+": "<X,>X", "-": "<Y,>Y"}, {"+": "<Z,>Z", "-": "<X,>X"}

CASES: dict[str, tuple[Callable[[], bd.Part], dict[str, Any]]] = {
    "box 40x20x20": (lambda: bd.Box(40, 20, 20), {"openings": CROSS, "tol": 0.05}),
    "box 20x10x10": (lambda: bd.Box(20, 10, 10), {"openings": CROSS, "tol": 0.2}),
    "box 20x20x40, cross flow": (lambda: bd.Box(20, 20, 40), {"openings": COUNTER, "tol": 0.1}),
    "box 20x20x40, counter flow": (
        lambda: bd.Box(20, 20, 40),
        {"openings": {"+": "<Z,>Z", "-": "<Z,>Z"}, "tol": 0.1},
    ),
    "box 33x27x21": (lambda: bd.Box(33, 27, 21), {"openings": CROSS, "cell": 12, "tol": 0.1}),
    "cylinder with four ports": (_make_cylinder, {"openings": CROSS, "tol": 0.1}),
    "half ring": (_make_shell, {"openings": {"+": "<Y", "-": "<Z,>Z"}, "tol": 0.1}),
}
"""Bodies, and what is asked of their exchangers besides a cell of 10 and a wall of 1."""


def run_openings(surfaces: Sequence[str], case: str, transition: float | None, file: Sequence[str] | None) -> None:
    """Print what is made of each body, or why it is not."""
    cases = {name: made for name, made in CASES.items() if case in name}
    if file:
        path, plus, minus, cell, wall = file
        size = {"cell": float(cell), "thickness": float(wall)}
        cases = {path: (lambda: path, {"openings": {"+": plus, "-": minus}} | size)}
    for name, (make, asked) in cases.items():
        for surface in surfaces:
            body, begun = make(), time.process_time()
            options = {"cell": 10, "thickness": 1, "transition": transition, "progress": False} | asked
            try:
                made = tpmscad.fluid_domains(body, surface, **options)
            except tpmscad.TpmscadError as error:
                print(f"{name}, {surface}: {time.process_time() - begun:.1f} CPU s, {error}", flush=True)
                continue
            seconds, found = time.process_time() - begun, made.certificate
            (read,) = read_bodies(body)
            volume = read.volume
            wall = made.wall.volume / made.volume
            pieces = [len(model.certificate.pieces) for model in made.domains.values()]
            areas = [
                f"{domain} {area:.4g} on {contact.label}"
                for contact in made.touches
                for domain, area in contact.areas.items()
                if domain != "wall"
            ]
            print(
                f"{name}, {surface}: {seconds:.1f} CPU s, {'met' if found.met else found.shortfalls}, volume "
                f"{made.volume / volume - 1:+.1e} off, {wall:.1%} wall, pieces {pieces}; {'; '.join(areas)}",
                flush=True,
            )


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cells", type=int, default=2)
    parser.add_argument("--size", type=float, nargs="+")
    parser.add_argument("--cell-size", type=float, nargs="+", default=[0.1, 0.07])
    parser.add_argument("--stubs", type=float, default=0.0, help="length of a duct in front of every opening, mm")
    parser.add_argument("--openfoam", type=Path, help="folder of the cases")
    parser.add_argument("--openings", action="store_true", help="exchangers with openings in several bodies")
    parser.add_argument("--surface", nargs="+", default=["gyroid", "diamond", "primitive"])
    parser.add_argument("--case", default="", help="a part of the name of those that are made")
    parser.add_argument("--transition", type=float, help="length over which channels close, mm")
    parser.add_argument("--file", nargs=5, metavar=("PART", "PLUS", "MINUS", "CELL", "WALL"), help="a CAD file")
    given = parser.parse_args()
    if given.openings:
        run_openings(given.surface, given.case, given.transition, given.file)
        return
    if given.openfoam:
        if shutil.which("simpleFoam") is None:
            raise SystemExit("OpenFOAM is not installed: its cases are not run (apt-get install openfoam)")
        run_period(given.openfoam, given.cell_size)
        run_exchanger(given.openfoam, given.size or [2.0, 1.2], given.stubs)
        return
    size = given.size[0] if given.size else 1.3
    edge = 10.0 * given.cells
    body = bd.Pos(edge / 2, edge / 2, edge / 2) * bd.Box(edge, edge, edge)
    parts = tpmscad.fluid_domains(body, "gyroid", cell=10, thickness=1, tol=0.02, progress=False)
    begun = time.process_time()
    mesh = parts.mesh(size, progress=False)
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
