"""tpmscad blend and tpmscad solidify: solids of fields described in a TOML file, or sampled in an array."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from tpmscad.cli.options import (
    AllowErrorsOption,
    ArrayTolOption,
    DeviationOption,
    DryRunOption,
    FieldFileArgument,
    KeepLooseOption,
    LevelOption,
    OptionalOutputOption,
    OriginOption,
    QuietOption,
    RecipeArgument,
    ReportOption,
    SchemaOption,
    SpacingOption,
    VerboseOption,
    VerifyOption,
)
from tpmscad.cli.output import (
    Writing,
    check_report,
    progress_bar,
    report_unmet_request,
    summarise,
    write_model,
    write_report,
)
from tpmscad.errors import InvalidRequest

if TYPE_CHECKING:
    from tpmscad._typing import Progress  # loads NumPy
    from tpmscad.recipe.recipe_runs import RecipeRun

_BODY = 'fill it with `tpmscad infill`, or name it in a recipe: domain = "part.step"'
INPUTS_OF_OTHER_COMMANDS = {
    ".step": _BODY,
    ".stp": _BODY,
    ".csv": 'name it in a recipe, kind = "scattered"; see `tpmscad recipe-keys scattered`',
}
"""What to do with files of these suffixes, which are no arrays."""

ReadRun = Callable[["Progress"], "RecipeRun"]


def blend(
    recipe: RecipeArgument,
    output: OptionalOutputOption = None,
    dry_run: DryRunOption = False,
    allow_errors: AllowErrorsOption = False,
    keep_loose: KeepLooseOption = False,
    deviation: DeviationOption = None,
    schema: SchemaOption = "ap242",
    verify: VerifyOption = None,
    report: ReportOption = None,
    verbose: VerboseOption = False,
    quiet: QuietOption = False,
) -> None:
    """Join porous structures as a TOML file describes, without isolated pieces or cavities, and write the solid."""

    def read(progress: Progress) -> RecipeRun:
        from tpmscad.recipe.recipe_runs import BlendRun  # loads NumPy

        return BlendRun.read(recipe, allow_errors=allow_errors, keep_loose=keep_loose, progress=progress)

    writing = _prepare_writing(output, dry_run, report, quiet, verbose, deviation, schema, verify)
    _run(f"blending {recipe.name}", read, writing, report, quiet)


def solidify(
    file: FieldFileArgument,
    level: LevelOption = None,
    spacing: SpacingOption = None,
    origin: OriginOption = None,
    tol: ArrayTolOption = None,
    output: OptionalOutputOption = None,
    dry_run: DryRunOption = False,
    keep_loose: KeepLooseOption = False,
    deviation: DeviationOption = None,
    schema: SchemaOption = "ap242",
    verify: VerifyOption = None,
    report: ReportOption = None,
    verbose: VerboseOption = False,
    quiet: QuietOption = False,
) -> None:
    """Make the solid of a field: one that a TOML file describes (graded, thresholded, mixed, mapped), or an array of numbers."""

    def read(progress: Progress) -> RecipeRun:
        from tpmscad.recipe.recipe_runs import SolidRun  # loads NumPy

        if file.suffix.lower() == ".toml":
            given = {"level": level, "spacing": spacing, "origin": origin, "tol": tol}
            extra = [f"`{name}`" for name, value in given.items() if value is not None]
            if extra:
                raise InvalidRequest(f"{', '.join(extra)}: a recipe says these itself; the options are for arrays")
            return SolidRun.read(file, keep_loose=keep_loose)
        if file.suffix.lower() in INPUTS_OF_OTHER_COMMANDS:
            raise InvalidRequest(
                f"{file.name} is no recipe and no array: {INPUTS_OF_OTHER_COMMANDS[file.suffix.lower()]}"
            )
        if level is None:
            raise InvalidRequest(
                f"an array needs `level`: solid is where {file.name} exceeds it, such as 0.5 of a density"
            )
        return SolidRun.sample(file, level=level, spacing=spacing, origin=origin, tol=tol, keep_loose=keep_loose)

    writing = _prepare_writing(output, dry_run, report, quiet, verbose, deviation, schema, verify)
    _run(f"making {file.name}", read, writing, report, quiet)


def _prepare_writing(
    output: Path | None,
    dry_run: bool,
    report: Path | None,
    quiet: bool,
    verbose: bool,
    deviation: float | None,
    schema: str,
    verify: str | None,
) -> Writing | None:
    """Where the solid goes; None for a dry run."""
    if dry_run == (output is not None):
        raise InvalidRequest("give either `output`, the file to write, or `dry_run`, which makes no solid")
    check_report(report)
    if output is None:
        return None
    return Writing(output, report, quiet, verbose, deviation=deviation, schema=schema, verify=verify)


def _run(title: str, read: ReadRun, writing: Writing | None, report: Path | None, quiet: bool) -> None:
    """Read a recipe and make its solid, or describe it in a dry run."""
    with report_unmet_request(report), progress_bar(title, quiet) as progress:
        run = read(progress)
        if writing is None:
            text, content = run.describe()
        else:
            model, content = run.make(progress)
            write_model(model, writing, progress)
            text = summarise(model, verbose=writing.verbose)
        write_report(report, content)
    if not quiet:
        print(text)
