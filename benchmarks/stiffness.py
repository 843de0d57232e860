"""Effective properties of cells: a table over volume fractions with errors, limits of thin sheets, and level sheets.

    python -m benchmarks.stiffness table gyroid:0.1,0.2,0.3 P:0.2
    python -m benchmarks.stiffness table iwp:0.1,0.2,0.3 --reference minimal
    python -m benchmarks.stiffness levels gyroid:0.2,0.3 P:0.2,0.3
    python -m benchmarks.stiffness thin gyroid:0.05 gyroid-levels:0.05 gyroid-and-P:0.05 bcc:0.05,0.01 octet:0.05

Young's modulus 1, Poisson's ratio 0.3. `table` also extrapolates K / rho and k / rho to rho = 0 by a polynomial through the
fractions given, against 2 / (9 (1 - nu)) and 2 / 3 (arXiv 2506.18910 and 2506.22319). `levels` compares a sheet of uniform normal
thickness around the exact minimal surface with the level sheet |f| < c of equal volume. Both are the same hexahedra, whose nodes
are moved along the gradient to the levels f = s c, where s is their place through the wall from -1 to 1.

`thin` compares walls with K = 2 rho / (9 (1 - nu)) and k = 2 rho / 3, the limits of thin sheets, and struts with K = rho / 9 and
k = rho / 3, what struts in tension alone carry if each has the mean strain along its axis. Its cells are kinds of struts,
surfaces, "gyroid-levels" for a level sheet, and "gyroid-and-P" for the level sheet of the mean of both functions.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

import tpmscad
from tpmscad import fields
from tpmscad._typing import Array
from tpmscad.meshing.volume_mesh import VolumeMesh
from tpmscad.simulation.periodic_cell import CellProperties, IsotropicMaterial, solve_cell
from tpmscad.strut_cells import KINDS

POISSON_RATIO = 0.3
THIN_SHEET = {"K": 2.0 / (9.0 * (1.0 - POISSON_RATIO)), "k": 2.0 / 3.0}
CUTS = (3, 1)
NEWTON_STEPS, SECANT_STEPS = 8, 12


def print_table(name: str, fractions: Sequence[float], reference: str | None = None) -> None:
    """Rows of one surface, and its limits."""
    ratios: dict[str, list[float]] = {"K": [], "k": []}
    for fraction in fractions:
        found = tpmscad.homogenize(
            name, volume_fraction=fraction, reference=reference, poisson_ratio=POISSON_RATIO, progress=False
        )
        values = [*found.cubic_constants, found.engineering_constants["E1"], found.engineering_constants["nu12"]]
        values += [found.zener_ratio, found.hashin_shtrikman_ratio, float(np.trace(found.conductivity)) / 3.0]
        print(
            f"{name:10} {fraction:.2f} "
            + " ".join(f"{value:8.5f}" for value in values)
            + f" {found.cells:6d} {found.unknowns:7d} {found.error:8.1e} {found.cubic_deviation:8.1e} {found.seconds:5.0f}",
            flush=True,
        )
        ratios["K"].append(found.bulk_modulus / fraction)
        ratios["k"].append(values[-1] / fraction)
    if len(fractions) > 1:
        for key, limit in THIN_SHEET.items():
            at_zero = float(np.polyfit(fractions, ratios[key], len(fractions) - 1)[-1])
            print(
                f"{name:10} {key} / rho tends to {at_zero:.4f}, {at_zero / limit - 1:+.2%} off the limit of thin sheets"
            )


def places_through_wall(mesh: VolumeMesh) -> Array:
    """For each node its place through a wall of two layers of hexahedra: -1, -0.5, 0, 0.5 or 1."""
    (cells,) = mesh.cells.values()
    upper, lower = (np.isin(cells, mesh.node_sets[name]).any(axis=1) for name in ("surface +", "surface -"))
    if not (upper ^ lower).all():
        raise SystemExit("the wall has not two layers of elements")
    place = np.zeros(len(mesh.points))
    inside = np.zeros((2, len(mesh.points)), bool)
    for side, layer in enumerate((lower, upper)):
        inside[side, cells[layer]] = True
    place[inside[1] & ~inside[0]] = 0.5
    place[inside[0] & ~inside[1]] = -0.5
    place[mesh.node_sets["surface +"]] = 1.0
    place[mesh.node_sets["surface -"]] = -1.0
    return place


def make_level_sheet(mesh: VolumeMesh, name: str) -> tuple[VolumeMesh, float]:
    """The mesh moved to the level sheet of equal volume, and its level c."""
    phi, place = fields.tpms(name, period=1.0), places_through_wall(mesh)
    values = phi(mesh.points)
    if (values * place).sum() < 0.0:
        place = -place

    def move(level: float) -> VolumeMesh:
        points = mesh.points.copy()
        for _ in range(NEWTON_STEPS):
            gradient = phi.gradient(points)
            off = phi(points) - level * place
            points -= (off / (gradient**2).sum(axis=1))[:, None] * gradient
        return replace(mesh, points=points)

    level = float(np.abs(values[np.abs(place) == 1.0]).mean())
    levels = [0.97 * level, level]
    misses = [move(each).volume - mesh.volume for each in levels]
    for _ in range(SECANT_STEPS):
        if abs(misses[-1]) < 1e-10 * mesh.volume:
            break
        levels.append(levels[-1] - misses[-1] * (levels[-1] - levels[-2]) / (misses[-1] - misses[-2]))
        misses.append(move(levels[-1]).volume - mesh.volume)
    return move(levels[-1]), levels[-1]


def describe(found: CellProperties) -> Array:
    """C11, C12, C44, Young's modulus along an axis, bulk modulus and conductivity."""
    c = found.stiffness
    c11, c12, c44 = np.diag(c)[:3].mean(), (c[0, 1] + c[0, 2] + c[1, 2]) / 3.0, np.diag(c)[3:].mean()
    young = c11 - 2.0 * c12**2 / (c11 + c12)
    return np.array([c11, c12, c44, young, (c11 + 2.0 * c12) / 3.0, np.trace(found.conductivity) / 3.0])


def compare_levels(name: str, fraction: float, cuts: tuple[int, int]) -> None:
    """Uniform thickness against a level sheet of the same volume."""
    model = tpmscad.lattice(
        name, cell=1.0, volume_fraction=fraction, boundary="natural", reference="minimal", progress=False
    )
    uniform = model.hexahedra(2, cuts)
    level, c = make_level_sheet(uniform, name)
    material = IsotropicMaterial(poisson_ratio=POISSON_RATIO)
    a, b = (describe(solve_cell(mesh, material)) for mesh in (uniform, level))
    head = f"{name:10} {fraction:.2f} {uniform.n_cells:5d}"
    print(f"{head}  uniform          " + " ".join(f"{value:8.5f}" for value in a))
    print(f"{head}  |f| < {c:7.5f}    " + " ".join(f"{value:8.5f}" for value in b))
    print(
        f"{head}  uniform / level  "
        + " ".join(f"{value:8.4f}" for value in a / b)
        + f"   volumes {level.volume / uniform.volume - 1:+.0e}, {level.quality.inverted} inverted",
        flush=True,
    )


def print_thin(name: str, fraction: float) -> None:
    """A thin cell: C11, C12, C44, K and k, with the ratios of K and k to the limits of its kind."""
    cells: dict[str, str | fields.Field] = {
        "gyroid-levels": fields.tpms("gyroid", 1.0),
        "gyroid-and-P": 0.5 * fields.tpms("gyroid", 1.0) + 0.5 * fields.tpms("P", 1.0),
    }
    try:
        found = tpmscad.homogenize(
            cells.get(name, name), volume_fraction=fraction, poisson_ratio=POISSON_RATIO, progress=False
        )
    except tpmscad.TpmscadError as error:
        print(f"{name:15} {fraction:.3f} refused: {error}", flush=True)
        return
    rho = found.volume_fraction
    bulk, conductivity = rho * THIN_SHEET["K"], rho * THIN_SHEET["k"]
    if name in KINDS and name not in tpmscad.surfaces.CATALOGUE:
        bulk, conductivity = rho / 9.0, rho / 3.0  # the traces of <n n n n> and <n n>, whatever the directions
    c11, c12, c44 = found.stiffness[0, 0], found.stiffness[0, 1], found.stiffness[3, 3]
    k = float(np.trace(found.conductivity)) / 3.0
    print(
        f"{name:15} {fraction:.3f} {rho:8.5f} {c11:8.5f} {c12:8.5f} {c44:8.5f} {found.bulk_modulus:8.5f} "
        f"{found.bulk_modulus / bulk:6.3f} {k:8.5f} {k / conductivity:6.3f} {found.error:8.1e} {found.cubic_deviation:8.1e} "
        f"{found.cells:7d} {found.unknowns:7d} {found.seconds:5.0f}",
        flush=True,
    )


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("table", "levels", "thin"))
    parser.add_argument("cases", nargs="+", help="SURFACE:FRACTION[,FRACTION...]")
    parser.add_argument("--cuts", type=int, default=CUTS[0], help="of each patch along its sides, for levels")
    parser.add_argument("--reference", choices=("minimal", "nodal"), help="of the table; by default the surface's own")
    given = parser.parse_args()
    if given.what == "table":
        print(
            "surface     rho      C11      C12      C44        E       nu    Zener   K / HS        k"
            "  cells unknowns   error    cubic     s"
        )
    elif given.what == "thin":
        print(
            "cell            asked      rho      C11      C12      C44        K K/bound      k k/bound  error    cubic"
            "   cells unknowns    s"
        )
    else:
        print("surface     rho cells                        C11      C12      C44        E        K        k")
    for case in given.cases:
        name, _, listed = case.partition(":")
        fractions = [float(each) for each in listed.split(",")]
        if given.what == "table":
            print_table(name, fractions, given.reference)
        elif given.what == "thin":
            for fraction in fractions:
                print_thin(name, fraction)
        else:
            for fraction in fractions:
                compare_levels(name, fraction, (given.cuts, CUTS[1]))


if __name__ == "__main__":
    main()
