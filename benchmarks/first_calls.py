"""Seconds of the first call of `lattice`, `solidify`, `blend` and `infill`, with and without compiled functions kept.

    python -m benchmarks.first_calls [--functions]

Each call is made in a process of its own, twice with one folder of compiled functions that is empty at first. Seconds are of the
call alone, without the import of the package; `compiling` is what numba took of them. With --functions, what each compiled
function took in the first call.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile

CALLS = {
    "lattice": "tpmscad.lattice('gyroid', cell=10, thickness=1, tol=0.05, progress=False)",
    "solidify": "tpmscad.solidify(fields.rod(fields.tpms('gyroid', 10), 0.3), ((0, 0, 0), (10, 10, 10)), tol=0.05, "
    "progress=False)",
    "blend": "tpmscad.blend([fields.rod(fields.tpms(n, 10), 0.0) for n in ('gyroid', 'P')], [fields.box((0, 0, 0), (9, 10, 10)), "
    "fields.box((11, 0, 0), (20, 10, 10))], [fields.box((9, 0, 0), (11, 10, 10))], progress=False)",
    "infill": "tpmscad.infill(bd.Cylinder(8, 12), 'gyroid', cell=8, thickness=0.8, tol=0.05, progress=False)",
}

CHILD = """
import json, time
import build123d as bd
from numba.core import event
import tpmscad
from tpmscad import fields
for name in tpmscad.__all__:
    getattr(tpmscad, name)
with event.install_recorder("numba:compile") as recorder:
    cpu, wall = time.process_time(), time.perf_counter()
    {call}
    cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
begun, took, depth = {{}}, {{}}, 0
total = 0.0
for when, what in recorder.buffer:
    name = str(what.data["dispatcher"].py_func.__name__)
    if what.is_start:
        depth += 1
        begun.setdefault(name, []).append(when)
    else:
        depth -= 1
        seconds = when - begun[name].pop()
        if depth == 0:
            total += seconds
        took[name] = took.get(name, 0.0) + seconds
print(json.dumps([cpu, wall, total, took]))
"""


def measure(call: str, folder: str) -> tuple[float, float, float, dict[str, float]]:
    """CPU and wall seconds of a call, those of compiling, and those by compiled function."""
    environment = os.environ | {"NUMBA_CACHE_DIR": folder}
    answer = subprocess.run(
        [sys.executable, "-c", CHILD.format(call=call)], env=environment, capture_output=True, text=True, check=True
    )
    return tuple(json.loads(answer.stdout.splitlines()[-1]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--functions", action="store_true")
    parser.add_argument("--only", choices=list(CALLS))
    given = parser.parse_args()
    print(
        f"{'call':<10}{'CPU cold':>10}{'wall cold':>11}{'compiling':>11}{'CPU warm':>10}{'wall warm':>11}{'cold/warm':>11}"
    )
    for name, call in CALLS.items():
        if given.only not in (None, name):
            continue
        with tempfile.TemporaryDirectory() as folder:
            cold, warm = measure(call, folder), measure(call, folder)
        row = *cold[:3], *warm[:2], cold[1] / warm[1]
        print(f"{name:<10}" + "".join(f"{value:>11.1f}" for value in row), flush=True)
        if given.functions:
            for function, seconds in sorted(cold[3].items(), key=lambda pair: -pair[1])[:25]:
                print(f"    {function:<40}{seconds:>6.2f}")


if __name__ == "__main__":
    main()
