"""tpmscad infill and tpmscad domains: a CAD body filled with a lattice, or divided into a wall and two channels."""

from __future__ import annotations

import tpmscad
from tpmscad.cli.derived_options import Request, take_options_of
from tpmscad.cli.options import (
    DeviationOption,
    DomainsOutputOption,
    OutputOption,
    QuietOption,
    ReportOption,
    SchemaOption,
    VerboseOption,
    VerifyOption,
)
from tpmscad.cli.output import DOMAIN_SUFFIXES, Writing, make_and_write
from tpmscad.requests.lattice_options import FluidDomainsOptions, InfillOptions


@take_options_of(InfillOptions)
def infill(
    request: Request,
    *,
    output: OutputOption,
    deviation: DeviationOption = None,
    schema: SchemaOption = "ap242",
    verify: VerifyOption = None,
    report: ReportOption = None,
    verbose: VerboseOption = False,
    quiet: QuietOption = False,
) -> None:
    """Fill the solid in a STEP file with a lattice that is anchored at the origin of the file's coordinates."""
    make_and_write(
        f"{request['surface']} infill",
        lambda progress: tpmscad.infill(request.pop("body"), request.pop("surface"), progress=progress, **request),
        Writing(output, report, quiet, verbose, deviation=deviation, schema=schema, verify=verify),
    )


@take_options_of(FluidDomainsOptions)
def domains(
    request: Request,
    *,
    output: DomainsOutputOption,
    deviation: DeviationOption = None,
    schema: SchemaOption = "ap242",
    report: ReportOption = None,
    verbose: VerboseOption = False,
    quiet: QuietOption = False,
) -> None:
    """Divide the solid in a STEP file into the wall of a sheet lattice and the two channels beside it, for heat exchangers."""
    make_and_write(
        f"{request['surface']} exchanger",
        lambda progress: tpmscad.fluid_domains(
            request.pop("body"), request.pop("surface"), progress=progress, **request
        ),
        Writing(output, report, quiet, verbose, deviation=deviation, schema=schema, suffixes=DOMAIN_SUFFIXES),
    )
