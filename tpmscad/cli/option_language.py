"""Messages in the words of the command line: keywords of the Python functions become the options of the command that runs.

Messages are written for Python: `thickness`, thickness= or boundary='box' names a keyword (backquotes or an equals sign mark it;
a name with an underscore needs no mark). For a command these read --thickness and --boundary box. `tpmscad.solidify` reads
`tpmscad solidify`.
"""

from __future__ import annotations

import functools
import inspect
import re
from collections.abc import Callable, Mapping
from typing import Any, get_args, get_type_hints

from tpmscad.errors import RecipeError, TpmscadError

_KEYWORD = re.compile(
    r"""`(?P<quoted>[a-z_]+)(?:=(?P<quoted_value>[^`]+))?`
    |(?<![\w.=-])(?P<assigned>[a-z_]+)=(?P<value>'[^']*'|"[^"]*"|True|False|None|[-\d.]*\d|\([-\d., ]*\)|)
    |(?<![\w./-])(?P<plain>[a-z]+(?:_[a-z]+)+)(?![\w(./])""",
    re.VERBOSE,
)
COMMAND_OF_FUNCTION: Mapping[str, str] = {
    **{name: name for name in ("lattice", "infill", "solidify", "blend", "sweep")},
    "fluid_domains": "domains",
    "check_step": "check",
    "check_print": "check --print",
    "render_step": "render",
    "slice_step": "slice",
    "mesh_step": "mesh",
    "homogenize": "homogenize",
    "export_slabs": "lattice --slab",
    "export_instances": "lattice --instanced",
    "export_infill": "infill --instanced",
    "permeability": "permeability",
}
"""Commands by the public functions that they call."""

_FUNCTION = re.compile(rf"\btpmscad\.({'|'.join(COMMAND_OF_FUNCTION)})\b")
_LABELS = "fields.labels"
"""A function that an option stands for: --label."""

RENAMED_VALUES: Mapping[tuple[str, str], str] = {
    ("loose", "keep"): "--keep-loose",
    ("instanced", "True"): "--instanced",
    ("solids", "False"): "--no-solids",
    ("centred", "True"): "--cell-data",
    ("centred", "False"): "--point-data",
}
"""Options that stand for one value of a keyword."""

RENAMED_KEYWORDS: Mapping[str, str] = {
    "loose": "--keep-loose",
    "domain": "domain",
    "centred": "--cell-data",
    "label": "--label",
}
"""Keywords whose options have another name."""


def speak_in_options(message: str, options: Mapping[str, str]) -> str:
    """The message with every keyword that has an option replaced by it; `options` holds the options by keyword."""

    def replace(match: re.Match[str]) -> str:
        keyword = match["quoted"] or match["assigned"] or match["plain"]
        option = options.get(keyword)
        value = (match["quoted_value"] or match["value"] or "").strip("'\"")
        if value.startswith("("):
            value = value.strip("()").replace(" ", "")
        if option is None or (match["assigned"] and not match["value"] and match[0] != f"{keyword}="):
            return match[0]
        if (keyword, value) in RENAMED_VALUES:
            return RENAMED_VALUES[keyword, value]
        return option if value in ("", "True") else f"{option} {value}"

    message = _KEYWORD.sub(replace, message).replace(_LABELS, "--label")
    return _FUNCTION.sub(lambda match: f"tpmscad {COMMAND_OF_FUNCTION[match[1]]}", message)


def options_of(command: Callable[..., Any]) -> dict[str, str]:
    """The option (or the name of the argument) that stands for each parameter of a command, as the user writes it."""
    options = dict(RENAMED_KEYWORDS)
    for name, annotation in get_type_hints(command, include_extras=True).items():
        info = next((extra for extra in get_args(annotation)[1:] if hasattr(extra, "param_decls")), None)
        if info is None:
            continue
        declared = (
            info.default,
            *(info.param_decls or ()),
        )  # of an annotation typer takes the first name for the default
        long = [text.split("/")[0] for text in declared if isinstance(text, str) and text.startswith("--")]
        is_option = type(info).__name__ == "OptionInfo"
        written = (long or [f"--{name.replace('_', '-')}"])[0] if is_option else (info.metavar or name.upper())
        options.setdefault(name, written)
    return options


def in_option_language(command: Callable[..., None]) -> Callable[..., None]:
    """The command, with its errors in the words of its options; errors of a recipe already speak of its keys."""

    @functools.wraps(command)
    def run(*arguments: Any, **options: Any) -> None:
        try:
            command(*arguments, **options)
        except RecipeError:
            raise
        except TpmscadError as error:
            error.args = (speak_in_options(str(error), options_of(command)),)
            raise

    run.__signature__ = inspect.signature(command, eval_str=True)  # type: ignore[attr-defined]
    return run
