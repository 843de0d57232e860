"""A sweep of lattices, killed and resumed, by a process pool and by Dask: whether the tables are the same, and seconds.

    python -m benchmarks.sweeps [--designs 60] [--killed-after 20] [--jobs 2] [--folder FOLDER]

The designs are gyroids, diamonds and Schwarz P lattices of rising thickness, the last of each surface too thick to be made,
every fifth with a STEP file. The first sweep runs in a process of its own by the command line and is killed (SIGKILL) once its
table has so many rows; the same command then resumes it. Tables are compared line by line without their last column, the seconds.
"""

from __future__ import annotations

import argparse
import csv
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import chdir
from pathlib import Path
from typing import Any

import tpmscad
from tpmscad.parallel import start_processes

SURFACES = ("gyroid", "diamond", "schwarz_p")
CELL, TOL = 10.0, 0.05
POLL_SECONDS = 0.05


def write_designs(path: Path, count: int) -> None:
    """A table of so many designs in a CSV file."""
    per_surface = -(-count // len(SURFACES))
    rows = [
        (surface, CELL, TOL, round(0.3 + 1.4 * k / per_surface, 4) if k < per_surface - 1 else 9.0)
        for surface in SURFACES
        for k in range(per_surface)
    ][:count]
    with path.open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(("surface", "cell", "tol", "thickness", "file"))
        table.writerows((*row, "{surface}_{thickness}.step" if n % 5 == 0 else "") for n, row in enumerate(rows))


def read_without_seconds(path: Path) -> list[list[str]]:
    """The lines of a table of results but for the last column."""
    with path.open(newline="") as file:
        return [line[:-1] for line in csv.reader(file)]


def run_command(table: Path, output: Path, killed_after: int | None = None) -> int:
    """Rows of the results after `tpmscad sweep`, which is killed once there are so many."""
    process = subprocess.Popen(
        [sys.executable, "-m", "tpmscad", "sweep", str(table), "-o", str(output), "--quiet"],
        cwd=table.parent,
        stderr=subprocess.DEVNULL,
    )
    while process.poll() is None:
        if killed_after is not None and output.exists() and len(read_without_seconds(output)) > killed_after:
            process.send_signal(signal.SIGKILL)
            process.wait()
        time.sleep(POLL_SECONDS)
    return len(read_without_seconds(output)) - 1


def sweep_with_dask(table: Path, output: Path, jobs: int) -> Any:
    """The sweep on a cluster of Dask on this machine."""
    from distributed import Client, LocalCluster

    with (
        LocalCluster(n_workers=jobs, threads_per_worker=1, dashboard_address=None) as cluster,  # type: ignore[no-untyped-call]
        Client(cluster) as client,  # type: ignore[no-untyped-call]
    ):
        return tpmscad.sweep(table, client.get_executor(), output, progress=False)


def sweep_with_pool(table: Path, output: Path, jobs: int) -> Any:
    """The sweep by a process pool."""
    with start_processes(jobs) as pool:
        return tpmscad.sweep(table, pool, output, progress=False)


def measure_time(call: Callable[[], Any]) -> tuple[Any, float]:
    """What a call returns, and its wall time."""
    begun = time.perf_counter()
    return call(), time.perf_counter() - begun


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--designs", type=int, default=60)
    parser.add_argument("--killed-after", type=int, default=20)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--folder", type=Path)
    o = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as aside:
        folder = (o.folder or Path(aside)).resolve()
        table, outputs = folder / "designs.csv", [folder / f"{name}.csv" for name in ("resumed", "pool", "dask")]
        write_designs(table, o.designs)
        left, seconds = measure_time(lambda: run_command(table, outputs[0], o.killed_after))
        print(f"command line, killed: {left} of {o.designs} rows after {seconds:.1f} s")
        made, seconds = measure_time(lambda: run_command(table, outputs[0]))
        print(f"the same command again: {made} rows, {seconds:.1f} s more")
        with chdir(folder):
            for name, sweep, output in (("pool", sweep_with_pool, outputs[1]), ("Dask", sweep_with_dask, outputs[2])):
                results, seconds = measure_time(lambda run=sweep, path=output: run(table, path, o.jobs))
                print(f"{name}, {o.jobs} processes: {seconds:.1f} s")
        print(results)
        tables = [read_without_seconds(path) for path in outputs]
        same = tables[0] == tables[1] == tables[2]
        print(f"the three tables are {'the same' if same else 'DIFFERENT'}")
    sys.exit(not same)


if __name__ == "__main__":
    main()
