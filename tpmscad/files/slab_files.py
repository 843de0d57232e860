"""The work on one slab, as tasks that an executor runs, and the manifest of what they have written.

A task's arguments and results are small: originals travel in files, in a folder that all processes see. The manifest is a JSON
file, written anew after every slab, so that an interrupted run loses no work: a later run with the same request and the same
originals keeps the files whose hash the manifest knows.
"""

from __future__ import annotations

import hashlib
import json
import pickle
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from tpmscad.atomic_file import atomic_write
from tpmscad.brep.boundary_representation import Brep, translate_brep
from tpmscad.errors import NotMet
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
    """An original for each number of cells; NotMet if one misses the request.

    Pieces that are loose in a slab are kept, because they may be a part of the next one.
    """
    made: list[SlabOriginal] = []
    for number, count in enumerate(cells):
        model = make_lattice(replace(request, cells=count), KEEP, StageTimer(False))
        if not model.certificate.met:
            missed = "; ".join(model.certificate.shortfalls)
            raise NotMet(f"nothing was written, a slab misses the request: {missed}", model.certificate)
        path = folder / f"original-{number}.pickle"
        path.write_bytes(pickle.dumps(model.patches))
        name = f"{request.surface} {request.kind}"
        made.append(SlabOriginal(path, count, name, hash_file(path), model.certificate, model.built.n_solids))
    return tuple(made)


def write_slab(
    original: SlabOriginal, path: Path, shift: tuple[float, float, float], name: str, schema: str, time_stamp: str
) -> SlabFile:
    """Write the original moved by `shift` (mm) and check what the file holds."""
    begun, certificate = time.perf_counter(), original.certificate
    slab = translate_brep(_load(original.path), np.array(shift))
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
def _load(path: Path) -> Brep:
    """An original; the last one is kept."""
    brep = pickle.loads(path.read_bytes())
    assert isinstance(brep, Brep)
    return brep


def hash_file(path: Path) -> str:
    """SHA-256 of a file, in hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


@dataclass(slots=True)
class Manifest:
    """The state of a run: the request as plain values, hashes of the originals among them, and rows by file name."""

    path: Path
    request: dict[str, Any]
    certificates: list[dict[str, Any]]
    rows: dict[str, SlabFile]

    @classmethod
    def open(cls, path: Path, request: dict[str, Any], certificates: list[dict[str, Any]]) -> Manifest:
        """The manifest with the rows of an earlier run of the request whose files are there and whole; else without any."""
        request = json.loads(json.dumps(request))
        try:
            known = json.loads(path.read_text(encoding="ascii"))
        except (OSError, ValueError):
            known = None
        rows = known["slabs"] if isinstance(known, dict) and known.get("request") == request else []
        slabs = [SlabFile(**row | {"origin": tuple(row["origin"]), "cells": tuple(row["cells"])}) for row in rows]
        whole = {slab.file: slab for slab in slabs if _is_whole(path.parent / slab.file, slab)}
        return cls(path, request, certificates, whole)

    def add(self, row: SlabFile) -> None:
        """Note a finished file."""
        self.rows[row.file] = row
        slabs = [asdict(row) for row in self.rows.values()]
        content = {"request": self.request, "certificates": self.certificates, "slabs": slabs}
        with atomic_write(self.path) as aside:
            aside.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="ascii")


def _is_whole(file: Path, row: SlabFile) -> bool:
    return file.is_file() and file.stat().st_size == row.size and hash_file(file) == row.sha256
