"""Reading of a CAD file with the kernel, and the report of its content."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from tpmscad.api.public_calls import validate_call
from tpmscad.api.shared_kinds import COUNT, FLAG, PATH
from tpmscad.errors import InvalidRequest
from tpmscad.fields.data.beam_files import is_beam_path
from tpmscad.fields.data.triangle_mesh import is_mesh_path
from tpmscad.file_suffixes import READ_TRIANGLE_SUFFIXES, list_suffixes
from tpmscad.files.beam_report import BeamReport, report_beams
from tpmscad.files.mesh_report import MeshReport, report_mesh
from tpmscad.kernel.body_import.isolated_reader import check_foreign_step
from tpmscad.kernel.measure.shape_report import StepReport


@validate_call()
def check_step(
    path: Annotated[
        str | Path, PATH, f"The STEP, IGES or BREP file, or triangles: {list_suffixes(READ_TRIANGLE_SUFFIXES)}."
    ],
    *,
    faces: Annotated[
        bool, FLAG, "Tell each face, too: the label that it has as a face of a filled body, its kind, area and place."
    ] = False,
    solid: Annotated[int | None, COUNT, "Report on this solid only, by its number from 1."] = None,
) -> StepReport | MeshReport | BeamReport:
    """Read a CAD file with the kernel, or a file of triangles, and report its content.

    Returns
    -------
    StepReport, MeshReport or BeamReport
        Of a 3MF file with beams: their number, nodes, radii, balls, clipping, and the triangles beside them. Of triangles: their
        number, pieces, open sides, volume, area and box, as they are. Of a CAD file:
        Products, units and `shape`: numbers of solids, shells and faces, validity, closedness, volume, area and tolerances; the
        list of `solids`; and `healing`, what `read_body` repairs of a file that is not `ok`, which is reported as it is.
        `ok` is True if the file holds valid closed solids; `to_dict()` is what ``tpmscad check --report`` writes.

    Raises
    ------
    InvalidRequest
        If there is no such file, it is none of a known format, the kernel cannot read it, or it holds no solid and its faces
        do not close. The file is read in a child process, so that a crash of the kernel is such an error, too.

    Examples
    --------
    >>> tpmscad.check_step("gyroid.step").ok  # doctest: +SKIP
    True
    """
    if is_beam_path(path) and not faces and solid is None:
        return report_beams(Path(path))
    if is_mesh_path(path):
        if faces or solid is not None:
            raise InvalidRequest(f"`faces` and `solid` are of CAD files: leave them out for the triangles of {path}")
        return report_mesh(Path(path))
    return check_foreign_step(path, faces=faces, solid=solid)
