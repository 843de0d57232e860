"""tpmscad blend and tpmscad solidify: solids of fields described in a TOML file, or sampled in an array."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from tpmscad.cli.derived_options import take_output
from tpmscad.cli.option_language import RENAMED_KEYWORDS, speak_in_options
from tpmscad.cli.options import (
    AllowErrorsOption,
    AmongOption,
    ArrayCellOption,
    ArrayFractionOption,
    ArrayNameOption,
    ArrayTolOption,
    AsSurfaceOption,
    CentredOption,
    ClearOption,
    DryRunOption,
    FieldFileArgument,
    FrameOption,
    KeepLooseOption,
    KeepOption,
    LabelOption,
    LevelOption,
    OptionalOutputOption,
    OriginOption,
    RecipeArgument,
    SmoothingOption,
    SpacingOption,
    VolumeOption,
)
from tpmscad.cli.output import (
    OutputRequest,
    describe_mesh,
    progress_bar,
    report_unmet_request,
    summarise,
    tell,
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


@take_output(OptionalOutputOption)
def blend(
    recipe: RecipeArgument,
    *,
    dry_run: DryRunOption = False,
    allow_errors: AllowErrorsOption = False,
    keep_loose: KeepLooseOption = False,
    writing: OutputRequest,
) -> None:
    """Join porous structures as a TOML file describes, without isolated pieces or cavities, and write the solid."""

    def read(progress: Progress) -> RecipeRun:
        from tpmscad.recipe.recipe_runs import BlendRun  # loads NumPy

        return BlendRun.read(recipe, allow_errors=allow_errors, keep_loose=keep_loose, progress=progress)

    _run("blending", recipe, read, writing, dry_run)


@take_output(OptionalOutputOption)
def solidify(
    file: FieldFileArgument,
    *,
    level: LevelOption = None,
    volume_fraction: ArrayFractionOption = None,
    as_surface: AsSurfaceOption = None,
    cell: ArrayCellOption = None,
    smoothing: SmoothingOption = None,
    label: LabelOption = None,
    among: AmongOption = None,
    spacing: SpacingOption = None,
    origin: OriginOption = None,
    centred: CentredOption = None,
    frame: FrameOption = None,
    volume: VolumeOption = None,
    array_name: ArrayNameOption = None,
    keep: KeepOption = None,
    clear: ClearOption = None,
    tol: ArrayTolOption = None,
    dry_run: DryRunOption = False,
    keep_loose: KeepLooseOption = False,
    writing: OutputRequest,
) -> None:
    """Make the solid of a field: one that a TOML file describes (graded, thresholded, mixed, mapped), an array, or beams.

    Of an array of grey values it is the part above a level, or the densest part of a volume fraction; of one of integers that
    of a label; of a .3mf file its beams, with the triangles beside them.
    """

    def read(progress: Progress) -> RecipeRun:
        from tpmscad.recipe.recipe_runs import SolidRun  # loads NumPy

        given = {
            "level": level,
            "volume_fraction": volume_fraction,
            "as_surface": as_surface,
            "cell": cell,
            "smoothing": smoothing,
            "label": label,
            "among": among,
            "spacing": spacing,
            "origin": origin,
            "centred": centred,
            "frame": frame,
            "volume": volume,
            "array_name": array_name,
        }
        if file.suffix.lower() == ".toml":
            extra = [
                f"`{name}`"
                for name, value in {**given, "keep": keep, "clear": clear, "tol": tol}.items()
                if value is not None
            ]
            if extra:
                raise InvalidRequest(
                    f"{', '.join(extra)}: a recipe says these itself, write them there; the options are for arrays"
                )
            return SolidRun.read(file, keep_loose=keep_loose)
        if file.suffix.lower() in INPUTS_OF_OTHER_COMMANDS:
            raise InvalidRequest(
                f"{file.name} is no recipe and no array: {INPUTS_OF_OTHER_COMMANDS[file.suffix.lower()]}"
            )
        return SolidRun.sample(file, **given, keep=keep, clear=clear, tol=tol, keep_loose=keep_loose)

    _run("making", file, read, writing, dry_run)


def _run(verb: str, file: Path, read: ReadRun, writing: OutputRequest, dry_run: bool) -> None:
    """Read a recipe and make its solid, or describe it in a dry run."""
    if not dry_run and writing.output is None:
        raise InvalidRequest(
            f"give `output`, the file to write, as in -o {file.stem}.step, or `dry_run`, which makes no solid"
        )
    with (
        report_unmet_request(writing.report),
        progress_bar(f"{verb} {file.name}", writing.quiet, writing.progress) as progress,
    ):
        run, holds = read(progress), ""
        if dry_run:
            text, content = run.describe()
            text += f"\nfile        {writing.output} would be written" if writing.output else ""
        else:
            model, content = run.make(progress)
            made = write_model(model, writing, progress)
            holds, content = made.summary(), content | describe_mesh(made)
            text = summarise(model, verbose=writing.verbose)
        write_report(writing.report, content)
    told = replace(writing, output=None) if dry_run else writing
    tell(speak_in_options(text, RENAMED_KEYWORDS), told, holds=holds)
