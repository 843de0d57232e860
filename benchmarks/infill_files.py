"""Cylinders of many cells in one STEP file: seconds, memory, size, and what the kernel and gmsh read of it.

    python -m benchmarks.infill_files [--cells 500,2000,8000] [--jobs 2] [--check 2000] [--gmsh 500]

Upright cylinders as high as wide, gyroid cells of 1 mm, walls of .12, tol .005. Each file is made in a process of its own, whose
workers are those of `--jobs`; memory is the greatest of one process. Files of up to `--check` cells are read by the kernel as a
whole, with every face checked, those of up to `--gmsh` cells by gmsh: numbers of solids, and their volume over the one stated.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

MAKE = """
import json, resource, sys, time
import build123d as bd
import tpmscad
from tpmscad.parallel import start_processes

if __name__ == "__main__":
    radius, path, jobs = float(sys.argv[1]), sys.argv[2], int(sys.argv[3])
    begun = time.perf_counter()
    with start_processes(jobs) as executor:
        file = tpmscad.export_infill(
            bd.Cylinder(radius, 2 * radius), "gyroid", path, cell=1, thickness=0.12, tol=0.005, executor=executor, progress=False
        )
    seconds = time.perf_counter() - begun
    used = [resource.getrusage(which) for which in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    found = file.to_dict() | {"seconds": seconds, "cpu": sum(u.ru_utime + u.ru_stime for u in used)}
    print(json.dumps(found | {"memory": max(u.ru_maxrss for u in used) / 2**20, "certificates": []}))
"""

READ = """
import json, sys
import tpmscad

shape = tpmscad.check_step(sys.argv[1]).shape
print(json.dumps({"ok": shape.ok, "solids": shape.solids, "volume": shape.volume}))
"""

READ_BY_GMSH = """
import json, sys
import gmsh

gmsh.initialize()
gmsh.option.setNumber("General.Terminal", 0)
gmsh.model.occ.importShapes(sys.argv[1])
gmsh.model.occ.synchronize()
solids = gmsh.model.getEntities(3)
print(json.dumps({"ok": True, "solids": len(solids), "volume": sum(gmsh.model.occ.getMass(3, tag) for _, tag in solids)}))
"""


def run(code: str, folder: Path, *arguments: object) -> dict[str, Any]:
    """What a program of its own prints as JSON."""
    script = folder / "run.py"
    script.write_text(code)
    done = subprocess.run([sys.executable, script, *map(str, arguments)], capture_output=True, text=True, check=True)
    found: dict[str, Any] = json.loads(done.stdout.strip().splitlines()[-1])
    return found


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--cells", default="500,2000,8000")
    options.add_argument("--jobs", type=int, default=2)
    options.add_argument("--check", type=int, default=2000)
    options.add_argument("--gmsh", type=int, default=500)
    given = options.parse_args()
    for cells in map(int, given.cells.split(",")):
        radius = float(np.cbrt(cells / (2 * np.pi)))
        with tempfile.TemporaryDirectory() as place:
            folder, path = Path(place), Path(place) / "filled.step"
            made = run(MAKE, folder, radius, path, given.jobs)
            print(
                f"{cells:6d} cells: {made['whole_cells']} whole, {made['layers']} layers ({made['stored_layers']} stored), "
                f"{made['parts']} solids, {made['faces']} faces, {made['bytes'] / 1e6:.0f} MB, {made['seconds']:.0f} s, "
                f"{made['cpu']:.0f} CPU s, {made['memory']:.2f} GiB, deviation {made['deviation']:.2g}",
                flush=True,
            )
            for reader, code, most in (("kernel", READ, given.check), ("gmsh", READ_BY_GMSH, given.gmsh)):
                if cells <= most:
                    begun = time.perf_counter()
                    read = run(code, folder, path)
                    state, off = "ok" if read["ok"] else "NOT ok", read["volume"] / made["volume"] - 1
                    seconds = time.perf_counter() - begun
                    print(
                        f"       {reader}: {state}, {read['solids']} solids, volume {off:+.1e}, {seconds:.0f} s",
                        flush=True,
                    )


if __name__ == "__main__":
    main()
