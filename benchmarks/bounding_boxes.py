"""Boxes of results: the true extent against those of kernels, in this process and after STEP, relative to the greatest side.

    python -m benchmarks.bounding_boxes [--cadquery PYTHON] [--freecad freecadcmd] [--only NAME ...]

Columns: poles = BRepBndLib::Add without triangulation, optimal = BRepBndLib::AddOptimal (what build123d and CadQuery show); after
STEP both in another Python with CadQuery, and FreeCAD's BoundBox and optimalBoundingBox. Each is the greatest distance of a
corner's coordinate from the true one.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import build123d as bd
import numpy as np
from OCP.Bnd import Bnd_Box
from OCP.BRepBndLib import BRepBndLib

import tpmscad
from tpmscad import fields
from tpmscad.kernel.measure.shape_extents import shape_bounds

CADQUERY_CODE = """
import json, sys
import cadquery as cq
from OCP.Bnd import Bnd_Box
from OCP.BRepBndLib import BRepBndLib
result = {}
for path in sys.argv[1:]:
    shape = cq.importers.importStep(path).val()
    box = Bnd_Box(); BRepBndLib.Add_s(shape.wrapped, box, False); box.SetGap(0.0)
    b = shape.BoundingBox()
    result[path] = [[*box.CornerMin().Coord(), *box.CornerMax().Coord()], [b.xmin, b.ymin, b.zmin, b.xmax, b.ymax, b.zmax]]
print("BOXES" + json.dumps(result))
"""

FREECAD_CODE = """
import json, sys
import Part
result = {}
for path in PATHS:
    shape = Part.Shape(); shape.read(path)
    corners = lambda b: [b.XMin, b.YMin, b.ZMin, b.XMax, b.YMax, b.ZMax]
    result[path] = [corners(shape.BoundBox), corners(shape.optimalBoundingBox())]
print("BOXES" + json.dumps(result))
"""


def bracket() -> Any:
    """An L of two plates."""
    return bd.Box(24, 14, 5) + bd.Pos(-9.5, 0, 9) * bd.Box(5, 14, 13)


CASES: dict[str, Callable[[], Any]] = {
    "gyroid cell": lambda: tpmscad.lattice("gyroid", cell=10, thickness=1, tol=0.05),
    "gyroid cell, fine": lambda: tpmscad.lattice("gyroid", cell=10, thickness=1, tol=0.01),
    "gyroid 2x2x2": lambda: tpmscad.lattice("gyroid", cell=10, cells=2, thickness=1, tol=0.05),
    "diamond, skeletal": lambda: tpmscad.lattice("diamond", cell=10, kind="skeletal", volume_fraction=0.3, tol=0.05),
    "gyroid, natural": lambda: tpmscad.lattice("gyroid", cell=10, thickness=1, tol=0.05, boundary="natural"),
    "stretched cell": lambda: tpmscad.lattice("gyroid", cell=(10, 10, 14), thickness=1, tol=0.05),
    "box infill": lambda: tpmscad.infill(bd.Box(14, 12, 10), "gyroid", cell=6, thickness=0.6, tol=0.03),
    "cylinder infill": lambda: tpmscad.infill(bd.Cylinder(7.3, 9.1), "gyroid", cell=6, thickness=0.6, tol=0.02),
    "bracket infill": lambda: tpmscad.infill(bracket(), "gyroid", cell=6, thickness=0.6, tol=0.03),
    "skinned block": lambda: tpmscad.infill(bd.Box(14, 12, 10), "gyroid", cell=6, thickness=0.6, tol=0.03, skin=1),
    "exchanger's wall": lambda: tpmscad.fluid_domains(bd.Box(20, 10, 10), "gyroid", cell=10, thickness=1, tol=0.05),
    "solid of a field": lambda: tpmscad.solidify(
        fields.sheet(fields.tpms("gyroid", period=10.0), -0.3, 0.3), ((0, 0, 0), (10, 10, 10)), tol=0.05
    ),
}


def solid_of(made: Any) -> tuple[Any, np.ndarray]:
    """The TopoDS shape of a result (of fluid domains the wall's), and its true corners (6,)."""
    model = getattr(made, "wall", made)
    return model.wrapped, np.concatenate(shape_bounds(model.wrapped))


def boxes_of(shape: Any) -> tuple[np.ndarray, np.ndarray]:
    """The corners (6,), (6,) of a shape's boxes by poles and by OCCT's optimum."""
    result = []
    for add in (lambda b: BRepBndLib.Add_s(shape, b, False), lambda b: BRepBndLib.AddOptimal_s(shape, b, False, False)):
        box = Bnd_Box()
        add(box)
        box.SetGap(0.0)
        result.append(np.array([*box.CornerMin().Coord(), *box.CornerMax().Coord()]))
    return result[0], result[1]


def read_elsewhere(command: list[str]) -> dict[str, list[list[float]]]:
    """The boxes that another program prints, by path; none if it cannot be run."""
    try:
        done = subprocess.run(
            command, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=900, check=False
        )
    except (OSError, subprocess.TimeoutExpired):
        return {}
    lines = [line for line in done.stdout.splitlines() if line.startswith("BOXES")]
    return json.loads(lines[-1][5:]) if lines else {}


def main() -> None:
    """Make the results, measure them and print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--cadquery", default="")
    parser.add_argument("--freecad", default="freecadcmd")
    parser.add_argument("--only", nargs="*", default=list(CASES))
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        true: dict[str, np.ndarray] = {}
        here: dict[str, tuple[np.ndarray, np.ndarray]] = {}
        for name in options.only:
            shape, bounds = solid_of(CASES[name]())
            path = str(Path(folder) / f"{list(CASES).index(name)}.step")
            bd.export_step(bd.Compound(shape) if shape.ShapeType().name.endswith("COMPOUND") else bd.Solid(shape), path)
            true[path] = bounds
            here[path] = boxes_of(shape)
            print(f"made {name}", flush=True)
        cadquery = read_elsewhere([options.cadquery, "-c", CADQUERY_CODE, *true]) if options.cadquery else {}
        script = Path(folder) / "boxes.py"
        script.write_text(f"PATHS = {list(true)!r}\n{FREECAD_CODE}")
        freecad = read_elsewhere([options.freecad, str(script)])
        print(f"{'':20} {'true size':>26}   {'here':^17}   {'CadQuery, STEP':^17}   {'FreeCAD, STEP':^17}")
        print(
            f"{'':20} {'':>26}   {'poles':>8} {'optimal':>8}   {'poles':>8} {'optimal':>8}   {'box':>8} {'optimal':>8}"
        )
        for name, (path, bounds) in zip(options.only, true.items(), strict=True):
            size = bounds[3:] - bounds[:3]
            row = []
            for found in (here[path], cadquery.get(path), freecad.get(path)):
                off = [np.abs(np.array(b) - bounds).max() / size.max() for b in found] if found is not None else None
                row.append(f"{off[0]:8.1e} {off[1]:8.1e}" if off else f"{'-':>8} {'-':>8}")
            print(f"{name:20} {' x '.join(f'{s:.4f}' for s in size):>26}   {'   '.join(row)}")


if __name__ == "__main__":
    main()
