"""Meshes of results: inverted elements, quality, size, volume, groups, periodic pairs, and who reads their files.

    python -m benchmarks.meshes [NAME ...] [--periodic] [--size FACTOR]

--periodic: the cells of anything that repeats (fields, blends, both phases, struts) in place of the first ten.

Needs gmsh, meshio and scikit-fem; CalculiX is asked too if `ccx` is on the path (Debian: apt-get install calculix-ccx).
"""

from __future__ import annotations

import argparse
import contextlib
import io
import logging
import re
import shutil
import subprocess
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import build123d as bd
import numpy as np

import tpmscad
from tpmscad import fields
from tpmscad.meshing.element_shapes import scaled_jacobians
from tpmscad.meshing.volume_mesh import VolumeMesh


def make_bracket() -> Any:
    """A bracket with a hole, filled with gyroid."""
    body = bd.Pos(15, 10, 5) * bd.Box(30, 20, 10) - bd.Pos(22, 10, 5) * bd.Cylinder(4, 10)
    return tpmscad.infill(body, "gyroid", cell=10, thickness=1.5, tol=0.02)


def make_ring() -> Any:
    """A lattice wrapped around a cylinder."""
    return tpmscad.lattice(
        "gyroid", cell=10, cells=(12, 1, 1), thickness=1.5, map=tpmscad.maps.cylinder(60.0 / np.pi), tol=0.02
    )


def make_graded() -> Any:
    """A gyroid wall that is thicker at the top."""
    phi = fields.tpms("gyroid", period=10.0)
    return tpmscad.solidify(fields.wall(phi, lambda p: 1.2 + 0.08 * p[..., 2]), ((0, 0, 0), (10, 10, 10)), tol=0.02)


def make_blend() -> Any:
    """A gyroid rod that becomes a Schwarz P rod."""
    rods = [fields.rod(fields.tpms(name, period=10.0), 0.0) for name in ("gyroid", "schwarz_p")]
    weight = fields.ramp("x", span=(5.0, 15.0), values=(0.0, 1.0), smooth=True)
    first, second = rods
    mixed = fields.from_function(lambda p: (1.0 - weight(p)) * first(p) + weight(p) * second(p))
    return tpmscad.solidify(mixed, ((0, 0, 0), (20, 10, 10)), tol=0.03)


def cell_of(field: Callable[[], Any], tol: float = 0.02, size: tuple[float, float, float] = (10.0, 10.0, 10.0)) -> Any:
    """Makes the solid of a field in a box of whole periods, loose pieces included: they go on at the opposite side."""
    return lambda: tpmscad.solidify(field(), ((0.0, 0.0, 0.0), size), tol=tol, loose="keep", progress=False)


def make_graded_sheet() -> Any:
    """A Diamond sheet whose level goes up and down once along z."""
    level = fields.expression(f"0.35+0.15*cos({2 * np.pi / 10:.16g}*z)")
    return fields.sheet(
        fields.tpms("diamond", 10.0), fields.expression(f"-0.35-0.15*cos({2 * np.pi / 10:.16g}*z)"), level
    )


def make_waves() -> Any:
    """A spinodoid that repeats: waves along all directions (h, k, l) of h^2 + k^2 + l^2 = 2, of random phases, in 10 mm."""
    rng = np.random.default_rng(4)
    vectors = np.array([v for v in np.ndindex(3, 3, 3) if ((np.array(v) - 1) ** 2).sum() == 2]) - 1
    vectors = vectors[[tuple(v) > (0, 0, 0) for v in vectors.tolist()]]
    phases = rng.uniform(0, 2 * np.pi, len(vectors))
    terms = "+".join(
        f"cos({2 * np.pi / 10:.16g}*({h}*x+{k}*y+{n}*z)+{phase:.16g})"
        for (h, k, n), phase in zip(vectors.tolist(), phases.tolist(), strict=True)
    )
    return fields.expression(f"({terms})/{len(vectors) ** 0.5:.16g}-0.1")


def make_periodic_blend() -> Any:
    """A gyroid rod that becomes a Schwarz P rod and a gyroid again, in 20 mm."""
    first, second = ("sin(a*x)*cos(a*y)+sin(a*y)*cos(a*z)+sin(a*z)*cos(a*x)", "cos(a*x)+cos(a*y)+cos(a*z)")
    a = f"{2 * np.pi / 10:.16g}"
    weight = f"(0.5-0.5*cos({2 * np.pi / 20:.16g}*x))"
    return fields.expression(f"(1-{weight})*({first})+{weight}*({second})".replace("a*", f"{a}*"))


def make_phases(surface: str) -> Callable[[], Any]:
    """The wall of a cell and both channels, with common nodes."""
    return lambda: tpmscad.fluid_domains(
        bd.Box(10, 10, 10, align=bd.Align.MIN), surface, cell=10, thickness=1.2, tol=0.02, progress=False
    )


def make_struts(kind: str, diameter: float, node_radius: float = 0.0) -> Callable[[], Any]:
    """A cell of struts."""
    return lambda: tpmscad.struts(kind, cell=10, diameter=diameter, node_radius=node_radius, progress=False)


def make_diamond_struts() -> Any:
    """A cell in the middle of a lattice of diamond struts, whose sides cut struts of both neighbours and no node."""
    field = fields.strut_lattice("diamond", 10.0, 1.4, 3)
    return tpmscad.solidify(field, ((11.25,) * 3, (21.25,) * 3), tol=0.02, loose="keep", progress=False)


def make_cell(surface: str) -> Callable[[], Any]:
    """A cell of a sheet."""
    return lambda: tpmscad.lattice(surface, cell=10, volume_fraction=0.25, tol=0.02)


CASES: dict[str, tuple[Callable[[], Any], float, bool]] = {
    **{
        name: (make_cell(name), size, True)
        for name, size in (
            *(("gyroid", 0.8), ("diamond", 0.49), ("schwarz_p", 0.9)),
            *(("iwp", 0.7), ("neovius", 0.42), ("frd", 0.28)),
        )
    },
    "bracket": (make_bracket, 0.6, False),
    "ring": (make_ring, 1.2, False),
    "graded": (make_graded, 0.9, False),
    "blend": (make_blend, 0.9, False),
}
"""Name, maker, size and whether the mesh is periodic."""

PERIODIC_CASES: dict[str, tuple[Callable[[], Any], float, bool]] = {
    "field sheet": (cell_of(lambda: fields.sheet(fields.tpms("gyroid", 10.0), -0.35, 0.35)), 0.8, True),
    "graded sheet": (cell_of(make_graded_sheet), 0.7, True),
    "field rod": (cell_of(lambda: fields.rod(fields.tpms("iwp", 10.0), 1.0)), 0.9, True),
    "spinodoid": (cell_of(make_waves), 0.9, True),
    "blend": (cell_of(make_periodic_blend, size=(20.0, 10.0, 10.0)), 1.0, True),
    "gyroid phases": (make_phases("gyroid"), 1.0, True),
    "P phases": (make_phases("P"), 1.0, True),
    "bcc": (make_struts("bcc", 2.0), 0.8, True),
    "octet, balls": (make_struts("octet", 1.2, 1.0), 0.5, True),
    "diamond struts": (make_diamond_struts, 0.6, True),
    "struts + wall": (
        cell_of(
            lambda: fields.strut_lattice("octet", 10.0, 1.0) | fields.sheet(fields.tpms("gyroid", 10.0), -0.2, 0.2)
        ),
        0.6,
        True,
    ),
}
"""The same of whatever repeats."""


def count_warnings(read: Callable[[], Any]) -> int:
    """Warnings and lines of a log or on standard output while a file is read; -1 if it cannot be read."""
    stream, handler = io.StringIO(), logging.StreamHandler(log := io.StringIO())
    logging.getLogger().addHandler(handler)
    try:
        with warnings.catch_warnings(record=True) as caught, contextlib.redirect_stdout(stream):
            warnings.simplefilter("always")
            read()
    except Exception:  # whatever another library raises: the file was not read
        return -1
    finally:
        logging.getLogger().removeHandler(handler)
    return len(caught) + len(log.getvalue().splitlines()) + len(stream.getvalue().split())


def read_by_calculix(path: Path) -> int | None:
    """Warnings and errors of CalculiX as it checks a mesh with a material and a step; None without CalculiX."""
    if shutil.which("ccx") is None:
        return None
    job = path.with_name("job.inp")
    job.write_text(
        f"*INCLUDE, INPUT={path.name}\n*MATERIAL, NAME=M\n*ELASTIC\n1., 0.3\n*SOLID SECTION, ELSET=EALL, MATERIAL=M\n"
        "*NSET, NSET=FIRST\n1\n*BOUNDARY\nFIRST, 1, 3\n*STEP\n*STATIC\n*END STEP\n"
    )
    done = subprocess.run(["ccx", "-i", "job"], cwd=path.parent, capture_output=True, text=True, check=False)
    found = re.findall(r"\*(?:WARNING|ERROR)", done.stdout + done.stderr)
    return len(found) + int(done.returncode != 0)


def readers(mesh: VolumeMesh) -> dict[str, int | None]:
    """Warnings of each reader of the files of a mesh."""
    import meshio
    import skfem

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder)
        for name in ("mesh.msh", "mesh.vtu", "mesh.inp"):
            mesh.write(path / name)
        return {
            "meshio .msh": count_warnings(lambda: meshio.read(path / "mesh.msh")),
            "meshio .vtu": count_warnings(lambda: meshio.read(path / "mesh.vtu")),
            "skfem .vtu": count_warnings(lambda: skfem.Mesh.load(str(path / "mesh.vtu"))),
            "skfem": count_warnings(mesh.to_skfem),
            "ccx": read_by_calculix(path / "mesh.inp"),
        }


def volume_of(model: Any) -> float:
    """The volume of a model, or of all domains."""
    return float(sum(part.volume for part in model.domains.values()) if hasattr(model, "domains") else model.volume)


def mean_scaled_jacobian(mesh: VolumeMesh) -> float:
    """Mean over elements of the scaled Jacobian."""
    found = [scaled_jacobians(kind, mesh.points, cells) for kind, cells in mesh.cells.items()]
    return float(np.concatenate(found).mean())


def main() -> None:
    """Mesh the cases and print a row for each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*")
    parser.add_argument("--periodic", action="store_true")
    parser.add_argument("--per-turn", type=int, help="elements along a full turn of curvature")
    parser.add_argument("--size", type=float, default=1.0, help="factor of all sizes")
    options = parser.parse_args()
    print(
        "case            size   nodes   elements inverted straight    SICN       SJ mean SJ   mean size    volume off groups "
        "pairs   mismatch    moved deviation merged collapsed swapped split shifted   s  warnings"
    )
    cases = CASES | PERIODIC_CASES
    for name in options.names or (PERIODIC_CASES if options.periodic else CASES):
        make, size, periodic = cases[name]
        try:
            model = make()
            begun = time.process_time()
            mesh = model.mesh(size * options.size, periodic=periodic, per_turn=options.per_turn)
        except tpmscad.TpmscadError as error:
            print(f"{name:14} refused: {error}", flush=True)
            continue
        seconds = time.process_time() - begun
        quality = mesh.quality
        pairs = sum(map(len, mesh.periodic.values()))
        covered = np.unique(np.concatenate(list(mesh.facet_groups.values()))).size == mesh.n_facets
        print(
            f"{name:14} {size * options.size:5.2f} {len(mesh.points):7d} {mesh.n_cells:10d} {quality.inverted:8d} "
            f"{mesh.straightened:8d} {quality.smallest:7.4f} {quality.smallest_scaled_jacobian:8.5f} "
            f"{mean_scaled_jacobian(mesh):7.3f} {quality.size / size / options.size:6.3f} of it "
            f"{mesh.volume / volume_of(model) - 1.0:10.1e} {len(mesh.facet_groups):5d}{'' if covered else '!'} {pairs:6d} "
            f"{mesh.mismatch:10.1e} {mesh.moved:8.1e} {mesh.deviation:9.1e} {mesh.merged:6d} {mesh.collapsed:9d} "
            f"{mesh.swapped:7d} {mesh.split:5d} {mesh.shifted:7d} {seconds:5.0f}  {readers(mesh)}",
            flush=True,
        )


if __name__ == "__main__":
    main()
