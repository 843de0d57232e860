"""Pages of the commands, one each, made from what `tpmscad COMMAND --help` is made of, and an index of them."""

from __future__ import annotations

import re
from typing import Any

import typer

from tpmscad import cli

ARGUMENTS, OPTIONS = "Arguments", "Options"


def make_commands() -> dict[str, str]:
    """The index, and a page for each command, by name."""
    program: Any = typer.main.get_command(cli.make_app())
    own = {f"commands/{c.name}.md": describe_command(c, program.commands[c.name]) for c in cli.COMMANDS}
    return {"commands.md": describe_index()} | own


def describe_index() -> str:
    """The commands by what they are for, with a line each."""
    lines = ["# Commands", "", "`tpmscad COMMAND --help` prints what these pages say.", ""]
    for panel in dict.fromkeys(command.panel for command in cli.COMMANDS):
        lines += [f"## {panel}", "", "| | |", "|---|---|"]
        lines += [f"| [{c.name}](commands/{c.name}.md) | {c.short_help} |" for c in cli.COMMANDS if c.panel == panel]
        lines.append("")
    lines += [cli.EXIT_STATUS_HELP, "", "```{toctree}", ":hidden:", ""]
    return "\n".join([*lines, *(f"commands/{command.name}" for command in cli.COMMANDS), "```", ""])


def describe_command(command: cli.Command, parsed: Any) -> str:
    """The page of a command: what it does, examples, and its arguments and options in the groups of its help."""
    arguments = [p for p in parsed.params if not p.opts[0].startswith("-")]
    usage = " ".join(["tpmscad", command.name, "[OPTIONS]", *(format_value(argument) for argument in arguments)])
    examples = [f"tpmscad {line}" for line in command.examples]
    page = [f"# tpmscad {command.name}", "", escape(parsed.help), "", "```text", usage, "```", ""]
    page += ["```sh", *examples, "```", ""]
    groups: dict[str, list[Any]] = {}
    for parameter in parsed.params:
        own = ARGUMENTS if parameter in arguments else OPTIONS
        groups.setdefault(parameter.rich_help_panel or own, []).append(parameter)
    for title in sorted(groups, key=lambda name: name not in (ARGUMENTS, OPTIONS)):
        page += [f"## {escape(title)}", ""]
        for parameter in groups[title]:
            page += describe_parameter(parameter, parameter in arguments)
    return "\n".join(page)


def describe_parameter(parameter: Any, argument: bool) -> list[str]:
    """The entry of a list of definitions."""
    words = "" if getattr(parameter, "is_flag", False) else format_value(parameter)
    names = (
        [words] if argument else [*(f"{name} {words}".strip() for name in (*parameter.opts, *parameter.secondary_opts))]
    )
    shown = parameter.show_default
    default = shown if isinstance(shown, str) else shown and parameter.default
    tail = " *Required.*" if parameter.required else f" *Default:* `{default}`." if default else ""
    return [", ".join(f"`{name}`" for name in names), f": {escape(parameter.help or '')}{tail}", ""]


def format_value(parameter: Any) -> str:
    """What stands for the value of a parameter in the help."""
    if parameter.metavar or not parameter.opts[0].startswith("-"):
        return str(parameter.metavar or parameter.name.upper())
    return str(parameter.display_type(None)).strip("<>")


def escape(text: str) -> str:
    """A text of the help in Markdown: options, and words with marks of Markdown in them, as code."""
    parts = re.split(r"(`[^`]*`)", " ".join(text.split()))
    marked = [
        part if part.startswith("`") else re.sub(r"(?<![\w`])(--[a-z][\w-]*|\S*[*_<{]\S*)", r"`\1`", part)
        for part in parts
    ]
    return "".join(marked)
