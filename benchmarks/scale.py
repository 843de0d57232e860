"""From the request to the verified file: time, memory and size of lattices of 1 to 1000 cells, each in a process of its own.

    python -m benchmarks.scale [--surfaces gyroid,diamond,schwarz_p] [--cells 1,2,3,5,10] [--instanced 5] [--verify kernel]

Cell 10, thickness 1, tol 0.01. `made` is `tpmscad.lattice` without its check, with the start of Python; `check` its check; `file`
`export_step`: writing and verification. `--instanced` is `tpmscad.export_instances`, whose figures of a cell include the file.
Wall and CPU seconds; the peak is the resident memory of the process.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

CELL, THICKNESS, TOL = 10.0, 1.0, 0.01


def measure(surface: str, cells: int, instanced: bool, verify: str | None) -> dict[str, Any]:
    """One row, in this process."""
    import tpmscad

    request = {"cell": CELL, "cells": (cells,) * 3, "thickness": THICKNESS, "tol": TOL}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "lattice.step"
        if instanced:
            certificate = tpmscad.export_instances(surface, path, verify=verify, **request).certificate
            made = _elapsed()[0]
        else:
            model = tpmscad.lattice(surface, **request)
            certificate, made = model.certificate, _elapsed()[0]
            model.export_step(path, verify=verify)
        wall, cpu = _elapsed()
        size = path.stat().st_size / 1e6
    check = certificate.seconds["check"]
    return {
        "met": certificate.met,
        "made": made - check,
        "check": check,
        "file": wall - made,
        "wall": wall,
        "cpu": cpu,
        "faces": certificate.n_faces,
        "MB": size,
        "GiB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024**2,
    }


def _elapsed() -> tuple[float, float]:
    """Wall and CPU seconds since this process began."""
    began = float(Path("/proc/self/stat").read_text().rsplit(")", 1)[1].split()[19]) / 100  # in ticks of 10 ms
    since_boot = time.clock_gettime(time.CLOCK_BOOTTIME)
    used = resource.getrusage(resource.RUSAGE_SELF)
    return since_boot - began, used.ru_utime + used.ru_stime


def measure_apart(*arguments: Any) -> dict[str, Any]:
    """One row, in a process of its own."""
    code = f"import json; from benchmarks.scale import measure; print(json.dumps(measure(*{arguments!r})))"
    environment = {
        k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"
    }  # compiles all sources every time
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=environment)
    return dict(json.loads(done.stdout.splitlines()[-1]))


def run(surfaces: list[str], counts: list[int], instanced: list[int], verify: str | None) -> None:
    """Print the table."""
    columns = ("made", "check", "file", "wall", "cpu", "faces", "MB", "GiB")
    print(f"{'lattice':24}" + "".join(f"{c:>9}" for c in columns))
    rows = [(s, n, False) for s in surfaces for n in counts] + [(surfaces[0], n, True) for n in instanced]
    for surface, n, once in rows:
        row = measure_apart(surface, n, once, verify)
        name = f"{surface} {n}x{n}x{n}{' inst.' if once else ''}{'' if row['met'] else ' NOT MET'}"
        print(
            f"{name:24}" + "".join(f"{row[c]:9.6g}" if c == "faces" else f"{row[c]:9.2f}" for c in columns), flush=True
        )


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--surfaces", default="gyroid,diamond,schwarz_p")
    parser.add_argument("--cells", default="1,2,3,5,10")
    parser.add_argument("--instanced", default="")
    parser.add_argument("--verify", choices=["kernel"])
    given = parser.parse_args()
    numbers = [[int(n) for n in text.split(",") if n] for text in (given.cells, given.instanced)]
    run(given.surfaces.split(","), *numbers, given.verify)
