"""A lattice of any size, written in slabs: each a valid closed solid in a STEP file of its own, in bounded memory.

The lattice repeats after every cell, so that slabs of as many cells are translates of each other: one is made, and written at
every place. Cut faces of adjacent slabs agree to 1e-12 of the coordinates: a CAD system that unites them finds no gap.

Beside the files lies a manifest, which holds the request and the hash of every file. A run that was interrupted makes the slab
again and goes on where it stopped: a file that the manifest knows and whose hash is right is not written again.
"""

from __future__ import annotations

import re
import tempfile
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import KW_ONLY, asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from tpmscad._typing import triple
from tpmscad.api.argument_kinds import choice_of
from tpmscad.api.public_calls import validate_options
from tpmscad.api.shared_arguments import Schema
from tpmscad.api.shared_kinds import CELL_COUNTS, EXECUTOR, PATH, TEXT
from tpmscad.atomic_file import validate_output_path
from tpmscad.errors import InvalidRequest
from tpmscad.file_suffixes import STEP_SUFFIXES
from tpmscad.files.slab_files import Cells, Manifest, SlabFile, make_originals, write_slab
from tpmscad.kernel.step.part21 import find_schema
from tpmscad.parallel import run_as_completed
from tpmscad.requests.lattice_options import LatticeOptions
from tpmscad.requests.lattice_request import resolve_lattice_request
from tpmscad.result_display import fit_lines, format_html_table
from tpmscad.results.loose_pieces import KEEP
from tpmscad.stage_timer import StageTimer


@dataclass(frozen=True, slots=True, repr=False)
class SlabFiles:
    """The files of a lattice in slabs.

    Attributes
    ----------
    folder : Path
        The folder of the files.
    slabs : tuple of SlabFile
        One row for each slab, in the order of the numbers in the names: x fastest, z slowest.
    certificates : tuple of dict
        One for each size of slabs, as `Certificate.to_dict` gives it; slabs of equal size are congruent and share theirs.
    manifest : Path
        The JSON file of the request and the rows.
    reused : tuple of str
        Names of the files that an earlier run had written.
    """

    folder: Path
    slabs: tuple[SlabFile, ...]
    certificates: tuple[dict[str, Any], ...]
    manifest: Path
    reused: tuple[str, ...]

    @property
    def paths(self) -> tuple[Path, ...]:
        """The files, in order."""
        return tuple(self.folder / slab.file for slab in self.slabs)

    @property
    def volume(self) -> float:
        """Volume of all slabs together, mm3."""
        return float(sum(slab.volume for slab in self.slabs))

    def to_dict(self) -> dict[str, Any]:
        """Plain values, as in a report."""
        return {
            "volume": self.volume,
            "slabs": [asdict(slab) for slab in self.slabs],
            "reused": list(self.reused),
            "certificates": list(self.certificates),
        }

    def __repr__(self) -> str:
        head = f"{'file':<24} {'z mm':>9} {'cells':>10} {'faces':>7} {'volume mm3':>14} {'MB':>7} {'s':>6}"
        rows = [
            f"{s.file:<24} {s.origin[2]:>9.3f} {'x'.join(map(str, s.cells)):>10} {s.faces:>7} {s.volume:>14.6f} "
            f"{s.size / 1e6:>7.1f} {s.seconds:>6.1f}"
            for s in self.slabs
        ]
        kept = f", {len(self.reused)} of them from an earlier run" if self.reused else ""
        total = f"{len(rows)} slabs{kept}, volume {self.volume:.9g} mm3"
        return fit_lines([head, *rows], self.manifest.name, tail=[total])

    def _repr_html_(self) -> str:
        head = ("file", "corner, mm", "cells", "faces", "volume, mm3", "MB", "s")
        rows = [(s.file, s.origin, s.cells, s.faces, s.volume, s.size / 1e6, s.seconds) for s in self.slabs]
        return format_html_table(str(self).splitlines()[-1], rows, head)


@dataclass(frozen=True, slots=True)
class Slab:
    """A slab that is asked for: the slabs before it along each axis, and its cells."""

    steps: Cells
    cells: Cells


@dataclass(frozen=True)
class SlabOptions(LatticeOptions):
    """The arguments of `export_slabs`."""

    path: Annotated[
        str | Path,
        PATH,
        "Name of the files: ``'lattice_{:03d}.step'``; without a field in braces the number is appended, from 1.",
    ]
    _: KW_ONLY
    loose: Annotated[
        str,
        choice_of("drop", "keep"),
        "All pieces of a slab are kept, as they may be a part of the next one.",
    ] = KEEP
    slab: Annotated[
        int | Sequence[int],
        CELL_COUNTS.described_as(example="(20, 20, 1)"),
        "Cells of a slab along z, with all those along x and y; or along each axis. The last slab of an axis may have fewer.",
    ] = 1
    executor: Annotated[
        Executor | None,
        EXECUTOR,
        "Makes and writes the slabs: a process pool, or on a cluster with a common file system Dask's "
        "``Client.get_executor()``. By default this process, one after the other. The files are the same to the last byte.",
    ] = None
    schema: Schema = "ap242"
    time_stamp: Annotated[
        str | None,
        TEXT.described_as(example='"2026-01-31T12:00:00"'),
        "Time in the header of the files, ISO 8601; the present by default.",
    ] = None


@validate_options(
    SlabOptions, 'export_slabs("gyroid", "gyroid_{:03d}.step", cell=10, cells=(20, 20, 20), thickness=1, slab=1)'
)
def export_slabs(options: SlabOptions) -> SlabFiles:
    """Write a lattice of any size in slabs, each a valid closed solid in a STEP file of its own.

    Memory holds one slab at a time in each process. Cut faces of adjacent slabs agree to 1e-12 of the coordinates. A file is
    complete and verified, or absent; after an interruption the same call goes on where it stopped, as the manifest
    ``*.slabs.json`` beside the files tells.

    Returns
    -------
    SlabFiles
        A table of the files: volume, area, faces, seconds, hash, and the certificate of the slabs.

    Raises
    ------
    InvalidRequest
        If the request cannot be carried out, or has a map, a natural boundary, or drops loose pieces.
    NotMet
        If a slab misses the request; nothing is written.
    TrimmingError, KernelError
        If a slab cannot be made, or a file does not hold it.

    Examples
    --------
    >>> files = tpmscad.export_slabs(  # doctest: +SKIP
    ...     "gyroid", "gyroid_{:03d}.step", cell=10, cells=(20, 20, 20), thickness=1, tol=0.01, slab=1
    ... )
    >>> print(files)  # doctest: +SKIP
    """
    _refuse_what_does_not_repeat(options)
    request, schema = resolve_lattice_request(options), options.schema
    request.require_even("write the whole with lattice")
    slabs = divide(request.cells, options.slab)
    find_schema(schema)
    template = Path(options.path)
    names = name_files(template, len(slabs))
    folder = template.parent
    sizes = tuple(dict.fromkeys(each.cells for each in slabs))
    stages = StageTimer(options.progress)
    with tempfile.TemporaryDirectory(prefix=".slabs-", dir=folder) as aside:
        with stages("original"):
            task = (request, sizes, Path(aside).resolve())
            originals = next(made for _, made in run_as_completed(options.executor, make_originals, [task]))
        of_cells = {original.cells: original for original in originals}
        described = asdict(request) | {"slab": slabs[0].cells, "schema": schema}
        described["originals"] = [original.sha256 for original in originals]
        certificates = [original.certificate.to_dict() for original in originals]
        manifest = Manifest.open(folder / f"{strip_field(template.stem)}.slabs.json", described, certificates)
        kept = tuple(name for name in names if name in manifest.rows)
        stamp = options.time_stamp or datetime.now(UTC).isoformat(timespec="seconds")
        edges = np.multiply(slabs[0].cells, request.cell)
        tasks = []
        for name, each in zip(names, slabs, strict=True):
            if name not in kept:
                shift = triple(np.multiply(each.steps, edges).tolist())
                original, path = of_cells[each.cells], folder.resolve() / name
                tasks.append((original, path, shift, f"{original.name} {path.stem}", schema, stamp))
        with stages("slabs") as report:
            for _, row in run_as_completed(options.executor, write_slab, tasks):
                manifest.add(row)
                report(len(manifest.rows) / len(names))
    rows = tuple(manifest.rows[name] for name in names)
    return SlabFiles(folder, rows, tuple(manifest.certificates), manifest.path, kept)


def divide(cells: Cells, slab: int | Sequence[int]) -> list[Slab]:
    """The slabs of a lattice of `cells`, x fastest; one number is the cells of a slab along z."""
    x, y, z = slab if isinstance(slab, Sequence) else (*cells[:2], slab)
    parts = [
        [(step, min(size, count - step * size)) for step in range(-(-count // size))]
        for count, size in zip(cells, (x, y, z), strict=True)
    ]
    return [Slab((i, j, k), (a, b, c)) for k, c in parts[2] for j, b in parts[1] for i, a in parts[0]]


FIELD = re.compile(r"\{[^{}]*\}")


def name_files(template: Path, count: int) -> list[str]:
    """The names of so many files, numbered from 1; InvalidRequest if they cannot be told apart or written."""
    validate_output_path(template, STEP_SUFFIXES)
    pattern = template.name
    if FIELD.search(pattern) is None:
        pattern = f"{template.stem}_{{:0{len(str(count))}d}}{template.suffix}"
    try:
        names = [pattern.format(number) for number in range(1, count + 1)]
    except (ValueError, IndexError, KeyError):
        names = []
    if len(set(names)) < count:
        raise InvalidRequest(
            f"the name {template.name!r} does not number {count} files: write it with one field, such as lattice_{{:03d}}.step"
        )
    return names


def strip_field(stem: str) -> str:
    """The name without the field of the number and what joins it on."""
    return FIELD.sub("", stem).strip("_-. ") or "lattice"


def _refuse_what_does_not_repeat(options: SlabOptions) -> None:
    """InvalidRequest for a lattice whose slabs are not translates of each other."""
    if options.map is not None:
        raise InvalidRequest("under a map no slab is a copy of another: leave map out, or write the whole with lattice")
    if options.boundary != "box":
        raise InvalidRequest("slabs are cut in planes: use boundary='box', or write the whole with lattice")
    if options.loose != KEEP:
        raise InvalidRequest("a piece that is loose in a slab may be a part of the next one: leave loose out")
