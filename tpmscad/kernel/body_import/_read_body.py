"""Reading of a CAD file as bodies that can be filled."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from tpmscad.api.public_calls import validate_call
from tpmscad.api.shared_kinds import FLAG, PATH, SOLID
from tpmscad.kernel.body_import.cad_body import BodyFile, read_body_file


@validate_call()
def read_body(
    path: Annotated[
        str | Path, PATH, "A STEP (.step, .stp), IGES (.iges, .igs) or BREP (.brep) file, recognised by its content."
    ],
    *,
    solid: Annotated[
        int | str,
        SOLID,
        'Which of the solids of the file: its number from 1, "largest", the one of the greatest volume, or "all".',
    ] = "largest",
    heal: Annotated[
        bool,
        FLAG,
        "Make solids of faces that close, and repair invalid solids, and say how; if False, files that need it are refused.",
    ] = True,
) -> BodyFile:
    """Read a CAD file: its solids as a list, and those chosen as valid closed bodies for `infill` and all that take a body.

    Returns
    -------
    BodyFile
        `solids` lists all solids of the file (number, name, size, volume, faces by kind, largest edge tolerance), `healed` says
        what was repaired, `accuracy` is what the file states in mm, `shape` is the TopoDS shape of the solids chosen.

    Raises
    ------
    InvalidRequest
        If the file cannot be read, if it holds no solid and its faces do not close within 1e-5 of its size, if a solid chosen is
        invalid and cannot be healed, or if there is no solid of that number. The file is read in a child process, so that a
        crash of the kernel is such an error, too.

    Notes
    -----
    Faces are sewn at the accuracy that the file states, and at 1e-7, 1e-6 and 1e-5 of its size, whichever closes them first;
    none is moved. Invalid solids are given to the kernel's shape healing; of STEP files, circular edges that run the long way
    round are turned. What is healed is checked: valid, closed, one solid, its volume that of the points in it.

    Examples
    --------
    >>> body = tpmscad.read_body("assembly.step", solid=3)  # doctest: +SKIP
    >>> print(body.healed)  # doctest: +SKIP
    ()
    >>> tpmscad.infill(body, "gyroid", cell=8, thickness=0.8)  # doctest: +SKIP
    """
    return read_body_file(path, solid, heal=heal)
