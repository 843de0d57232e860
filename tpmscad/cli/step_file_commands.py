"""tpmscad check and tpmscad render: the content of a STEP file, and its picture."""

from __future__ import annotations

from tpmscad import workflows
from tpmscad.cli.options import MetricsOption, PictureOption, QuietOption, ReportOption, StepFileArgument, WithinOption
from tpmscad.cli.output import check_writable, progress_bar, report_unmet_request, write_report
from tpmscad.errors import TpmscadError


def check(
    file: StepFileArgument,
    metrics: MetricsOption = False,
    within: WithinOption = None,
    report: ReportOption = None,
    quiet: QuietOption = False,
) -> None:
    """Read a STEP file with the kernel: solids, shells, faces, validity, closedness, volume, area, units, tolerances."""
    if report is not None:
        check_writable(report, (".json",))
    with progress_bar(f"reading {file.name}", quiet):
        found = workflows.check_step(file)
    content, text = found.to_dict(), str(found)
    if found.ok and (metrics or within):
        with progress_bar(f"measuring {file.name}", quiet):
            measured = workflows.measure(file, within=within)
        content["metrics"] = measured.to_dict()
        text += f"\n{measured}"
    write_report(report, content)
    if not quiet:
        print(text)
    if not found.ok:
        raise TpmscadError(f"{file} does not hold valid closed solids: {found}" if quiet else f"{file} fails the check")


def render(
    file: StepFileArgument, output: PictureOption, report: ReportOption = None, quiet: QuietOption = False
) -> None:
    """Draw a STEP file as a PNG picture, without a display."""
    check_writable(output, (".png",))
    with report_unmet_request(report):
        with progress_bar(f"drawing {file.name}", quiet):
            workflows.render_step(file, output)
        write_report(report, {"file": str(file), "picture": str(output), "bytes": output.stat().st_size})
