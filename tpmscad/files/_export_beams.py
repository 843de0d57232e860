"""`export_beams`: struts as the beam lattice of a 3MF file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import numpy as np

from tpmscad.api.public_calls import validate_call
from tpmscad.api.shared_kinds import ANYTHING, PATH
from tpmscad.atomic_file import validate_output_path
from tpmscad.errors import InvalidRequest
from tpmscad.fields.data.beam_files import BeamLattice, write_beam_file
from tpmscad.fields.data.edge_radii import greatest_radii
from tpmscad.fields.kinds.beam_lattices import BeamsField
from tpmscad.fields.kinds.strut_graphs import StrutsField
from tpmscad.results.model import Model

BEAM_SUFFIXES = (".3mf",)
"""Formats of beam lattices."""


@validate_call()
def export_beams(
    source: Annotated[Any, ANYTHING, "A field of struts, or beams of a file; or a model of struts."],
    path: Annotated[
        str | Path, PATH, "The ``.3mf`` file to write, complete and verified by lib3mf's strict reader, or absent."
    ],
) -> None:
    """Write struts as a 3MF beam lattice: nodes, beams with a radius at each end, and balls, in millimetres.

    Raises
    ------
    InvalidRequest
        If the source has no struts, or its beams are clipped or have triangles beside them.
    FileError
        If the file cannot be written.

    Examples
    --------
    >>> octet = fields.strut_lattice("octet", cell=10, diameter=1, cells=3)
    >>> tpmscad.export_beams(octet, "octet.3mf")  # doctest: +SKIP
    """
    path = validate_output_path(path, BEAM_SUFFIXES)
    field = source.struts if isinstance(source, Model) else source
    if isinstance(field, BeamsField) and isinstance(field.field, StrutsField):
        field = field.struts
    if not isinstance(field, StrutsField):
        raise InvalidRequest(
            f"{type(source).__name__} is no field of struts alone: give a field of struts, the beams of a file without "
            "clipping, or a model of struts"
        )
    balls = np.where(field.balls > greatest_radii(len(field.points), field.edges, field.radii), field.balls, 0.0)
    write_beam_file(path, BeamLattice(field.points, field.edges, field.radii, balls), path.stem)
