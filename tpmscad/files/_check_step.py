"""Reading of a STEP file with the kernel, and the report of its content."""

from __future__ import annotations

from pathlib import Path

from tpmscad.api.public_calls import public
from tpmscad.kernel.body_import.isolated_reader import check_foreign_step
from tpmscad.kernel.measure.shape_report import StepReport


@public()
def check_step(path: str | Path) -> StepReport:
    """Read a STEP file with the kernel and report its content.

    Parameters
    ----------
    path : str or Path
        The STEP file.

    Returns
    -------
    StepReport
        Products, units and `shape`: numbers of solids, shells and faces, validity, closedness, volume, area and tolerances.
        `ok` is True if the file holds valid closed solids; `to_dict()` is what ``tpmscad check --report`` writes.

    Raises
    ------
    InvalidRequest
        If there is no such file, it is not a STEP file, the kernel cannot read it, or it holds no solid. The file is read in a
        child process, so that a crash of the kernel is such an error, too.

    Examples
    --------
    >>> tpmscad.check_step("gyroid.step").ok  # doctest: +SKIP
    True
    """
    return check_foreign_step(path)
