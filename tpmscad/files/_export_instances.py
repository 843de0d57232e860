"""A lattice of any size in one small STEP file, which stores a single cell and places it once for each cell of the lattice.

Only one cell is made and checked, so that time and memory hardly grow with the lattice. The copies touch at their common faces
but are solids of their own; for one solid across cells there are `lattice` and `export_slabs`.
"""

from __future__ import annotations

import math
from dataclasses import KW_ONLY, dataclass, replace
from pathlib import Path
from typing import Annotated, Any

from tpmscad.api.argument_kinds import choice_of
from tpmscad.api.public_calls import validate_options
from tpmscad.api.shared_arguments import Schema
from tpmscad.api.shared_kinds import PATH
from tpmscad.atomic_file import validate_output_path
from tpmscad.errors import InvalidRequest, NotMet
from tpmscad.file_suffixes import STEP_SUFFIXES
from tpmscad.files.checked_write import write_checked_brep
from tpmscad.kernel.build.solids import build_solids
from tpmscad.kernel.step.part21 import find_schema
from tpmscad.kernel.step.product_entities import arrange_cells
from tpmscad.requests.lattice_options import LatticeOptions
from tpmscad.requests.lattice_request import resolve_lattice_request
from tpmscad.result_display import fit_lines, tabulate_summary
from tpmscad.results.certificate import Certificate
from tpmscad.results.loose_pieces import KEEP
from tpmscad.solids._lattice import make_lattice
from tpmscad.stage_timer import StageTimer

MAX_COPIES = 100_000
"""Copies in one file; OCCT takes 0.2 ms to place and measure each, and CAD systems far longer to draw them."""


@dataclass(frozen=True, slots=True, repr=False)
class InstancedFile:
    """A STEP file that stores one cell and places it many times.

    Attributes
    ----------
    path : Path
        The file.
    cells : (int, int, int)
        Copies of the cell along each axis.
    certificate : Certificate
        Of one cell; all are congruent.
    size : int
        Bytes of the file.
    """

    path: Path
    cells: tuple[int, int, int]
    certificate: Certificate
    size: int

    @property
    def n_copies(self) -> int:
        """Number of copies of the cell."""
        return math.prod(self.cells)

    @property
    def volume(self) -> float:
        """Volume of all copies together, mm3."""
        return self.n_copies * self.certificate.volume

    def to_dict(self) -> dict[str, Any]:
        """Plain values, as in a report."""
        return {
            "file": self.path.name,
            "cells": list(self.cells),
            "copies": self.n_copies,
            "volume": self.volume,
            "bytes": self.size,
            "cell": self.certificate.to_dict(),
        }

    def summary(self, *, verbose: bool = False) -> str:
        """The file in a line, and the certificate of its cell."""
        counts = " x ".join(map(str, self.cells))
        return (
            f"{self.path.name}: {counts} copies of one cell, volume {self.volume:.9g} mm3, "
            f"{self.size / 1e6:.2f} MB; of the cell:\n{self.certificate.summary(verbose=verbose)}"
        )

    def __repr__(self) -> str:
        return fit_lines([self.summary()], ".summary()")

    def _repr_html_(self) -> str:
        return tabulate_summary(self.summary())


@dataclass(frozen=True)
class InstanceOptions(LatticeOptions):
    """The arguments of `export_instances`."""

    path: Annotated[
        str | Path, PATH, "The file to write, ``.step`` or ``.stp``. It is complete and verified, or absent."
    ]
    _: KW_ONLY
    loose: Annotated[
        str,
        choice_of("drop", "keep"),
        "All pieces of the cell are kept: one that is loose in a cell touches the next one.",
    ] = KEEP
    schema: Schema = "ap242"
    verify: Annotated[str | None, choice_of("kernel"), "As in `Model.export_step`."] = None


@validate_options(
    InstanceOptions, 'export_instances("gyroid", "gyroid.step", cell=10, cells=(20, 20, 20), thickness=1)'
)
def export_instances(options: InstanceOptions) -> InstancedFile:
    """Write a lattice as one STEP file that stores a single cell and places it as often as the lattice repeats it.

    One cell is made, checked and written, whatever the number of cells. CAD systems show an assembly of touching solids; more
    than 64 cells come in rows, layers of rows and a block of layers. Nothing is written if the cell misses the request.

    Returns
    -------
    InstancedFile
        The file, its copies, and the certificate of the cell.

    Raises
    ------
    InvalidRequest
        If the request cannot be carried out, has a map, drops loose pieces, or places more than 100,000 copies.
    NotMet
        If the cell misses the request.
    TrimmingError, KernelError
        If the cell cannot be made, or the file does not hold it.

    Examples
    --------
    >>> file = tpmscad.export_instances(  # doctest: +SKIP
    ...     "gyroid", "gyroid.step", cell=10, cells=(20, 20, 20), thickness=1, tol=0.01
    ... )
    >>> print(file)  # doctest: +SKIP
    """
    stages = StageTimer(options.progress)
    if options.map is not None:
        raise InvalidRequest("under a map no cell is a copy of another: leave map out, or write the whole with lattice")
    if options.loose != KEEP:
        raise InvalidRequest("a piece that is loose in a cell touches the next one: leave loose out")
    request = resolve_lattice_request(options)
    request.require_even("write the whole with lattice")
    target = validate_output_path(options.path, STEP_SUFFIXES)
    find_schema(options.schema)
    n_copies = math.prod(request.cells)
    if n_copies > MAX_COPIES:
        raise InvalidRequest(
            f"{' x '.join(map(str, request.cells))} cells are {n_copies} copies, more than {MAX_COPIES}: use larger or fewer "
            "cells, or several files"
        )
    model = make_lattice(replace(request, cells=(1, 1, 1)), KEEP, stages)
    certificate = model.certificate
    if not certificate.met:
        raise NotMet(
            f"{target} not written, the cell misses the request: {'; '.join(certificate.shortfalls)}", certificate
        )
    with stages("write"):
        write_checked_brep(
            build_solids(model.patches),
            target,
            schema=options.schema,
            name=model.name,
            instances=arrange_cells(request.cell, request.cells),
            verify=options.verify,
        )
    return InstancedFile(target, request.cells, certificate, target.stat().st_size)
