"""tpmscad check and tpmscad render: what is done with a STEP file."""

from __future__ import annotations

from tpmscad.cli.options import Measured, Picture, Quiet, Report, StepFile, Within
from tpmscad.cli.output import progress_bar, reported, writable, write_report
from tpmscad.errors import TpmscadError


def check(
    file: StepFile, metrics: Measured = False, within: Within = None, report: Report = None, quiet: Quiet = False
) -> None:
    """Read a STEP file back with the kernel: solids, shells, faces, validity, closedness, volume, area, units, tolerances."""
    if report is not None:
        writable(report, (".json",))
    from tpmscad import workflows

    with progress_bar(f"reading {file.name}", quiet):
        found = workflows.check_step(file)
    content, text = found.to_dict(), str(found)
    if found.ok and (metrics or within):
        from tpmscad.metrics import measure

        with progress_bar(f"measuring {file.name}", quiet):
            measured = measure(file, within=within)
        content["metrics"] = measured.to_dict()
        text += f"\n{measured}"
    write_report(report, content)
    if not quiet:
        print(text)
    if not found.ok:
        raise TpmscadError(f"{file} does not hold valid closed solids: {found}" if quiet else f"{file} fails the check")


def render(file: StepFile, output: Picture, report: Report = None, quiet: Quiet = False) -> None:
    """Draw a STEP file as a PNG picture. No display is needed."""
    writable(output, (".png",))
    with reported(report):
        from tpmscad import workflows

        with progress_bar(f"drawing {file.name}", quiet):
            workflows.render_step(file, output)
        write_report(report, {"file": str(file), "picture": str(output), "bytes": output.stat().st_size})
