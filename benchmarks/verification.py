"""The short verification against the full one: faults put on purpose into solids and into files, and who notices them.

    python -m benchmarks.verification [--count N] [--seed S]

Full: the kernel checks the whole solid, reads the whole file back and checks it again. Short: classes of congruent faces,
arrays, the file's text, an excerpt. Both run in a child process, since a fault may crash the kernel; a crash counts as noticed.
A fault that the full verification notices and the short one does not is *missed*; there must be none.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path

import build123d as bd
import numpy as np

import tpmscad
from tests.shapes.kernel_shapes import drilled_dome, notched_hollow
from tests.shapes.mutants import BREP_FAULTS, TEXT_FAULTS
from tpmscad import fields
from tpmscad.brep.boundary_representation import Brep
from tpmscad.files.checked_write import REREAD_VOLUME_RTOL_OF_BODIES, make_volume_check
from tpmscad.kernel.build.solids import build_solids
from tpmscad.kernel.export.file_check import check_excerpt
from tpmscad.kernel.measure.shape_report import is_valid
from tpmscad.kernel.measure.validity import is_brep_valid
from tpmscad.kernel.step.brep_writer import write_step

RTOL = REREAD_VOLUME_RTOL_OF_BODIES
SECONDS = 60
"""Time after which a child is ended and its fault counts as noticed."""


def accepts_in_full(brep: Brep, path: Path) -> bool:
    """The kernel's check of the solid, and of the file read back."""
    built = build_solids(brep)
    if not is_valid(built.shape):
        return False
    write_step(brep, built.nesting, path)
    return accepts_file_in_full(brep, path)


def accepts_file_in_full(brep: Brep, path: Path) -> bool:
    """The kernel's check of the file."""
    built = build_solids(brep)
    volume = float((built.nesting.volume).sum())
    make_volume_check(volume, RTOL)(path)
    return True


def accepts_in_short(brep: Brep, path: Path) -> bool:
    """Classes of faces and arrays, the text of the file and its excerpt."""
    built = build_solids(brep)
    if not is_brep_valid(brep, built.faces):
        return False
    write_step(brep, built.nesting, path)
    return accepts_file_in_short(brep, path)


def accepts_file_in_short(brep: Brep, path: Path) -> bool:
    """The text of the file and its excerpt."""
    check_excerpt(path, brep, build_solids(brep).nesting)
    return True


def is_noticed(accepts: Callable[[Brep, Path], bool], brep: Brep, path: Path) -> bool:
    """Whether a check rejects, fails or crashes, in a child process."""
    child = os.fork()
    if child == 0:
        accepted = False
        try:
            os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
            accepted = accepts(brep, path)
        finally:
            os._exit(0 if accepted else 1)
    for _ in range(10 * SECONDS):
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return status != 0
        time.sleep(0.1)
    os.kill(child, 9)
    os.waitpid(child, 0)
    return True


def run(count: int, seed: int) -> int:
    """Print the tables and return the number of faults missed."""
    lattice = tpmscad.lattice("gyroid", cell=10.0, thickness=1.0, tol=0.01).patches
    filled = tpmscad.infill(bd.Cylinder(6, 10), "gyroid", cell=10.0, thickness=1.0, tol=0.05).patches
    rod = fields.rod(fields.tpms("gyroid", cell=10.0), 0.1)
    of_field = tpmscad.solidify(rod, ((0, 0, 0), (10, 10, 10)), tol=0.05).patches
    solids = (lattice, filled, of_field, drilled_dome(), notched_hollow())
    rng = np.random.default_rng(seed)
    missed = 0
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "mutant.step"
        for solid in solids[1:]:
            for accepts in (accepts_in_full, accepts_in_short):
                assert not is_noticed(accepts, solid, path), "a sound solid is rejected"
        tally: dict[str, list[int]] = defaultdict(lambda: [0, 0, 0, 0])
        for number in range(count):
            fault = BREP_FAULTS[number % len(BREP_FAULTS)]
            mutant = fault(solids[number % len(solids)], rng)
            missed += _count(
                tally[fault.__name__], [is_noticed(a, mutant, path) for a in (accepts_in_full, accepts_in_short)]
            )
        _print("solids", tally)
        tally = defaultdict(lambda: [0, 0, 0, 0])
        for number in range(count):
            fault_of_text = TEXT_FAULTS[number % len(TEXT_FAULTS)]
            solid = solids[number % len(solids)]
            write_step(solid, build_solids(solid).nesting, path)
            path.write_text(fault_of_text(path.read_text(), rng))
            found = [is_noticed(a, solid, path) for a in (accepts_file_in_full, accepts_file_in_short)]
            missed += _count(tally[fault_of_text.__name__], found)
        _print("files", tally)
    return missed


def _count(row: list[int], found: list[bool]) -> int:
    """Enter one fault into a row: tried, noticed in full, noticed in short, missed."""
    full, short = found
    for k, value in enumerate((True, full, short, full and not short)):
        row[k] += value
    return int(full and not short)


def _print(title: str, tally: dict[str, list[int]]) -> None:
    print(f"{title:32}{'faults':>8}{'full':>8}{'short':>8}{'missed':>8}")
    for name, row in [*tally.items(), ("all", np.sum(list(tally.values()), axis=0).tolist())]:
        print(f"{name.replace('_', ' '):32}" + "".join(f"{n:8}" for n in row), flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    raise SystemExit(run(given.count, given.seed))
