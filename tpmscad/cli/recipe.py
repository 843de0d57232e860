"""tpmscad blend and tpmscad solidify: solids of fields described in a TOML file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from tpmscad.cli.options import Quiet, Report, Schema
from tpmscad.cli.output import STEP_SUFFIXES, progress_bar, reported, writable, write_model, write_report
from tpmscad.errors import InvalidRequest

Recipe = Annotated[
    Path,
    typer.Argument(metavar="FILE.toml", exists=True, dir_okay=False, help="What to make; examples/*.toml show how."),
]
Output = Annotated[Path | None, typer.Option("--output", "-o", metavar="FILE.step", help="The STEP file to write.")]
DryRun = Annotated[bool, typer.Option("--dry-run", help="Read and check only: no solid is made and nothing written.")]
AllowErrors = Annotated[
    bool, typer.Option("--allow-errors", help="Make the solid even of a blend with errors left; its notes say which.")
]


def blend(
    recipe: Recipe,
    output: Output = None,
    dry_run: DryRun = False,
    allow_errors: AllowErrors = False,
    schema: Schema = "ap242",
    report: Report = None,
    quiet: Quiet = False,
) -> None:
    """Join porous structures as a TOML file says, without isolated pieces or holes, and write the solid as a STEP file."""
    _asked(output, dry_run)
    with reported(report):
        from tpmscad import recipe as recipes

        with progress_bar(f"blending {recipe.name}", quiet) as progress:
            scaffold = recipes.read_scaffold(recipe)
            result = recipes.blend_of(scaffold, allow_errors=allow_errors, progress=progress)
            if output is None:
                write_report(report, result.to_dict())
                text = result.message
            else:
                model = recipes.solid_of_blend(scaffold, result, progress)
                write_model(model, output, progress, schema=schema)
                write_report(report, model.certificate.to_dict() | {"blend": result.to_dict()})
                text = str(model.certificate)
    if not quiet:
        print(text)


def solidify(
    recipe: Recipe,
    output: Output = None,
    dry_run: DryRun = False,
    schema: Schema = "ap242",
    report: Report = None,
    quiet: Quiet = False,
) -> None:
    """Make the solid of a field that a TOML file describes, graded, thresholded or mapped, as a STEP file."""
    _asked(output, dry_run)
    with reported(report):
        from tpmscad import recipe as recipes

        with progress_bar(f"making {recipe.name}", quiet) as progress:
            part = recipes.read_part(recipe)
            if output is None:
                write_report(report, part.to_dict())
                text = str(part)
            else:
                model = recipes.solid_of_part(part, progress)
                write_model(model, output, progress, schema=schema)
                write_report(report, model.certificate.to_dict())
                text = str(model.certificate)
    if not quiet:
        print(text)


def _asked(output: Path | None, dry_run: bool) -> None:
    """Either a file to write, or no more than a look."""
    if dry_run == (output is not None):
        raise InvalidRequest("give either --output FILE.step, or --dry-run, which writes none")
    if output is not None:
        writable(output, STEP_SUFFIXES)
