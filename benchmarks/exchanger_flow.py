"""Flow and heat of exchangers by OpenFOAM, beside what correlations say.

    python -m benchmarks.exchanger_flow FOLDER [--size 2 1.2] [--stubs 10] [--cell-size 0.1 0.07]
    python -m benchmarks.exchanger_flow FOLDER --case counter --surface diamond --size 2 1.4 --velocity 0.012

Cases are written into the folder and run: a box of 30 x 20 x 20 in cross flow, whose channels open at two sides each, at each
size, and a period of one channel of a gyroid at porosity 1/2 at each cell size, whose pressure drop is compared with the
permeability by finite elements. With --case it is one of the bodies of `exchanger_bodies` instead.
"""

from __future__ import annotations

import argparse
import re
import resource
import shutil
import subprocess
from functools import partial
from pathlib import Path
from typing import Any

import build123d as bd
import numpy as np

import tpmscad
from benchmarks.exchanger_bodies import CASES, CROSS, SURFACES
from tpmscad.meshing.openfoam_case import (
    COLD,
    HOT,
    PASCAL_PER_UNIT,
    WATER_DENSITY,
    WATER_HEAT_CAPACITY,
    WATER_VISCOSITY,
)
from tpmscad.meshing.volume_mesh import VolumeMesh
from tpmscad.simulation.permeability import permeability
from tpmscad.studies._estimate_exchanger import KELVIN

WATER = {
    "density": WATER_DENSITY,
    "viscosity": 1e-6 * WATER_VISCOSITY * WATER_DENSITY,
    "conductivity": WATER_HEAT_CAPACITY * WATER_VISCOSITY / 5.83,
    "specific_heat": 1e6 * WATER_HEAT_CAPACITY / WATER_DENSITY,
}
"""The fluid of a case, in SI units, at a Prandtl number of 5.83."""


def run_case(mesh: VolumeMesh, folder: Path, velocity: float) -> str:
    """Write a case and run it; what it prints."""
    mesh.write_openfoam(folder, velocity=velocity)
    begun = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
    done = subprocess.run([folder / "Allrun"], capture_output=True, text=True, check=False)
    seconds = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - begun
    print(f"{folder.name}: {mesh.n_cells} tetrahedra, {seconds:.0f} CPU s\n{done.stdout}{done.stderr}", flush=True)
    return done.stdout


def run_exchanger(folder: Path, sizes: list[float], stubs: float, case: str, surface: str, velocity: float) -> None:
    """Flow and heat of an exchanger with openings, in front of which there are stubs of a length, beside the estimate.

    Without the name of a case it is the box.
    """
    asked: dict[str, Any] = {"thickness": 1.0, "tol": 0.1, "openings": CROSS}
    if case:
        make, given = next(made for name, made in CASES.items() if case in name)
        asked |= given | {"cell": given["cell"][SURFACES.index(surface)]}
    else:  # as measured; without a transition channels end with creases
        make = partial(bd.Box, 30, 20, 20)
        asked |= {"cell": 10, "phase": (0.1, 0.2, 0.3), "transition": 6}
    domains = tpmscad.fluid_domains(make(), surface, progress=False, **asked)
    streams = {}
    for name, sign, temperature, enters in (("plus", "+", HOT, min), ("minus", "-", COLD, max)):  # as the case does
        axis = "XYZ".index(asked["openings"][sign][1])
        opened = {
            of.centre[axis]: of.areas[f"channel {sign}"] for of in domains.touches if f"channel {sign}" in of.areas
        }
        streams[name] = WATER | {
            "volume_flow": velocity * opened[enters(opened)] / 1e6,
            "temperature": temperature - KELVIN,
        }
    arrangement = "counter" if asked["openings"]["+"] == asked["openings"]["-"] else "cross"
    try:
        print(domains.estimate_exchanger(**streams, arrangement=arrangement, wall_conductivity=200.0), flush=True)
    except tpmscad.InvalidRequest as error:  # no correlation of heat holds here
        print(error)
    for size in sizes:
        mesh = domains.mesh(size, order=1, progress=False)
        run_case(mesh.add_stubs(stubs) if stubs else mesh, folder / f"exchanger_{size:g}", velocity)


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


def main() -> None:
    """Run the cases."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="of the cases; new ones only")
    parser.add_argument("--size", type=float, nargs="+", default=[2.0, 1.2])
    parser.add_argument("--cell-size", type=float, nargs="+", default=[0.1, 0.07])
    parser.add_argument("--stubs", type=float, default=0.0, help="length of a duct in front of every opening, mm")
    parser.add_argument("--velocity", type=float, default=0.01, help="in the inlets of a case, m/s")
    parser.add_argument("--surface", default=SURFACES[0], choices=SURFACES)
    parser.add_argument("--case", default="", help="a part of the name of a body")
    given = parser.parse_args()
    if shutil.which("simpleFoam") is None:
        raise SystemExit("OpenFOAM is not installed: its cases are not run (apt-get install openfoam)")
    if not given.case:
        run_period(given.folder, given.cell_size)
    run_exchanger(given.folder, given.size, given.stubs, given.case, given.surface, given.velocity)


if __name__ == "__main__":
    main()
