"""tpmscad infill and tpmscad domains: a CAD body filled with a lattice, or divided into a wall and two channels."""

from __future__ import annotations

import tpmscad
from tpmscad.cli.lattice_options import (
    BodyPhaseOption,
    CellOption,
    KindOption,
    OffsetOption,
    OpenFacesOption,
    PoreSizeOption,
    PorosityOption,
    ReferenceOption,
    RotationOption,
    SheetOffsetOption,
    SideOption,
    SkinOption,
    SurfaceArgument,
    ThicknessOption,
    VolumeFractionOption,
)
from tpmscad.cli.options import (
    BodyArgument,
    DeviationOption,
    DomainsOutputOption,
    KeepLooseOption,
    OutputOption,
    QuietOption,
    ReportOption,
    SchemaOption,
    TolOption,
    VerboseOption,
    VerifyOption,
)
from tpmscad.cli.output import DOMAIN_SUFFIXES, Writing, given_options, make_and_write


def infill(
    body: BodyArgument,
    surface: SurfaceArgument,
    *,
    cell: CellOption = None,
    thickness: ThicknessOption = None,
    offset: OffsetOption = None,
    volume_fraction: VolumeFractionOption = None,
    porosity: PorosityOption = None,
    pore_size: PoreSizeOption = None,
    skin: SkinOption = None,
    open_faces: OpenFacesOption = None,
    kind: KindOption = "sheet",
    side: SideOption = "-",
    reference: ReferenceOption = None,
    phase: BodyPhaseOption = None,
    rotation: RotationOption = "0,0,0",
    output: OutputOption,
    tol: TolOption = None,
    keep_loose: KeepLooseOption = False,
    deviation: DeviationOption = None,
    schema: SchemaOption = "ap242",
    verify: VerifyOption = None,
    report: ReportOption = None,
    verbose: VerboseOption = False,
    quiet: QuietOption = False,
) -> None:
    """Fill the solid in a STEP file with a lattice that is anchored at the origin of the file's coordinates."""
    request = given_options(
        cell=cell,
        thickness=thickness,
        offset=offset,
        volume_fraction=volume_fraction,
        porosity=porosity,
        pore_size=pore_size,
        skin=skin,
        open_faces=open_faces,
        tol=tol,
        kind=kind,
        side=side,
        reference=reference,
        phase=phase,
        rotation=rotation,
        loose="keep" if keep_loose else None,
    )
    make_and_write(
        f"{surface} infill",
        lambda progress: tpmscad.infill(body, surface, progress=progress, **request),
        Writing(output, report, quiet, verbose, deviation=deviation, schema=schema, verify=verify),
    )


def domains(
    body: BodyArgument,
    surface: SurfaceArgument,
    *,
    cell: CellOption = None,
    thickness: ThicknessOption = None,
    offset: SheetOffsetOption = None,
    volume_fraction: VolumeFractionOption = None,
    porosity: PorosityOption = None,
    pore_size: PoreSizeOption = None,
    reference: ReferenceOption = None,
    phase: BodyPhaseOption = None,
    rotation: RotationOption = "0,0,0",
    output: DomainsOutputOption,
    tol: TolOption = None,
    deviation: DeviationOption = None,
    schema: SchemaOption = "ap242",
    report: ReportOption = None,
    verbose: VerboseOption = False,
    quiet: QuietOption = False,
) -> None:
    """Divide the solid in a STEP file into the wall of a sheet lattice and the two channels beside it, for heat exchangers."""
    request = given_options(
        cell=cell,
        thickness=thickness,
        offset=offset,
        volume_fraction=volume_fraction,
        porosity=porosity,
        pore_size=pore_size,
        tol=tol,
        reference=reference,
        phase=phase,
        rotation=rotation,
    )
    make_and_write(
        f"{surface} exchanger",
        lambda progress: tpmscad.fluid_domains(body, surface, progress=progress, **request),
        Writing(output, report, quiet, verbose, deviation=deviation, schema=schema, suffixes=DOMAIN_SUFFIXES),
    )
