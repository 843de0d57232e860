"""The work on one slab, as tasks that an executor runs: making the originals, writing a copy of one.

A task's arguments and results are small: originals travel in files, in a folder that all processes see.
"""

from __future__ import annotations

import hashlib
import pickle
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from tpmscad.brep.boundary_representation import Brep, translate_brep
from tpmscad.files.checked_write import write_checked_brep
from tpmscad.kernel.build.solids import build_solids
from tpmscad.requests.lattice_request import LatticeRequest
from tpmscad.results.certificate import Certificate
from tpmscad.results.loose_pieces import KEEP
from tpmscad.solids._lattice import make_lattice
from tpmscad.stage_timer import StageTimer

Cells = tuple[int, int, int]


@dataclass(frozen=True, slots=True)
class SlabOriginal:
    """A slab in the origin, a pickled boundary representation in a file, that all slabs of as many cells are copies of.

    sha256: of the file.
    """

    path: Path
    cells: Cells
    name: str
    sha256: str
    certificate: Certificate
    solids: int


@dataclass(frozen=True, slots=True)
class SlabFile:
    """One slab of a lattice in its file: lower corner in mm, cells along each axis, and what was measured on it, in mm."""

    file: str
    origin: tuple[float, float, float]
    cells: Cells
    volume: float
    area: float
    faces: int
    solids: int
    size: int
    sha256: str
    seconds: float


def make_originals(request: LatticeRequest, cells: Sequence[Cells], folder: Path) -> tuple[SlabOriginal, ...]:
    """An original for each number of cells; none after the first whose certificate is not met.

    Pieces that are loose in a slab are kept, because they may be a part of the next one.
    """
    made: list[SlabOriginal] = []
    for number, count in enumerate(cells):
        model = make_lattice(replace(request, cells=count), KEEP, StageTimer(False))
        path = folder / f"original-{number}.pickle"
        path.write_bytes(pickle.dumps(model.patches))
        name = f"{request.surface} {request.kind}"
        made.append(SlabOriginal(path, count, name, hash_file(path), model.certificate, model.built.n_solids))
        if not model.certificate.met:
            break
    return tuple(made)


def write_slab(
    original: SlabOriginal, path: Path, shift: tuple[float, float, float], name: str, schema: str, time_stamp: str
) -> SlabFile:
    """Write the original moved by `shift` (mm) and check what the file holds."""
    begun, certificate = time.perf_counter(), original.certificate
    slab = translate_brep(_load(original.path, original.sha256), np.array(shift))
    write_checked_brep(build_solids(slab), path, schema=schema, name=name, time_stamp=time_stamp)
    return SlabFile(
        path.name,
        shift,
        original.cells,
        certificate.volume,
        certificate.area,
        certificate.n_faces,
        original.solids,
        path.stat().st_size,
        hash_file(path),
        time.perf_counter() - begun,
    )


@lru_cache(maxsize=1)
def _load(path: Path, sha256: str) -> Brep:
    """An original; the last one is kept."""
    content = path.read_bytes()
    assert hashlib.sha256(content).hexdigest() == sha256
    brep = pickle.loads(content)
    assert isinstance(brep, Brep)
    return brep


def hash_file(path: Path) -> str:
    """SHA-256 of a file, in hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def describe_request(request: LatticeRequest, **others: Any) -> dict[str, Any]:
    """The request and further values as plain values, which tell whether files belong to it."""
    return {
        "surface": request.surface,
        "cell": list(request.cell),
        "cells": list(request.cells),
        "offset": list(request.offset),
        "levels": None if request.levels is None else list(request.levels),
        "kind": request.kind,
        "side": request.side,
        "reference": request.reference,
        "phase": list(request.phase),
        "tol": request.tol,
        **others,
    }
