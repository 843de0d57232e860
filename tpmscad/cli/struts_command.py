"""tpmscad struts: a lattice of round struts in a box."""

from __future__ import annotations

from typing import Annotated

import typer

import tpmscad
from tpmscad.cli.derived_options import CELL_PANEL, Request, take_options_of, take_output
from tpmscad.cli.lattice_command import read_map
from tpmscad.cli.output import OutputRequest, make_and_write
from tpmscad.requests.strut_options import StrutOptions
from tpmscad.strut_cells import FLAT_KINDS, KINDS

KindArgument = Annotated[
    str,
    typer.Argument(
        autocompletion=lambda incomplete: [kind for kind in (*KINDS, *FLAT_KINDS) if kind.startswith(incomplete)],
        help=f"Kind of cell: {', '.join(KINDS)}; or {' or '.join(FLAT_KINDS)}, with --map.",
    ),
]
MapOption = Annotated[
    str | None,
    typer.Option(
        metavar="NAME[:RADIUS]",
        help="Wrap the nodes: `cylinder` closes a ring of the cells along x round the z axis, `cylinder:20` bends it with a "
        "radius of 20 mm; `sphere:20` makes a dome. Struts stay straight and whole; of nets they make a stent.",
        rich_help_panel=CELL_PANEL,
    ),
]


@take_options_of(StrutOptions, leave_out=("kind",))
@take_output()
def struts(request: Request, kind: KindArgument, *, map: MapOption = None, writing: OutputRequest) -> None:
    """Make a lattice of round struts that fills the box from the origin to CELLS x CELL, or a stent of them."""
    if map is not None:
        request["map"] = read_map(map, request.get("cell"), request.get("cells", 1))
    make_and_write(f"{kind} struts", lambda progress: tpmscad.struts(kind, progress=progress, **request), writing)
