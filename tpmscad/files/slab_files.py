"""The work on one slab, as tasks that an executor runs: making the originals, writing a copy of one.

A task's arguments and results are small: originals travel as STEP files, in a folder that all processes see.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

from tpmscad.atomic_file import atomic_write
from tpmscad.files.checked_write import KERNEL_READ_LIMIT, REREAD_VOLUME_RTOL, make_volume_check
from tpmscad.kernel.step.translated_copies import (
    EXACT,
    GREATEST_JOIN_UNITS,
    StepOriginal,
    compare_with_original,
    decimal_of,
    join_at_cuts,
    read_original,
    units_of,
    write_copy,
)
from tpmscad.requests.lattice_request import LatticeRequest
from tpmscad.results.certificate import Certificate
from tpmscad.results.loose_pieces import KEEP
from tpmscad.solids._lattice import make_lattice
from tpmscad.stage_timer import StageTimer

Cells = tuple[int, int, int]


@dataclass(frozen=True, slots=True)
class SlabOriginal:
    """A slab in the origin, in a file, that all slabs of as many cells are copies of.

    size: its edges in units of 10**-decimals mm; sha256: of the file.
    """

    path: Path
    cells: Cells
    name: str
    size: tuple[int, int, int]
    decimals: int
    sha256: str
    certificate: Certificate
    solids: int


@dataclass(frozen=True, slots=True)
class WrittenSlab:
    """The hash of a slab's file, its size in bytes, and the seconds that it took."""

    sha256: str
    size: int
    seconds: float


def make_originals(
    request: LatticeRequest, cells: Sequence[Cells], folder: Path, schema: str
) -> tuple[SlabOriginal, ...]:
    """A verified file for each number of cells, the cut faces of all of them equal; none if a certificate is not met.

    Pieces that are loose in a slab are kept, because they may be a part of the next one.
    """
    certificates, solids, originals, files = [], [], [], []
    name = f"{request.surface} {request.kind}"
    for number, count in enumerate(cells):
        model = make_lattice(replace(request, cells=count), KEEP, StageTimer(False))
        certificates.append(model.certificate)
        solids.append(model.built.n_solids)
        if not model.certificate.met:
            return (SlabOriginal(folder, count, name, (0, 0, 0), 0, "", model.certificate, solids[-1]),)
        exported = folder / f"exported-{number}.step"
        model.export_step(exported, schema=schema)
        del model
        originals.append(read_original(exported, name))
        files.append(exported)
    decimals = max(original.decimals for original in originals)
    sizes = [tuple(units_of(n * edge, decimals) for n, edge in zip(c, request.cell, strict=True)) for c in cells]
    joined = join_at_cuts([original.with_decimals(decimals) for original in originals], sizes)
    made = []
    for number, (original, (x, y, z), certificate) in enumerate(zip(joined, sizes, certificates, strict=True)):
        path = folder / f"original-{number}.step"
        write_copy(original, path, (0, 0, 0), name=name, time_stamp="", file_name=path.name)
        _check_joined(path, files[number], name, decimals, certificate.volume)
        files[number].unlink()
        digest = hashlib.sha256(_data_section(path.read_bytes())).hexdigest()
        made.append(SlabOriginal(path, cells[number], name, (x, y, z), decimals, digest, certificate, solids[number]))
    return tuple(made)


def _check_joined(path: Path, exported: Path, name: str, decimals: int, volume: float) -> None:
    """KernelError unless the original is the verified file but for the joining of cuts; the kernel reads it, if it is small."""
    still = (EXACT, EXACT, EXACT)
    tol = decimal_of(GREATEST_JOIN_UNITS, decimals)
    compare_with_original(path, exported, still, name=name, original_name=name, tol=tol)
    if path.stat().st_size <= KERNEL_READ_LIMIT:
        make_volume_check(volume, REREAD_VOLUME_RTOL)(path)


def _data_section(text: bytes) -> bytes:
    """The file without its header, which holds its own name."""
    return text[text.index(b"DATA;") :]


def write_slab(
    original: SlabOriginal, path: Path, shift: tuple[int, int, int], name: str, time_stamp: str
) -> WrittenSlab:
    """Write the original moved by `shift` (units), read the file and compare it with the original."""
    begun = time.perf_counter()
    with atomic_write(path) as aside:
        write_copy(_load(original), aside, shift, name=name, time_stamp=time_stamp, file_name=path.name)
        moved = [decimal_of(units, original.decimals) for units in shift]
        compare_with_original(aside, original.path, moved, name=name, original_name=original.name)
        size, digest = aside.stat().st_size, hash_file(aside)
    return WrittenSlab(digest, size, time.perf_counter() - begun)


def _load(original: SlabOriginal) -> StepOriginal:
    """The text of an original; the last one is kept."""
    return _read_once(original.path, original.name, original.decimals, original.sha256)


@lru_cache(maxsize=1)
def _read_once(path: Path, name: str, decimals: int, sha256: str) -> StepOriginal:
    return read_original(path, name).with_decimals(decimals)


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
