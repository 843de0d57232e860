"""What was probably meant by an option, a command or a file that there is not: the words of other programs for ours."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

from tpmscad.api.public_calls import SYNONYMS
from tpmscad.catalogue import find_surface
from tpmscad.cli.options import remedy_for_number
from tpmscad.errors import InvalidRequest

OPTION_SYNONYMS: Mapping[str, tuple[str, ...]] = {
    **{f"--{word.replace('_', '-')}": (f"--{keyword.replace('_', '-')}",) for word, keyword in SYNONYMS.items()},
    "--density": ("--volume-fraction", "--porosity"),
    "--infill": ("--volume-fraction", "--porosity"),
    "--fill": ("--volume-fraction", "--porosity"),
    "--fill-density": ("--volume-fraction", "--porosity"),
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
    "--format": "the end of the file's name says the format: -o part.step, .stl, .3mf, .brep or .glb",
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


def hint_at_meaning(error: Any) -> str:
    """What was probably meant by a request that a command line cannot be parsed as; "" if nothing is known."""
    context, message = getattr(error, "ctx", None), str(error.format_message())
    command = context.command if context is not None else None
    if (option := getattr(error, "option_name", None)) and command is not None:
        return _hint_at_option(option, [name for parameter in command.params for name in parameter.opts])
    if message.startswith("Missing") and command is not None:
        lines = (line.strip() for line in (command.epilog or "").splitlines())
        example = next((line for line in lines if line.startswith(f"tpmscad {command.name} ")), None)
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


def _hint_at_option(option: str, known: Sequence[str]) -> str:
    """The options of a command that stand for the word of another program."""
    found = [name for name in OPTION_SYNONYMS.get(option, ()) if name in known]
    return f"did you mean {' or '.join(found)}?" if found else OPTION_REMEDIES.get(option, "")


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
