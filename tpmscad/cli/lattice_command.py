"""tpmscad lattice: a lattice of a minimal surface in a box, straight or wrapped."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

import tpmscad
from tpmscad.cli.derived_options import CELL_PANEL, Request, take_options_of, take_output
from tpmscad.cli.option_language import RENAMED_KEYWORDS, speak_in_options
from tpmscad.cli.options import InstancedOption, JobsOption, SlabOption
from tpmscad.cli.output import OutputRequest, make_and_write, progress_bar, report_unmet_request, tell, write_report
from tpmscad.errors import InvalidRequest
from tpmscad.requests.lattice_options import LatticeOptions

MAP_NAMES = ("cylinder", "sphere")

MapOption = Annotated[
    str | None,
    typer.Option(
        metavar="NAME[:RADIUS]",
        help="Wrap the lattice: `cylinder` closes a ring of the cells along x round the z axis, `cylinder:20` bends it with a "
        "radius of 20 mm; `sphere:20` makes a dome. A wrapped lattice has natural boundaries unless --boundary box is given.",
        rich_help_panel=CELL_PANEL,
    ),
]


@take_options_of(LatticeOptions)
@take_output()
def lattice(
    request: Request,
    *,
    map: MapOption = None,
    instanced: InstancedOption = False,
    slab: SlabOption = None,
    jobs: JobsOption = 1,
    writing: OutputRequest,
) -> None:
    """Make a lattice of a minimal surface that fills the box from the origin to CELLS x CELL."""
    if map is not None:
        wrap = read_map(map, request.get("cell"), request.get("cells", 1))
        request = {"boundary": "natural", **request, "map": wrap}
    surface = request.pop("surface")
    writing = replace(writing, instanced=instanced)
    if slab is not None:
        make_slabs(surface, request, writing, slab, jobs)
        return
    if jobs > 1:
        raise InvalidRequest("`jobs` is the number of processes that make slabs: give `slab`, too, or leave it out")
    if instanced:
        make_copies(surface, request, writing)
        return
    make_and_write(
        f"{surface} lattice", lambda progress: tpmscad.lattice(surface, progress=progress, **request), writing
    )


def make_slabs(surface: str, request: Mapping[str, Any], writing: OutputRequest, slab: Any, jobs: int) -> None:
    """Write a lattice in slabs and the table of the files as JSON, and print it."""
    from tpmscad.parallel import start_processes  # loads NumPy

    if writing.instanced:
        raise InvalidRequest("`instanced` stores the whole lattice in one file: leave it out of slabs")
    if writing.verify is not None:
        raise InvalidRequest(
            "slabs are verified by their text: leave `verify` out, and check files with `tpmscad check`"
        )
    with (
        report_unmet_request(writing.report),
        progress_bar(f"{surface} slabs", writing.quiet, writing.progress) as progress,
        start_processes(jobs) as executor,
    ):
        files = tpmscad.export_slabs(
            surface,
            writing.output or Path(),
            slab=slab,
            executor=executor,
            schema=writing.schema,
            progress=progress,
            **request,
        )
    write_report(writing.report, files.to_dict())
    tell(files, writing, parts=files.paths)


def make_copies(surface: str, request: Mapping[str, Any], writing: OutputRequest) -> None:
    """Write a lattice as copies of one cell, and the certificate of the cell as JSON, and print both."""
    with (
        report_unmet_request(writing.report),
        progress_bar(f"{surface} cell", writing.quiet, writing.progress) as progress,
    ):
        file = tpmscad.export_instances(
            surface,
            writing.output or Path(),
            schema=writing.schema,
            verify=writing.verify,
            progress=progress,
            **request,
        )
    write_report(writing.report, file.to_dict())
    tell(speak_in_options(file.summary(verbose=writing.verbose), RENAMED_KEYWORDS), writing)


def read_map(text: str, cell: Any, cells: Any) -> Any:
    """The map of `cylinder`, `cylinder:RADIUS` or `sphere:RADIUS`; without a radius the cells along x close a ring."""
    from tpmscad import maps  # loads NumPy

    name, _, number = text.partition(":")
    if name not in MAP_NAMES:
        raise InvalidRequest(f"`map` {text!r} is unknown: give cylinder, cylinder:RADIUS or sphere:RADIUS")
    try:
        radius = float(number) if number else None
    except ValueError:
        raise InvalidRequest(f"`map` {text!r}: {number!r} is no radius in mm") from None
    if radius is None and name == "sphere":
        raise InvalidRequest("`map` sphere needs the radius of the sphere in mm: sphere:20")
    if radius is None:
        if cell is None:
            raise InvalidRequest("a ring of whole cells needs `cell`: give it, or the radius, cylinder:20")
        edge, count = (value[0] if isinstance(value, tuple) else value for value in (cell, cells))
        radius = edge * count / (2 * math.pi)
    return getattr(maps, name)(radius)
