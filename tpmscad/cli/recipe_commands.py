"""tpmscad blend and tpmscad solidify: solids of fields described in a TOML file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from tpmscad import recipe as recipes
from tpmscad.cli.options import (
    AllowErrorsOption,
    DryRunOption,
    QuietOption,
    RecipeArgument,
    RecipeOutputOption,
    ReportOption,
    SchemaOption,
)
from tpmscad.cli.output import (
    STEP_SUFFIXES,
    check_writable,
    progress_bar,
    report_unmet_request,
    write_model,
    write_report,
)
from tpmscad.errors import InvalidRequest

if TYPE_CHECKING:
    from tpmscad._typing import Progress  # loads NumPy
    from tpmscad.recipe.recipe_runs import RecipeRun


def blend(
    recipe: RecipeArgument,
    output: RecipeOutputOption = None,
    dry_run: DryRunOption = False,
    allow_errors: AllowErrorsOption = False,
    schema: SchemaOption = "ap242",
    report: ReportOption = None,
    quiet: QuietOption = False,
) -> None:
    """Join porous structures as a TOML file describes, without isolated pieces or cavities, and write the solid as STEP."""

    def read(path: Path, progress: Progress | None) -> RecipeRun:
        return recipes.BlendRun.read(path, allow_errors=allow_errors, progress=progress)

    _run(recipe, output, dry_run, f"blending {recipe.name}", read, schema=schema, report=report, quiet=quiet)


def solidify(
    recipe: RecipeArgument,
    output: RecipeOutputOption = None,
    dry_run: DryRunOption = False,
    schema: SchemaOption = "ap242",
    report: ReportOption = None,
    quiet: QuietOption = False,
) -> None:
    """Make the solid of a field that a TOML file describes (graded, thresholded, mapped), and write it as STEP."""

    def read(path: Path, progress: Progress | None) -> RecipeRun:
        return recipes.SolidRun.read(path)

    _run(recipe, output, dry_run, f"making {recipe.name}", read, schema=schema, report=report, quiet=quiet)


def _run(
    path: Path,
    output: Path | None,
    dry_run: bool,
    title: str,
    read: Callable[[Path, Progress | None], RecipeRun],
    *,
    schema: str,
    report: Path | None,
    quiet: bool,
) -> None:
    """Read a recipe and make its solid, or describe it in a dry run."""
    if dry_run == (output is not None):
        raise InvalidRequest("give either --output FILE.step, or --dry-run, which writes no STEP file")
    if output is not None:
        check_writable(output, STEP_SUFFIXES)
    with report_unmet_request(report), progress_bar(title, quiet) as progress:
        run = read(path, progress)
        if output is None:
            text, content = run.describe()
        else:
            model, content = run.make(progress)
            write_model(model, output, progress, schema=schema)
            text = str(model.certificate)
        write_report(report, content)
    if not quiet:
        print(text)
