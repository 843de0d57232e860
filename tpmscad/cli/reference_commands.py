"""tpmscad surfaces, template and recipe-keys: the catalogue, a recipe to start from, and all that recipes may hold."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Annotated, Literal

import typer

from tpmscad.atomic_file import atomic_write
from tpmscad.catalogue import CATALOGUE
from tpmscad.cli.options import QuietOption, output_option
from tpmscad.cli.output import OutputRequest, tell
from tpmscad.errors import InvalidRequest

MIN_WIDTH, MAX_WIDTH = 60, 100
"""Columns of printed text: those of the terminal, within these limits."""

JsonOption = Annotated[bool, typer.Option("--json", help="Print the whole catalogue as JSON.")]
TemplateArgument = Annotated[
    Literal["blend", "solidify", "sweep"],
    typer.Argument(help="The command that the recipe or table is for.", metavar="blend|solidify|sweep"),
]
TemplateFileOption = Annotated[
    Path | None, output_option("Write it to a file, .toml or for sweeps .csv, instead of printing it.")
]
KindArgument = Annotated[
    str | None, typer.Argument(metavar="[KIND]", help="One kind of field, such as `rod`; all if it is left out.")
]


def surfaces(as_json: JsonOption = False) -> None:
    """List the surfaces: names, references, genus, space group, and the thickest wall that a sheet may have."""
    from tpmscad.studies._thickest_wall import thickest_wall  # loads NumPy

    rows = [
        {
            "name": info.name,
            "title": info.title,
            "aliases": list(info.aliases),
            "references": list(info.references),
            "patches_per_cell": info.patches_per_cell,
            "genus": info.genus,
            "space_group": info.space_group,
            "formula": info.formula,
            "thickest_wall": thickest_wall(info.name),
        }
        for info in CATALOGUE.values()
    ]
    if as_json:
        print(json.dumps(rows, indent=2))
        return
    head = ("name", "short", "thickest wall", "reference", "genus", "space group")
    table = [head]
    for row in rows:
        names = row["aliases"]
        table.append(
            (
                str(row["name"]),
                str(names[0]) if isinstance(names, list) and len(names[0]) <= MAX_ALIAS else "",
                f"{row['thickest_wall']:.3f} cell",
                ", ".join(row["references"]),  # type: ignore[arg-type]
                str(row["genus"]),
                str(row["space_group"]),
            )
        )
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    for line in table:
        print("  ".join(entry.ljust(width) for entry, width in zip(line, widths, strict=True)).rstrip())
    print(f"\n{CATALOGUE_NOTE}")


MAX_ALIAS = 5
"""Letters of an alias that the table shows."""

CATALOGUE_NOTE = """Thickest wall: --thickness stays below it, times the edge of the cell, or the
wall would fold. --json prints the formulas, too."""


def template(recipe: TemplateArgument, output: TemplateFileOption = None, quiet: QuietOption = False) -> None:
    """Print a commented recipe, or a table, that runs as it is: save it, change it, and hand it to the command of that name."""
    writing = OutputRequest(output, quiet=quiet, suffixes=(".csv",) if recipe == "sweep" else (".toml",))
    if output is not None and output.exists():
        raise InvalidRequest(
            f"{output} exists and may be your own work: give `output` another name, or delete the file"
        )
    from tpmscad.recipe.key_reference import read_template  # loads NumPy

    text = read_template(recipe)
    if output is None:
        print(text, end="")
        return
    with atomic_write(output) as aside:
        aside.write_text(text, encoding="utf-8", newline="\n")
    tell("", writing)


def recipe_keys(kind: KindArgument = None) -> None:
    """List every kind of field that a recipe may hold, with its keys: type, unit, meaning and default."""
    from tpmscad.recipe.key_reference import format_reference  # loads NumPy

    width = min(max(shutil.get_terminal_size().columns, MIN_WIDTH), MAX_WIDTH)
    print(format_reference(kind, width=width))
