"""Reading of a CAD file with the kernel, and the report of its content."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from tpmscad.api.public_calls import validate_call
from tpmscad.api.shared_kinds import COUNT, FLAG, PATH
from tpmscad.kernel.body_import.isolated_reader import check_foreign_step
from tpmscad.kernel.measure.shape_report import StepReport


@validate_call()
def check_step(
    path: Annotated[str | Path, PATH, "The STEP, IGES or BREP file."],
    *,
    faces: Annotated[
        bool, FLAG, "Tell each face, too: the label that it has as a face of a filled body, its kind, area and place."
    ] = False,
    solid: Annotated[int | None, COUNT, "Report on this solid only, by its number from 1."] = None,
) -> StepReport:
    """Read a CAD file with the kernel and report its content.

    Returns
    -------
    StepReport
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
    return check_foreign_step(path, faces=faces, solid=solid)
