"""tpmscad lattice: a lattice of a minimal surface in a box, straight or wrapped."""

from __future__ import annotations

import math
from typing import Any

from tpmscad import workflows
from tpmscad.cli.lattice_options import (
    BoundaryOption,
    CellOption,
    CellsOption,
    KindOption,
    MapOption,
    OffsetOption,
    PhaseOption,
    PoreSizeOption,
    PorosityOption,
    ReferenceOption,
    SideOption,
    SurfaceArgument,
    ThicknessOption,
    VolumeFractionOption,
)
from tpmscad.cli.options import (
    DeviationOption,
    InstancedOption,
    KeepLooseOption,
    OutputOption,
    QuietOption,
    ReportOption,
    SchemaOption,
    TolOption,
    VerboseOption,
)
from tpmscad.cli.output import Writing, given_options, make_and_write
from tpmscad.errors import InvalidRequest

MAP_NAMES = ("cylinder", "sphere")


def lattice(
    surface: SurfaceArgument,
    *,
    cell: CellOption = None,
    cells: CellsOption = "1,1,1",
    thickness: ThicknessOption = None,
    offset: OffsetOption = None,
    volume_fraction: VolumeFractionOption = None,
    porosity: PorosityOption = None,
    pore_size: PoreSizeOption = None,
    kind: KindOption = "sheet",
    side: SideOption = "-",
    reference: ReferenceOption = None,
    boundary: BoundaryOption = None,
    phase: PhaseOption = None,
    map: MapOption = None,
    output: OutputOption,
    tol: TolOption = None,
    keep_loose: KeepLooseOption = False,
    deviation: DeviationOption = None,
    instanced: InstancedOption = False,
    schema: SchemaOption = "ap242",
    report: ReportOption = None,
    verbose: VerboseOption = False,
    quiet: QuietOption = False,
) -> None:
    """Make a lattice of a minimal surface that fills the box from the origin to CELLS x CELL."""
    request = given_options(
        cell=cell,
        cells=cells,
        thickness=thickness,
        offset=offset,
        volume_fraction=volume_fraction,
        porosity=porosity,
        pore_size=pore_size,
        tol=tol,
        kind=kind,
        side=side,
        reference=reference,
        boundary="natural" if boundary is None and map is not None else boundary,
        phase=phase,
        map=None if map is None else read_map(map, cell, cells),
        loose="keep" if keep_loose else None,
    )
    make_and_write(
        f"{surface} lattice",
        lambda progress: workflows.lattice(surface, progress=progress, **request),
        Writing(output, report, quiet, verbose, deviation=deviation, schema=schema, instanced=instanced),
    )


def read_map(text: str, cell: Any, cells: Any) -> Any:
    """The map of `cylinder`, `cylinder:RADIUS` or `sphere:RADIUS`; without a radius the cells along x close a ring."""
    from tpmscad.lattices import maps  # loads NumPy

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
