"""tpmscad infill and tpmscad domains: a CAD body filled with a lattice, or divided into a wall and two channels."""

from __future__ import annotations

import tpmscad
from tpmscad.cli.derived_options import Request, take_options_of, take_output
from tpmscad.cli.options import DomainsOutputOption
from tpmscad.cli.output import DOMAIN_SUFFIXES, OutputRequest, make_and_write
from tpmscad.requests.lattice_options import FluidDomainsOptions, InfillOptions


@take_options_of(InfillOptions)
@take_output()
def infill(request: Request, *, writing: OutputRequest) -> None:
    """Fill a solid, of a STEP file or a closed mesh, with a lattice anchored at the origin of the file's coordinates."""
    make_and_write(
        f"{request['surface']} infill",
        lambda progress: tpmscad.infill(request.pop("body"), request.pop("surface"), progress=progress, **request),
        writing,
    )


@take_options_of(FluidDomainsOptions)
@take_output(DomainsOutputOption, suffixes=DOMAIN_SUFFIXES, leave_out=("verify",))
def domains(request: Request, *, writing: OutputRequest) -> None:
    """Divide a solid into the wall of a sheet lattice and the two channels beside it, for heat exchangers."""
    make_and_write(
        f"{request['surface']} exchanger",
        lambda progress: tpmscad.fluid_domains(
            request.pop("body"), request.pop("surface"), progress=progress, **request
        ),
        writing,
    )
