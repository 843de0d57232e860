"""tpmscad surfaces, template and recipe-keys: the catalogue, a recipe to start from, and all that recipes may hold."""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import typer

from tpmscad.atomic_file import atomic_write
from tpmscad.catalogue import CATALOGUE, CORES
from tpmscad.cli.options import QuietOption, output_option
from tpmscad.cli.output import OutputRequest, tell
from tpmscad.errors import InvalidRequest
from tpmscad.strut_cells import KINDS, LARGEST_DIAMETERS

MIN_WIDTH, MAX_WIDTH = 60, 100
"""Columns of printed text: those of the terminal, within these limits."""

JsonOption = Annotated[bool, typer.Option("--json", help="Print the whole catalogue as JSON.")]
NamesOption = Annotated[
    bool,
    typer.Option("--names", help="Print what bodies are filled with as JSON: surfaces, cores, struts, their titles."),
]
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


def surfaces(as_json: JsonOption = False, names: NamesOption = False) -> None:
    """List the surfaces: names, references, genus, space group, the thickest wall, and where their solids are one piece.

    Then the cells of struts, with the largest diameter of each.
    """
    if names:
        titles = {
            "surfaces": {info.name: info.title for info in CATALOGUE.values()},
            "cores": {name: f"{name.capitalize()} core" for name in CORES},
            "struts": {name: f"{name.capitalize()} struts" for name in KINDS},
        }
        print(json.dumps(titles, indent=2))
        return
    from tpmscad.studies.surface_limits import describe_pieces, thickest_wall  # loads NumPy

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
            "one_piece": {reference: describe_pieces(info.name, reference) for reference in info.references},
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
    _print_table(table)
    print(f"\n{CATALOGUE_NOTE}\n")
    pieces: list[tuple[str, ...]] = [("one piece", "reference", "side -", "side +", "|f| <=")]
    for info in CATALOGUE.values():
        for reference in info.references:
            found = describe_pieces(info.name, reference)
            sides = (_list_fractions(found[side]) for side in "-+")
            pieces.append((info.name, reference, *sides, f"{found['sheet_to_level']:.4g}"))
    _print_table(pieces)
    print(f"\n{PIECES_NOTE}\n")
    _print_table([("struts", "largest diameter"), *((k, f"{d:.4f} cell") for k, d in LARGEST_DIAMETERS.items())])
    print(f"\n{STRUTS_NOTE}")


def _print_table(table: Sequence[tuple[str, ...]]) -> None:
    """Print rows in columns."""
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    for line in table:
        print("  ".join(entry.ljust(width) for entry, width in zip(line, widths, strict=True)).rstrip())


def _list_fractions(ranges: Sequence[dict[str, list[float]]]) -> str:
    """The volume fractions at which one side of a surface is one piece."""
    ends = (each["volume_fractions"] for each in ranges)
    return ", ".join(f"{low:.3f}-{high:.3g}" for low, high in ends)


MAX_ALIAS = 5
"""Letters of an alias that the table shows."""

CATALOGUE_NOTE = """Thickest wall: --thickness stays below it, times the edge of the cell, or the
wall would fold. --json prints the formulas, too."""


PIECES_NOTE = """One piece in all of space: volume fractions of a side, {f <= c} or {f >= c}, and
the greatest c at which both channels beside the sheet |f| <= c are one piece
each. Lattices of constant wall, --thickness, --offset or --volume-fraction, and
their channels are one piece at every offset that their curvature permits."""

STRUTS_NOTE = """Largest diameter: struts of tpmscad struts stay below it, times the edge of a
cubic cell. Up to it struts and void are one piece each, however thin."""


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
