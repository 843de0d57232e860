"""Lattices of the surfaces without exact patches: one cell and 2 x 2 x 2, sheets of 20 and 30 % volume.

    python -m benchmarks.field_lattices [SURFACE ...]

Every row is made in its own process, so that no layout or fit is reused; seconds count from the call, without imports.
CPU seconds are those of the process and its threads. The limit is that of two cores of a quiet machine.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from typing import Any

SURFACES = ("lidinoid", "split_p", "fischer_koch_s", "octo")
CELLS = (1, 2)
FRACTIONS = (0.2, 0.3)
CELL = 10.0


def make_row(name: str, cells: int, fraction: float) -> dict[str, Any]:
    """The figures of one lattice."""
    import tpmscad

    wall, cpu = time.perf_counter(), time.process_time()
    model = tpmscad.lattice(name, cell=CELL, cells=cells, volume_fraction=fraction)
    seconds, cpu = time.perf_counter() - wall, time.process_time() - cpu
    certificate = model.certificate
    return {
        "surface": name,
        "cells": cells,
        "fraction": fraction,
        "met": certificate.met,
        "faces": certificate.n_faces,
        "primitives": certificate.n_primitives,
        "deviation": certificate.max_deviation,
        "jump": certificate.tangent_jump_deg,
        "volume": model.volume / (CELL * cells) ** 3,
        "betti": certificate.betti,
        "seconds": seconds,
        "cpu": cpu,
    }


def main(arguments: list[str]) -> None:
    """Print the table."""
    if arguments[:1] == ["--row"]:
        name, cells, fraction = arguments[1:]
        print(json.dumps(make_row(name, int(cells), float(fraction))))
        return
    print(
        f"{'surface':15} cells  %  met  faces primitives deviation  jump deg    fraction  betti             seconds    cpu"
    )
    for name in arguments or SURFACES:
        for cells in CELLS:
            for fraction in FRACTIONS:
                command = [sys.executable, "-m", "benchmarks.field_lattices", "--row", name, str(cells), str(fraction)]
                done = subprocess.run(command, capture_output=True, text=True, check=False)
                if done.returncode:
                    print(
                        f"{name:15} {cells:5} {100 * fraction:2.0f}  {done.stderr.strip().splitlines()[-1]}", flush=True
                    )
                    continue
                row = json.loads(done.stdout.splitlines()[-1])
                print(
                    f"{name:15} {cells:5} {100 * fraction:2.0f} {row['met']!s:5} {row['faces']:6} {row['primitives']:9} "
                    f"{row['deviation']:10.2e} {row['jump']:8.2f} {row['volume']:12.7f}  {tuple(row['betti'])!s:16} "
                    f"{row['seconds']:8.1f} {row['cpu']:6.1f}",
                    flush=True,
                )


if __name__ == "__main__":
    main(sys.argv[1:])
