"""The arguments of a function, each declared once: as the annotation of its parameter.

    def sphere(
        center: Annotated[Sequence[float], POINT, "Centre, model units."],
        radius: Annotated[float, POSITIVE, "Radius, model units."],
    ) -> Field:

An annotation holds the static type, what the argument takes (an `ArgumentKind`), and sentences on its meaning. From it follow the
check of a call, the section Parameters of the docstring, options of the command line, keys of recipes and columns of sweeps.
Arguments that several functions share have an annotation with a name, or are the fields of a dataclass.

Only the second and third part of an annotation are evaluated, so that a static type may name what is imported for type checkers.
"""

from __future__ import annotations

import ast
import sys
import textwrap
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from inspect import Parameter, cleandoc, signature, unwrap
from typing import Any

from tpmscad.api.argument_kinds import ArgumentKind

WIDTH = 120
"""Columns of a docstring."""


@dataclass(frozen=True, slots=True)
class Argument:
    """A parameter of a public function: what it takes and what it means, and its default (Parameter.empty without one).

    `type` is the static type, as it is written.
    """

    name: str
    type: Any
    kind: ArgumentKind
    meaning: str
    default: Any = Parameter.empty
    passed: Any = Parameter.POSITIONAL_OR_KEYWORD

    @property
    def is_required(self) -> bool:
        """Whether a call has to give it."""
        return self.default is Parameter.empty and self.passed not in (Parameter.VAR_POSITIONAL, Parameter.VAR_KEYWORD)

    @property
    def heading(self) -> str:
        """Name, what it takes, and whether it may be left out, as numpydoc writes it."""
        stars = {Parameter.VAR_POSITIONAL: "*", Parameter.VAR_KEYWORD: "**"}.get(self.passed, "")
        plain = isinstance(self.default, bool | int | float | str | tuple) and self.default != ()
        rest = "" if self.is_required or stars else f", default {self.default!r}" if plain else ", optional"
        return f"{stars}{self.name} : {self.kind.text}{rest}"


def arguments_of(function: Callable[..., Any]) -> Mapping[str, Argument]:
    """The arguments of a function, or of the constructor of a dataclass, without `self`; LookupError for one not declared."""
    known: Mapping[str, Argument] | None = vars(function).get("__arguments__")
    if known is not None:
        return known
    scopes = _annotation_scopes(function)
    return {
        name: Argument(name, *_evaluate(function, name, *scopes[name]), parameter.default, parameter.kind)
        for name, parameter in signature(function).parameters.items()
        if name != "self"
    }


def _annotation_scopes(function: Callable[..., Any]) -> dict[str, tuple[Any, dict[str, Any]]]:
    """The annotation of each parameter, and the names that it may use."""
    if not isinstance(function, type):
        plain = unwrap(function)
        return {name: (note, plain.__globals__) for name, note in plain.__annotations__.items()}
    return {
        name: (note, vars(sys.modules[base.__module__]))
        for base in reversed(function.__mro__)
        for name, note in vars(base).get("__annotations__", {}).items()
    }


def _evaluate(
    function: Callable[..., Any], name: str, note: Any, names: dict[str, Any]
) -> tuple[Any, ArgumentKind, str]:
    """The static type, the kind and the meaning of an annotation."""
    parts: tuple[Any, ...] = (getattr(note, "__origin__", None), *getattr(note, "__metadata__", ()))
    if isinstance(note, str):
        tree = ast.parse(note, mode="eval").body
        if isinstance(tree, ast.Name):
            return _evaluate(function, name, names.get(tree.id), names)
        if isinstance(tree, ast.Subscript) and getattr(tree.value, "id", "") == "Annotated":
            static, *rest = tree.slice.elts  # type: ignore[attr-defined]
            entries = ast.fix_missing_locations(ast.Expression(ast.Tuple(rest, ast.Load())))
            parts = (ast.unparse(static), *eval(compile(entries, "<annotation>", "eval"), names))
    if len(parts) != 3 or not isinstance(parts[1], ArgumentKind):
        raise LookupError(f"declare what {name} of {function.__qualname__} takes: Annotated[type, kind, meaning]")
    return parts[0], parts[1], parts[2]


def document_arguments(doc: str | None, arguments: Mapping[str, Argument]) -> str:
    """The docstring with the section Parameters, which follows the summary and its paragraphs."""
    text = cleandoc(doc or "")
    if not arguments:
        return text
    head, rule, rest = text.partition("\n----")
    if rule:  # the title of the first section belongs to the rest
        head, _, title = head.rpartition("\n")
        rest = f"{title}{rule}{rest}"
    entries = [
        f"{argument.heading}\n"
        + textwrap.fill(argument.meaning, WIDTH, initial_indent="    ", subsequent_indent="    ")
        for argument in arguments.values()
    ]
    section = "\n".join(["Parameters", "----------", *entries])
    return "\n\n".join(part for part in (head.rstrip(), section, rest) if part) + "\n"


def select_arguments(given: Any, options: type) -> dict[str, Any]:
    """The values that a dataclass of arguments and the class `options` have in common, by name."""
    shared = {field.name for field in fields(options)}
    return {field.name: getattr(given, field.name) for field in fields(given) if field.name in shared}
