"""A lattice written in slabs: seconds, memory, validity of every file, and the volume against two that know nothing of slabs.

    python -m benchmarks.slabs [--surface gyroid] [--cells 6] [--slab 1] [--thickness 0.1] [--tol 0.001] [--jobs 2]
                               [--dask] [--read 2] [--folder FOLDER]

Lengths are in cells of 10 mm. The volumes to compare with: that of the exact sheet by Steiner's formula, and as many times that
of one cell as the lattice has cells, integrated by the kernel over a solid of one cell whose patches are fitted alike. The first
differs by what the tolerance allows, the second by round-off. `--read` files, evenly spread, are read and checked by the kernel.
Memory is the greatest sum over all processes of the resident set, sampled ten times a second. With `--dask` the files are
written once more by a cluster of Dask and their hashes compared. Files go to a temporary folder without `--folder`.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import tpmscad
from tpmscad import surfaces
from tpmscad.files._export_slabs import SlabFiles
from tpmscad.kernel.measure.shape_report import check_shape
from tpmscad.parallel import start_processes

CELL = 10.0
STAMP = "2026-01-01T00:00:00"
SAMPLES_PER_SECOND = 10
PAGE = os.sysconf("SC_PAGE_SIZE")


def resident_bytes() -> int:
    """Resident set of this process and its descendants."""
    parent, resident = {}, {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                fields = (entry / "stat").read_text().rpartition(")")[2].split()
            except OSError:  # it has ended
                continue
            parent[int(entry.name)], resident[int(entry.name)] = int(fields[1]), int(fields[21]) * PAGE
    own = {os.getpid()}
    while grown := {child for child, of in parent.items() if of in own} - own:
        own |= grown
    return sum(resident[process] for process in own)


@contextmanager
def peak_memory() -> Iterator[list[int]]:
    """A list of one number: the greatest resident set, as long as the context lasts."""
    peak, ended = [0], threading.Event()

    def watch() -> None:
        while not ended.wait(1 / SAMPLES_PER_SECOND):
            peak[0] = max(peak[0], resident_bytes())

    thread = threading.Thread(target=watch, daemon=True)
    thread.start()
    try:
        yield peak
    finally:
        ended.set()
        thread.join()


def compare_with_dask(files: SlabFiles, jobs: int, request: dict[str, Any]) -> bool:
    """Whether a cluster of Dask writes files of the same hashes."""
    from distributed import Client, LocalCluster

    with (
        tempfile.TemporaryDirectory() as folder,
        LocalCluster(n_workers=jobs, threads_per_worker=1, dashboard_address=None) as cluster,  # type: ignore[no-untyped-call]
        Client(cluster) as client,  # type: ignore[no-untyped-call]
    ):
        made = tpmscad.export_slabs(path=Path(folder) / "slab_{:03d}.step", executor=client.get_executor(), **request)
    return [slab.sha256 for slab in made.slabs] == [slab.sha256 for slab in files.slabs]


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--surface", default="gyroid")
    parser.add_argument("--cells", type=int, default=6)
    parser.add_argument("--slab", type=int, default=1)
    parser.add_argument("--thickness", type=float, default=0.1)
    parser.add_argument("--tol", type=float, default=0.001)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--read", type=int, default=2)
    parser.add_argument("--dask", action="store_true")
    parser.add_argument("--folder", type=Path)
    o = parser.parse_args(arguments)
    wall: dict[str, Any] = {"cell": CELL, "thickness": o.thickness * CELL, "tol": o.tol * CELL}
    request: dict[str, Any] = {"surface": o.surface, **wall, "cells": o.cells, "slab": o.slab, "time_stamp": STAMP}
    with tempfile.TemporaryDirectory() as aside:
        folder = o.folder or Path(aside)
        begun = time.perf_counter()
        with peak_memory() as peak, start_processes(o.jobs) as executor:
            files = tpmscad.export_slabs(path=folder / "slab_{:03d}.step", executor=executor, progress=False, **request)
        seconds = time.perf_counter() - begun
        print(files)
        print(f"{seconds:.1f} s with {o.jobs} processes, at most {peak[0] / 2**30:.2f} GiB in all of them together")
        cell = tpmscad.lattice(o.surface, **wall, progress=False)
        by_kernel = o.cells**3 * check_shape(cell.wrapped).volume
        exact = o.cells**3 * CELL**3 * surfaces.volume_fraction(o.surface, "minimal", -o.thickness / 2, o.thickness / 2)
        print(f"volume / {o.cells**3} cells of the kernel - 1: {files.volume / by_kernel - 1:.1e}")
        print(f"volume / Steiner's formula - 1: {files.volume / exact - 1:.1e}")
        for path in files.paths[:: max(1, len(files.paths) // max(o.read, 1))][: o.read]:
            report = tpmscad.check_step(path)
            print(f"{path.name} by the kernel: {'valid' if report.ok else 'INVALID'}, volume {report.shape.volume:.9g}")
        if o.dask:
            print(f"Dask writes the same bytes: {compare_with_dask(files, o.jobs, request)}")


if __name__ == "__main__":
    main()
