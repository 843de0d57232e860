"""What was probably meant by an option, a command or a file that there is not: the words of other programs for ours."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tpmscad.api.public_calls import SYNONYMS
from tpmscad.catalogue import find_surface
from tpmscad.cli.options import remedy_for_number
from tpmscad.errors import InvalidRequest
from tpmscad.file_suffixes import MODEL_SUFFIXES, list_suffixes

OPTION_SYNONYMS: Mapping[str, tuple[str, ...]] = {
    **{f"--{word.replace('_', '-')}": (f"--{keyword.replace('_', '-')}",) for word, keyword in SYNONYMS.items()},
    "--density": ("--volume-fraction", "--porosity"),
    **dict.fromkeys(("--infill", "--infill-density", "--fill", "--fill-density"), ("--volume-fraction",)),
    "--solid-fraction": ("--volume-fraction",),
    "--thickness": ("--volume-fraction",),  # of commands without a length
    "--void-fraction": ("--porosity",),
    "--pore": ("--pore-size",),
    "--pore-diameter": ("--pore-size",),
    "--type": ("--kind",),
    "--mode": ("--kind",),
    "--iso": ("--level", "--offset"),
    "--isovalue": ("--level", "--offset"),
    "--threshold": ("--level", "--offset"),
    "--voxel-size": ("--spacing",),
    "--resolution": ("--tol", "--size"),
    "--shift": ("--phase",),
    "--origin": ("--phase",),
    "--rotate": ("--rotation",),
    "--open": ("--open-faces",),
    "--layer": ("--height",),
    "--layer-height": ("--height",),
    "--layer-thickness": ("--height",),
    "--element-size": ("--size",),
    "--mesh-size": ("--size",),
    "--edge-length": ("--size",),
    "--youngs": ("--youngs-modulus",),
    "--e-modulus": ("--youngs-modulus",),
    "--poisson": ("--poisson-ratio",),
    "--threads": ("--jobs",),
    "--workers": ("--jobs",),
    "--processes": ("--jobs",),
    "--out": ("--output",),
    "--outfile": ("--output",),
    "--wrap": ("--map",),
}
"""Options by the words of other programs; where a command has several of them, all are named."""

OPTION_REMEDIES: Mapping[str, str] = {
    "--surface": "the name of the surface stands without an option, as in `tpmscad lattice gyroid`",
    "--format": f"the end of the file's name says the format: -o part{list_suffixes(MODEL_SUFFIXES)}",
    "--unit": "lengths are in mm",
    "--units": "lengths are in mm",
    "--graded": "gradings are recipes: `tpmscad template solidify` prints one",
    "--gradient": "gradings are recipes: `tpmscad template solidify` prints one",
}
"""What answers an option that has no counterpart."""

COMMAND_REMEDIES: Mapping[str, str] = {
    "version": "`tpmscad --version` shows it",
    "help": "`tpmscad --help` shows the commands, `tpmscad lattice --help` the options of one",
    "list": "`tpmscad surfaces` lists the catalogue",
    "catalog": "`tpmscad surfaces` lists the catalogue",
    "catalogue": "`tpmscad surfaces` lists the catalogue",
    "convert": "the commands that make solids write every format by the end of the file's name: -o part.stl",
    "export": "the commands that make solids write every format by the end of the file's name: -o part.stl",
    "fill": "did you mean `tpmscad infill`?",
    "grade": "gradings are recipes of `tpmscad solidify`; `tpmscad template solidify` prints one",
    "field": "did you mean `tpmscad solidify`?",
    "view": "did you mean `tpmscad render`?",
    "show": "did you mean `tpmscad render`?",
    "plot": "did you mean `tpmscad render`?",
    "draw": "did you mean `tpmscad render`?",
    "info": "did you mean `tpmscad check`?",
    "measure": "did you mean `tpmscad check --metrics`?",
    "metrics": "did you mean `tpmscad check --metrics`?",
    "validate": "did you mean `tpmscad check`?",
    "print": "did you mean `tpmscad slice` or `tpmscad check --print`?",
    "exchanger": "did you mean `tpmscad domains`?",
    "channels": "did you mean `tpmscad domains`?",
    "simulate": "did you mean `tpmscad mesh`, `tpmscad homogenize` or `tpmscad permeability`?",
    "homogenise": "did you mean `tpmscad homogenize`?",
    "flow": "did you mean `tpmscad permeability`?",
    "recipe": "`tpmscad template solidify` prints one to start from, `tpmscad recipe-keys` lists what they may hold",
    "init": "`tpmscad template solidify` prints a recipe to start from",
}
"""What answers the word of another program for a command."""

BAD_NUMBERS: Mapping[str, str] = {
    "float_parsing": "a number",
    "int_parsing": "a whole number",
    "int_from_float": "a whole number",
}
"""What a value should have been, by the kind of error with which it was refused."""

_UNKNOWN_COMMAND = re.compile(r"No such command '([^']*)'")
_MISSING_FILE = re.compile(r"Invalid value for 'BODY\.step': file '(?P<name>.*)' does not exist")


def hint_at_meaning(error: Any, words: Sequence[str] = ()) -> str:
    """What was probably meant by a request that a command line, its `words`, cannot be parsed as; "" if nothing is known."""
    context, message = getattr(error, "ctx", None), str(error.format_message())
    command = context.command if context is not None else None
    if (option := getattr(error, "option_name", None)) and command is not None:
        return _hint_at_option(option, [name for parameter in command.params for name in parameter.opts], words)
    if message.startswith("Missing") and command is not None:
        lines = (line.strip() for line in (command.epilog or "").splitlines())
        example = next((line for line in lines if line.startswith(f"tpmscad {command.name} ")), "")
        if "--output" in message and (name := _propose_output(context, example)):
            return f"name the file to write, as in -o {name}"
        return f"as in `{example}`" if example else ""
    if match := _UNKNOWN_COMMAND.search(message):
        known = f"the commands are {', '.join(getattr(command, 'commands', ()))}"
        return _hint_at_command(match[1]) or ("" if "Did you mean" in message else known)
    if (match := _MISSING_FILE.search(message)) and command is not None and _is_surface(match["name"]):
        return f"the file comes first, as in `tpmscad {command.name} body.step {match['name']}`"
    return ""


def describe_bad_number(error: Any) -> str:
    """The value of an option that is not a number, and what to write; "" for other errors."""
    cause = error.__cause__ or error.__context__
    if cause is None or not hasattr(cause, "errors"):
        return ""
    refused = cause.errors()[0]
    expected = BAD_NUMBERS.get(refused["type"])
    return f"{refused['input']!r} is not {expected}{remedy_for_number(refused['input'])}" if expected else ""


def _propose_output(context: Any, example: str) -> str:
    """A name of the file to write: the operands that were given, with the ending of the example's file; "" without operands."""
    operands = [p.name for p in context.command.params if p.param_type_name == "argument"]
    stems = [Path(str(value)).stem for name in operands if (value := context.params.get(name)) is not None]
    return "_".join(stems) + Path(example).suffix if stems else ""


def _hint_at_option(option: str, known: Sequence[str], words: Sequence[str]) -> str:
    """The options of a command that stand for the word of another program; for a density of slicers with its value."""
    found = [name for name in OPTION_SYNONYMS.get(option, ()) if name in known]
    if found == ["--volume-fraction"] and option != "--thickness" and (share := _read_share(option, words)):
        return f"did you mean --volume-fraction {share}?"
    return f"did you mean {' or '.join(found)}?" if found else OPTION_REMEDIES.get(option, "")


def _read_share(option: str, words: Sequence[str]) -> str:
    """The value of an option, a percentage as slicers write it, as a share of one; "" if it is something else."""
    line = " ".join(words).replace("=", " ")
    match = re.search(rf"(?<!\S){re.escape(option)} (?P<number>\d*\.?\d+)(?P<percent>\s?%)?(?!\S)", line)
    if match is None:
        return ""
    value = float(match["number"])
    value = value / 100.0 if match["percent"] or value > 1.0 else value
    return f"{value:g}" if 0.0 < value < 1.0 else ""


def _hint_at_command(word: str) -> str:
    """The command that stands for the word of another program, or for a surface; "" if there is none."""
    if word in COMMAND_REMEDIES:
        return COMMAND_REMEDIES[word]
    return f"did you mean `tpmscad lattice {word}`?" if _is_surface(word) else ""


def _is_surface(name: str) -> bool:
    """Whether the catalogue knows a surface of this name."""
    try:
        find_surface(name)
    except InvalidRequest:
        return False
    return True
