"""tpmscad infill and tpmscad domains: a CAD body filled with a lattice, or divided into a wall and two channels."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import tpmscad
from tpmscad.api.argument_kinds import InvalidValue
from tpmscad.api.shared_kinds import parse_openings
from tpmscad.cli.derived_options import Request, take_options_of, take_output
from tpmscad.cli.options import DomainsOutputOption, JobsOption, result_option
from tpmscad.cli.output import (
    OutputRequest,
    make_and_write,
    progress_bar,
    report_unmet_request,
    tell,
    write_layers,
    write_report,
    write_triangles,
)
from tpmscad.errors import InvalidRequest
from tpmscad.file_suffixes import DOMAIN_SUFFIXES, LAYER_WRITERS, MODEL_SUFFIXES, TRIANGLE_SUFFIXES, list_suffixes
from tpmscad.requests.lattice_options import FluidDomainsOptions, InfillOptions

SlabOption = Annotated[
    int | None,
    result_option(
        min=1,
        metavar="N",
        help="With --instanced: cells of a layer of what the body cuts; 1 by default.",
        show_default=False,
    ),
]
LAYER_PANEL = "Layers or triangles instead of a solid"
LayerOption = Annotated[
    float | None,
    typer.Option(
        "--layer",
        metavar="MM",
        help=f"Height of a layer: write {list_suffixes(LAYER_WRITERS)} layers "
        "without making the solid, for tens of thousands of cells.",
        rich_help_panel=LAYER_PANEL,
    ),
]
ChordErrorOption = Annotated[
    float | None,
    typer.Option(
        "--chord-error",
        metavar="MM",
        help="Greatest distance of a chord from the exact contour of a layer; by default a quarter of the height.",
        rich_help_panel=LAYER_PANEL,
    ),
]
InstancedCellsOption = Annotated[
    bool,
    result_option(
        "--instanced",
        help="Store a whole cell once in a .step file and place it wherever it lies in the body; only the layers of cells that "
        "the body cuts are stored beside it. For thousands of cells, as touching solids of an assembly.",
    ),
]
TrianglesOption = Annotated[
    bool,
    typer.Option(
        "--triangles",
        help=f"Write {list_suffixes(TRIANGLE_SUFFIXES)} triangles, "
        "within --deviation, without making the solid, for tens of thousands of cells.",
        rich_help_panel=LAYER_PANEL,
    ),
]


@take_options_of(InfillOptions)
@take_output(suffixes=tuple(dict.fromkeys((*MODEL_SUFFIXES, *LAYER_WRITERS))))
def infill(
    request: Request,
    layer: LayerOption = None,
    chord_error: ChordErrorOption = None,
    triangles: TrianglesOption = False,
    instanced: InstancedCellsOption = False,
    slab: SlabOption = None,
    jobs: JobsOption = 1,
    *,
    writing: OutputRequest,
) -> None:
    """Fill the solid of a CAD file or a closed mesh with a lattice that is anchored at the origin of the file's coordinates."""
    assert writing.output is not None
    suffix = writing.output.suffix.lower()
    if str(request["surface"]).lower().endswith(".toml"):
        from tpmscad.recipe.solid_recipe import read_solid_recipe  # loads NumPy

        recipe = read_solid_recipe(Path(request["surface"]))
        request = {"tol": recipe.tol, **request, "surface": recipe.field}
    if instanced:
        if triangles or layer is not None:
            raise InvalidRequest("`instanced` writes a .step file of solids: leave `triangles` and `layer` out")
        make_parts(request, writing, slab or 1, jobs)
        return
    if slab is not None or jobs > 1:
        raise InvalidRequest("`slab` and `jobs` are of the parts of one file: give `instanced`, too, or leave them out")
    if triangles:
        if suffix not in TRIANGLE_SUFFIXES or layer is not None:
            raise InvalidRequest(
                f"`triangles` writes {list_suffixes(TRIANGLE_SUFFIXES)}, not {suffix} or layers: leave it out for a solid"
            )
        body, surface = request.pop("body"), request.pop("surface")
        with progress_bar(f"{surface} triangles", writing.quiet, writing.progress) as progress:
            part = tpmscad.infill_triangles(body, surface, deviation=writing.deviation, progress=progress, **request)
        write_triangles(part, body, writing)
        return
    if layer is not None:
        if suffix not in LAYER_WRITERS:
            raise InvalidRequest(
                f"`layer` writes {list_suffixes(LAYER_WRITERS)}, not {suffix}: leave it out for a solid"
            )
        body, surface = request.pop("body"), request.pop("surface")
        with progress_bar(f"{surface} layers", writing.quiet, writing.progress) as progress:
            found = tpmscad.infill_layers(
                body, surface, height=layer, chord_error=chord_error, progress=progress, **request
            )
        write_layers(found, body, writing)
        return
    if chord_error is not None or suffix not in MODEL_SUFFIXES:
        raise InvalidRequest(f"a {suffix} file of layers, and `chord_error`, need `layer`, the height of a layer in mm")
    make_and_write(
        f"{request['surface']} infill",
        lambda progress: tpmscad.infill(request.pop("body"), request.pop("surface"), progress=progress, **request),
        writing,
    )


def make_parts(request: Request, writing: OutputRequest, slab: int, jobs: int) -> None:
    """Write a filled body as whole cells and cut layers, and its figures as JSON, and print them."""
    from tpmscad.parallel import start_processes  # loads NumPy

    body, surface = request.pop("body"), request.pop("surface")
    with (
        report_unmet_request(writing.report),
        progress_bar(f"{surface} parts", writing.quiet) as progress,
        start_processes(jobs) as executor,
    ):
        file = tpmscad.export_infill(
            body,
            surface,
            writing.output or Path(),
            slab=slab,
            executor=executor,
            schema=writing.schema,
            verify=writing.verify,
            progress=progress,
            **request,
        )
    write_report(writing.report, file.to_dict())
    tell(file, writing)


@take_options_of(FluidDomainsOptions)
@take_output(DomainsOutputOption, suffixes=DOMAIN_SUFFIXES, leave_out=("verify",))
def domains(request: Request, *, writing: OutputRequest) -> None:
    """Divide a solid into the wall of a sheet lattice and the two channels beside it, for heat exchangers."""
    if "openings" in request:
        try:
            request["openings"] = parse_openings(request["openings"])
        except InvalidValue as error:
            raise typer.BadParameter(f"--open {error}") from None
    make_and_write(
        f"{request['surface']} exchanger",
        lambda progress: tpmscad.fluid_domains(
            request.pop("body"), request.pop("surface"), progress=progress, **request
        ),
        writing,
    )
