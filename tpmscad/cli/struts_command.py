"""tpmscad struts: a lattice of round struts in a box."""

from __future__ import annotations

from typing import Annotated

import typer

import tpmscad
from tpmscad.cli.derived_options import Request, take_options_of, take_output
from tpmscad.cli.output import OutputRequest, make_and_write
from tpmscad.requests.strut_options import StrutOptions
from tpmscad.strut_cells import KINDS

KindArgument = Annotated[
    str,
    typer.Argument(
        autocompletion=lambda incomplete: [kind for kind in KINDS if kind.startswith(incomplete)],
        help=f"Kind of cell: {', '.join(KINDS)}.",
    ),
]


@take_options_of(StrutOptions, leave_out=("kind",))
@take_output()
def struts(request: Request, kind: KindArgument, *, writing: OutputRequest) -> None:
    """Make a lattice of round struts that fills the box from the origin to CELLS x CELL."""
    make_and_write(f"{kind} struts", lambda progress: tpmscad.struts(kind, progress=progress, **request), writing)
