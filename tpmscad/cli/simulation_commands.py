"""tpmscad mesh, homogenize and permeability: the volume mesh of a STEP file, and properties of a lattice and its channels."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Literal

import typer

import tpmscad
from tpmscad.cli.derived_options import Request, SurfaceArgument, take_options_of
from tpmscad.cli.options import QuietOption, ReportOption, StepFileArgument, output_option, result_option
from tpmscad.cli.output import OutputRequest, progress_bar, report_unmet_request, tell, write_report
from tpmscad.errors import InvalidRequest
from tpmscad.file_suffixes import MATERIAL_SUFFIXES, MESH_PROGRAMS, MESH_WRITERS, list_suffixes
from tpmscad.requests.study_options import HomogenizeOptions, MeshStepOptions

VersionOption = Annotated[
    Literal["4.1", "2.2"],
    result_option("--msh-version", help="Version of gmsh's format .msh."),
]
MeshFileOption = Annotated[
    Path,
    output_option(f"The file to write: {list_suffixes(f'{suffix} ({of})' for suffix, of in MESH_PROGRAMS.items())}."),
]
ReferenceOption = Annotated[
    str | None,
    typer.Option(
        metavar="NAME", help="The minimal surface, or the nodal one.", show_default="minimal where there is one"
    ),
]
ChannelPorosityOption = Annotated[
    float | None,
    typer.Option(
        "--porosity",
        metavar="0..1",
        help="Volume of the channel over that of the cell. Required, unless --thickness is given.",
    ),
]
ChannelWallOption = Annotated[
    float | None,
    typer.Option(
        "--thickness",
        metavar="MM",
        help="Thickness of a wall in the middle, mm, of which the channel lies on one side; instead of --porosity.",
    ),
]
ChannelSideOption = Annotated[
    Literal["+", "-"], typer.Option("--side", help="Side of the surface on which the channel lies.")
]
ChannelCellOption = Annotated[float, typer.Option("--cell", metavar="MM", help="Edge length of the cubic cell, mm.")]
ChannelElementSizeOption = Annotated[
    float | None,
    typer.Option(
        "--size",
        metavar="L",
        help="Mean edge length of the tetrahedra of the finer mesh, in cells.",
        show_default="0.1",
    ),
]
CardOption = Annotated[Path | None, output_option(f"A material card to write: {list_suffixes(MATERIAL_SUFFIXES)}.")]


@take_options_of(MeshStepOptions)
def mesh(
    request: Request,
    file: StepFileArgument,
    output: MeshFileOption,
    version: VersionOption = "4.1",
    report: ReportOption = None,
    quiet: QuietOption = False,
) -> None:
    """Mesh the solids of a STEP file with tetrahedra whose nodes lie on the exact faces, with named groups; needs gmsh.

    Domains that touch share their nodes if they come from a .brep file, which keeps the faces that solids share.
    """
    writing = OutputRequest(output, report, quiet, suffixes=tuple(MESH_WRITERS))
    with report_unmet_request(report):
        with progress_bar(f"meshing {file.name}", quiet):
            from tpmscad.studies._mesh_step import mesh_step  # loads the kernel

            found = mesh_step(file, **request, progress=False)
            found.write(output, version=version)
        write_report(report, {"file": str(file), "mesh": str(output), **found.to_dict()})
    apart = len(found.cell_groups) > 1 and file.suffix.lower() != ".brep"
    note = "\nthe solids share no nodes, as STEP has no common faces: write the domains as .brep and mesh that file"
    tell(f"{found}{note if apart else ''}", writing)


@take_options_of(HomogenizeOptions, panel="Lattice and material")
def homogenize(
    request: Request,
    output: CardOption = None,
    report: ReportOption = None,
    quiet: QuietOption = False,
) -> None:
    """Compute stiffness and conductivity of a lattice that repeats, with an error by refinement; needs scikit-fem."""
    writing = OutputRequest(output, report, quiet, suffixes=MATERIAL_SUFFIXES)
    with report_unmet_request(report):
        with progress_bar(f"homogenising {request['surface']}", quiet) as progress:
            found = tpmscad.homogenize(request.pop("surface"), **request, progress=progress)
        if output is not None:
            found.write(output)
        write_report(report, found.to_dict())
    tell(found, writing)


def permeability(
    surface: SurfaceArgument,
    porosity: ChannelPorosityOption = None,
    thickness: ChannelWallOption = None,
    side: ChannelSideOption = "-",
    cell: ChannelCellOption = 1.0,
    reference: ReferenceOption = None,
    size: ChannelElementSizeOption = None,
    report: ReportOption = None,
    quiet: QuietOption = False,
) -> None:
    """Compute the permeability, mm2, of one channel of a lattice that repeats, for slow viscous flow; needs scikit-fem and gmsh.

    A cell of 1 mm, the default, gives squares of the cell.
    """
    if (porosity is None) == (thickness is None):
        here = "none of them" if porosity is None else "both"
        raise InvalidRequest(f"give exactly one of --porosity, --thickness; here: {here}")
    if porosity is not None and not 0.0 < porosity < 1.0:
        raise InvalidRequest(f"--porosity {porosity:g} must lie between 0 and 1")
    for option, value in (("--cell", cell), ("--thickness", thickness), ("--size", size)):
        if value is not None and not 0.0 < value < math.inf:
            raise InvalidRequest(f"{option} {value:g} must be a positive number")
    wall = (
        {"volume_fraction": porosity}
        if thickness is None
        else {"offset": (thickness if side == "+" else -thickness) / 2}
    )
    with report_unmet_request(report):
        with progress_bar(f"flow through the {surface}", quiet) as progress:
            channel = tpmscad.lattice(  # what the box cuts off the channel belongs to it beyond the box
                surface,
                cell=cell,
                kind="skeletal",
                side=side,
                reference=reference,
                loose="keep",
                progress=progress,
                **wall,
            )
            found = tpmscad.permeability(channel, size=None if size is None else size * cell, progress=progress)
        write_report(report, found.to_dict())
    if not quiet:
        print(found)
