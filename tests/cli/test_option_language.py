"""Errors in the words of the command line: no keyword of Python with an equals sign, no call, reaches a user of a command."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from tpmscad import cli
from tpmscad.cli.option_language import options_of, speak_in_options

PACKAGE = Path(__file__).resolve().parents[2] / "tpmscad"
OPTIONS = {
    "thickness": "--thickness",
    "volume_fraction": "--volume-fraction",
    "offset": "--offset",
    "boundary": "--boundary",
    "phase": "--phase",
    "instanced": "--instanced",
    "loose": "--keep-loose",
    "open_faces": "--open-faces",
    "cell": "--cell",
}
ERRORS = {"InvalidRequest", "LevelSetError", "KernelError", "TrimmingError", "MissingDomain", "NotMet"}
FLOORS = (
    "fields/kinds/sampled_data.py",
    "fields/kinds/scattered_data.py",
    "fields/kinds/segmentation_labels.py",
    "fields/data/image_files.py",
    "fields/data/image_frames.py",
    "fields/kinds/expressions.py",
    "requests",
    "results",
    "solids",
    "files",
    "studies",
    "kernel",
    "surfaces",
    "lattices",
    "levelset",
    "trimming",
    "catalogue.py",
)


@pytest.mark.parametrize(
    ("message", "expected"),
    [
        ("give exactly one of `thickness`, `offset`", "give exactly one of --thickness, --offset"),
        ("use boundary='box'", "use --boundary box"),
        ('use boundary="natural" instead', "use --boundary natural instead"),
        ("a lattice needs cell=, the edge", "a lattice needs --cell, the edge"),
        ("volume_fraction 1.5 must lie below 1", "--volume-fraction 1.5 must lie below 1"),
        ("open_faces: 3 is not planar", "--open-faces: 3 is not planar"),
        ("make it with loose='keep'", "make it with --keep-loose"),
        ("`loose=keep`", "--keep-loose"),
        (
            'below 1 % of the largest piece; loose="keep" keeps it',
            "below 1 % of the largest piece; --keep-loose keeps it",
        ),
        ("set instanced=True", "set --instanced"),
        ("thickness 9 exceeds 3.2", "thickness 9 exceeds 3.2"),
        ("a wall of thickness=0.5", "a wall of --thickness 0.5"),
        ("make a solid with tpmscad.solidify", "make a solid with tpmscad solidify"),
        ("see tpmscad.fluid_domains and tpmscad.maps", "see tpmscad domains and tpmscad.maps"),
        ("no file my_part.step or ./open_faces/x", "no file my_part.step or ./open_faces/x"),
        ("at u=0.5 and `depth`", "at u=0.5 and `depth`"),
    ],
)
def test_a_keyword_becomes_its_option(message: str, expected: str) -> None:
    assert speak_in_options(message, OPTIONS) == expected


def test_the_options_of_a_command_are_those_that_its_help_names() -> None:
    for command in (entry.load() for entry in cli.COMMANDS):
        for keyword, option in options_of(command).items():
            if keyword not in ("loose", "domain"):
                assert option.startswith("--") or option.isupper() or "." in option or "|" in option, option
    options = options_of(cli.infill_command.infill)
    assert (options["open_faces"], options["body"], options["output"]) == ("--open-faces", "BODY.step", "--output")


def messages() -> Iterator[tuple[str, str]]:
    """Every text of an error raised on a floor that commands call, with its place; {} for what is filled in."""
    for floor in FLOORS:
        path = PACKAGE / floor
        for file in [path] if path.is_file() else sorted(path.rglob("*.py")):
            for node in ast.walk(ast.parse(file.read_text())):
                name = getattr(getattr(node, "func", None), "id", "")
                for argument in node.args if isinstance(node, ast.Call) and name in ERRORS else ():
                    text = "".join(
                        part.value if isinstance(part, ast.Constant) else "{}"
                        for part in (argument.values if isinstance(argument, ast.JoinedStr) else [argument])
                        if not isinstance(part, ast.Constant) or isinstance(part.value, str)
                    )
                    yield f"{file.relative_to(PACKAGE)}:{node.lineno}", text


@pytest.mark.slow
def test_no_message_leaves_python_to_the_command_line() -> None:
    options: dict[str, str] = {}
    for command in (entry.load() for entry in cli.COMMANDS):
        options |= options_of(command)
    found = dict(messages())
    assert len(found) > 80
    spoken = {place: speak_in_options(text, options) for place, text in found.items()}
    python = re.compile(
        r"\b(?:fields|maps|tpmscad)\.\w+\(|\b(?:fields|numpy)\.[a-z]|(?<![\w-])[a-z_]{2,}=(?!=)|\bkeyword"
    )
    assert {place: text for place, text in spoken.items() if python.search(text)} == {}
