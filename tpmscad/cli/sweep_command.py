"""tpmscad sweep: a table of designs made and measured, into a table of results."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import tpmscad
from tpmscad.cli.options import JobsOption, QuietOption, ReportOption, input_file, output_option
from tpmscad.cli.output import OutputRequest, progress_bar, tell, write_report
from tpmscad.errors import NotMet

TableArgument = Annotated[
    Path,
    input_file(
        "TABLE",
        "A .csv or .parquet file, one design a line. Columns: the keywords of lattice and infill (surface, cell, thickness, "
        "..., body), or recipe and its keys; file names the solid's file: gyroid_{thickness}.step.",
    ),
]
ResultsOption = Annotated[
    Path,
    output_option("The results. Designs that it holds already are not made again.", "FILE.csv"),
]
WidthsOption = Annotated[
    bool, typer.Option("--metrics", help="Measure smallest wall, smallest pore and hydraulic diameter, too.")
]
PropertiesOption = Annotated[
    bool,
    typer.Option(
        "--properties",
        help="Compute homogenised stiffness and conductivity, too, relative to a solid of Poisson's ratio 0.3.",
    ),
]
FlowOption = Annotated[
    Path | None,
    typer.Option(
        metavar="FLOW.toml",
        exists=True,
        dir_okay=False,
        help="Of exchangers, estimate effectiveness, heat and pressure drops of two fluids, too: tables plus and minus with "
        "density, viscosity, conductivity, specific_heat, volume_flow or mass_flow (SI units), temperature; arrangement, "
        "wall_conductivity, wall_density.",
    ),
]
SolidsOption = Annotated[
    bool, typer.Option("--solids/--no-solids", help="Make solids, or take figures of exchangers from samples alone.")
]


def sweep(
    table: TableArgument,
    *,
    output: ResultsOption = Path("results.csv"),
    metrics: WidthsOption = False,
    properties: PropertiesOption = False,
    flow: FlowOption = None,
    solids: SolidsOption = True,
    jobs: JobsOption = 1,
    report: ReportOption = None,
    quiet: QuietOption = False,
) -> None:
    """Make and measure every design of a table; after an interruption the same command goes on."""
    from tpmscad.parallel import start_processes  # loads NumPy
    from tpmscad.recipe.toml_entry import read_document

    fluids = None if flow is None else read_document(flow).value
    writing = OutputRequest(output, report, quiet, suffixes=(".csv",))
    with progress_bar(f"sweep of {table.name}", quiet) as progress, start_processes(jobs) as executor:
        results = tpmscad.sweep(
            table,
            executor,
            output,
            metrics=metrics,
            properties=properties,
            flow=fluids,
            solids=solids,
            progress=progress,
        )
    write_report(report, results.to_dict())
    tell(results, writing)
    if not results.met:
        raise NotMet(f"{len(results.failures)} of {len(results.rows)} designs miss the request: see {output}")
