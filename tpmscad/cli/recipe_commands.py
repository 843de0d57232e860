"""tpmscad blend and tpmscad solidify: solids of fields described in a TOML file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from tpmscad.cli.options import QuietOption, ReportOption, SchemaOption
from tpmscad.cli.output import (
    STEP_SUFFIXES,
    check_writable,
    progress_bar,
    report_unmet_request,
    write_model,
    write_report,
)
from tpmscad.errors import InvalidRequest

RecipeArgument = Annotated[
    Path,
    typer.Argument(metavar="FILE.toml", exists=True, dir_okay=False, help="What to make; examples/*.toml show how."),
]
RecipeOutputOption = Annotated[
    Path | None, typer.Option("--output", "-o", metavar="FILE.step", help="The STEP file to write.")
]
DryRunOption = Annotated[
    bool, typer.Option("--dry-run", help="Read and check only: no solid is made and nothing written.")
]
AllowErrorsOption = Annotated[
    bool, typer.Option("--allow-errors", help="Make the solid even of a blend with errors left; its notes say which.")
]


def blend(
    recipe: RecipeArgument,
    output: RecipeOutputOption = None,
    dry_run: DryRunOption = False,
    allow_errors: AllowErrorsOption = False,
    schema: SchemaOption = "ap242",
    report: ReportOption = None,
    quiet: QuietOption = False,
) -> None:
    """Join porous structures as a TOML file says, without isolated pieces or holes, and write the solid as a STEP file."""
    _check_output_or_dry_run(output, dry_run)
    with report_unmet_request(report):
        from tpmscad import recipe as recipes

        with progress_bar(f"blending {recipe.name}", quiet) as progress:
            scaffold = recipes.read_blend_recipe(recipe)
            result = recipes.run_blend_recipe(scaffold, allow_errors=allow_errors, progress=progress)
            if output is None:
                write_report(report, result.to_dict())
                text = result.message
            else:
                model = recipes.solidify_blend(scaffold, result, progress)
                write_model(model, output, progress, schema=schema)
                write_report(report, model.certificate.to_dict() | {"blend": result.to_dict()})
                text = str(model.certificate)
    if not quiet:
        print(text)


def solidify(
    recipe: RecipeArgument,
    output: RecipeOutputOption = None,
    dry_run: DryRunOption = False,
    schema: SchemaOption = "ap242",
    report: ReportOption = None,
    quiet: QuietOption = False,
) -> None:
    """Make the solid of a field that a TOML file describes, graded, thresholded or mapped, as a STEP file."""
    _check_output_or_dry_run(output, dry_run)
    with report_unmet_request(report):
        from tpmscad import recipe as recipes

        with progress_bar(f"making {recipe.name}", quiet) as progress:
            part = recipes.read_solid_recipe(recipe)
            if output is None:
                write_report(report, part.to_dict())
                text = str(part)
            else:
                model = recipes.solidify_recipe(part, progress)
                write_model(model, output, progress, schema=schema)
                write_report(report, model.certificate.to_dict())
                text = str(model.certificate)
    if not quiet:
        print(text)


def _check_output_or_dry_run(output: Path | None, dry_run: bool) -> None:
    """Either a file to write, or no more than a look."""
    if dry_run == (output is not None):
        raise InvalidRequest("give either --output FILE.step, or --dry-run, which writes none")
    if output is not None:
        check_writable(output, STEP_SUFFIXES)
