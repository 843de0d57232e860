"""Answers to calls that do not fit a function: the keyword that was meant, and the call as it is written.

Python's own answer to `lattice("gyroid", 10, 1)` counts positional arguments; a person wants to see `cell=10`.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from difflib import get_close_matches
from inspect import Parameter, signature
from typing import Any, ParamSpec, TypeVar

from tpmscad.errors import MisusedCall

SYNONYMS = {
    "period": "cell",
    "unit_cell": "cell",
    "cell_size": "cell",
    "n_cells": "cells",
    "repeat": "cells",
    "repetitions": "cells",
    "wall": "thickness",
    "wall_thickness": "thickness",
    "density": "volume_fraction",
    "relative_density": "volume_fraction",
    "tolerance": "tol",
    "accuracy": "tol",
    "shell": "skin",
    "shell_thickness": "skin",
    "bounds": "domain",
    "box": "domain",
}
"""Words of other programs, and of other functions of this one, for our keywords."""

P = ParamSpec("P")
R = TypeVar("R")


def answer_misuse(example: str) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Decorator whose function answers a call that does not fit with MisusedCall, naming the keyword and showing `example`."""

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        expected = signature(function)

        @functools.wraps(function)
        def call_or_explain(*args: P.args, **kwargs: P.kwargs) -> R:
            try:
                expected.bind(*args, **kwargs)
            except TypeError as error:
                raise MisusedCall(_explain(function, args, kwargs, str(error), example)) from None
            return function(*args, **kwargs)

        return call_or_explain

    return decorate


def _explain(
    function: Callable[..., Any], args: tuple[Any, ...], kwargs: dict[str, Any], reason: str, example: str
) -> str:
    """What does not fit, and how the call is written."""
    parameters = signature(function).parameters.values()
    positional = [p.name for p in parameters if p.kind is Parameter.POSITIONAL_OR_KEYWORD and p.name != "self"]
    keywords = [p.name for p in parameters if p.kind is Parameter.KEYWORD_ONLY]
    name = getattr(function, "__qualname__", "the function").removesuffix(".__init__")
    args = args[1:] if "self" in signature(function).parameters else args
    unknown = [key for key in kwargs if key not in positional and key not in keywords]
    if unknown:
        meant = [SYNONYMS.get(unknown[0].lower(), "")]
        found = [m for m in meant if m in keywords or m in positional] or get_close_matches(
            unknown[0], [*positional, *keywords]
        )
        hint = f"; it is called {found[0]}=" if found else f"; its keywords are {', '.join(keywords)}"
        return f"{name} has no keyword {unknown[0]!r}{hint}, as in {example}"
    if len(args) > len(positional):
        taken = " and ".join(positional)
        return f"{name} takes {taken} by position and everything else by name: {example}"
    return f"{name}: {reason}; it is called as in {example}"
