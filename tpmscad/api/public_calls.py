"""The door of the package: what a call of a public function passes on its way in, and every error on its way out.

`public` is the decorator of public functions. On the way in, a call that does not fit is answered with the keyword that was meant
and the call as it is written (MisusedCall), and every value is read as `tpmscad.api.argument_table` declares it (InvalidRequest).
On the way out, an exception that is no TpmscadError becomes one, with the original as its cause.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from difflib import get_close_matches
from inspect import Parameter, signature
from typing import Any, ParamSpec, TypeVar

import numpy as np

from tpmscad._typing import Array
from tpmscad.api.argument_kinds import ArgumentKind, Refusal, show_value
from tpmscad.api.argument_table import find_kind
from tpmscad.errors import (
    FileError,
    InvalidRequest,
    MisusedCall,
    NestedTooDeeply,
    OutOfMemory,
    TpmscadError,
    UnexpectedError,
    UserFunctionError,
)

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
T = TypeVar("T")


def public(example: str | None = None) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Decorator of public functions and methods; `example` is a call of it, by default made of the table's examples."""

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        expected = signature(function)
        name = function.__qualname__.removesuffix(".__init__").rpartition(".")[2]
        guarded = translate_errors(function)
        kinds = {key: find_kind(name, key) for key in expected.parameters if key != "self"}
        shown = example or _make_example(name, kinds, expected.parameters)

        @functools.wraps(function)
        def call(*args: P.args, **kwargs: P.kwargs) -> R:
            try:
                bound = expected.bind(*args, **kwargs)
            except TypeError as error:
                raise MisusedCall(_explain(function, args, kwargs, str(error), shown)) from None
            for key, value in bound.arguments.items():
                if key != "self":
                    bound.arguments[key] = _read_argument(expected.parameters[key], kinds[key], value)
            return guarded(*bound.args, **bound.kwargs)

        return call

    return decorate


def _read_argument(parameter: Parameter, kind: ArgumentKind, value: Any) -> Any:
    """The value in its final form, or each one of those that `*args` and `**kwargs` have gathered."""
    if parameter.kind is Parameter.VAR_POSITIONAL:
        return tuple(read_value(f"{parameter.name}[{i}]", kind, item) for i, item in enumerate(value))
    if parameter.kind is Parameter.VAR_KEYWORD:
        return {key: read_value(key, kind, item) for key, item in value.items()}
    return value if value is parameter.default else read_value(parameter.name, kind, value)


def read_value(name: str, kind: ArgumentKind, value: Any) -> Any:
    """The value of an argument in its final form; InvalidRequest names the argument, the value, what it takes and an example."""
    try:
        return kind.read(value)
    except Refusal as refusal:
        reason = str(refusal)
    except RecursionError:
        reason = "is nested too deeply"
    wanted = "" if kind.text in reason else f"; it takes {kind.text}"
    written = f", as in {name}={kind.example}" if kind.example else ""
    raise InvalidRequest(f"{name} {show_value(value)} {reason}{wanted}{written}")


def translate_errors(function: Callable[P, R]) -> Callable[P, R]:
    """The function, from which only errors of the package come: a foreign exception is the cause of a TpmscadError."""

    @functools.wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        try:
            return function(*args, **kwargs)
        except TpmscadError:
            raise
        except Exception as error:
            name = function.__qualname__.removesuffix(".__init__")
            if isinstance(error, TypeError) and error.__traceback__ and error.__traceback__.tb_next is None:
                raise MisusedCall(f"{error}; its arguments are {', '.join(signature(function).parameters)}") from None
            raise translate_error(name, error) from error

    return call


def translate_error(name: str, error: Exception) -> TpmscadError:
    """The TpmscadError that stands for a foreign exception inside the public function `name`."""
    if isinstance(error, RecursionError):
        return NestedTooDeeply(
            f"{name} was given something nested more deeply than Python can follow: join many fields by fields.union(*parts) "
            "or fields.intersection(*parts), which nest them as little as possible"
        )
    if isinstance(error, MemoryError):
        return OutOfMemory(
            f"{name} ran out of memory ({str(error) or 'no more is available'}): use larger cells, a smaller box, or a larger tol"
        )
    if isinstance(error, OSError):
        where = f" {error.filename!r}" if error.filename else ""
        return FileError(
            f"{name} cannot use the file{where}: {error.strerror or error}; check the path and its permissions"
        )
    return UnexpectedError(
        f"{name} failed for a reason that it does not know: {type(error).__name__}: {error}. Please report the call: it should "
        "have worked, or have been refused with the reason"
    )


def _make_example(name: str, kinds: Mapping[str, ArgumentKind], parameters: Mapping[str, Parameter]) -> str:
    """The call of a function with the examples of its required arguments."""
    required = [p for p in parameters.values() if p.default is Parameter.empty and p.name in kinds]
    written = (
        kinds[p.name].example if p.kind is Parameter.VAR_POSITIONAL else f"{p.name}={kinds[p.name].example}"
        for p in required
        if p.kind is not Parameter.VAR_KEYWORD
    )
    return f"{name}({', '.join(written)})"


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
        hint = f"; it is called {found[0]}=" if found else f"; its keywords are {', '.join([*positional, *keywords])}"
        return f"{name} has no keyword {unknown[0]!r}{hint}, as in {example}"
    if len(args) > len(positional):
        taken = " and ".join(positional)
        return f"{name} takes {taken} by position and everything else by name: {example}"
    return f"{name}: {reason}; it is called as in {example}"


def public_constructor(kind: type[T]) -> type[T]:
    """Decorator of classes that users construct: their arguments pass the same door."""
    kind.__init__ = public()(kind.__init__)  # type: ignore[method-assign]
    return kind


def call_for_array(what: str, function: Callable[..., Any], *args: Any) -> Array:
    """The numbers that a function given to the package returns; UserFunctionError if it raises or returns something else."""
    result = call_user_function(what, function, *args)
    try:
        return np.asarray(result, float)
    except (TypeError, ValueError, OverflowError) as error:
        raise UserFunctionError(
            f"{what} returned {show_value(result)}, which is no array of numbers: {error}"
        ) from error


def call_user_function(what: str, function: Callable[..., R], *args: Any) -> R:
    """The result of a function that was given to the package; UserFunctionError if it raises. `what` names it."""
    try:
        return function(*args)
    except UnexpectedError as error:
        raise UserFunctionError(f"{what} raised {error}") from error
    except TpmscadError:
        raise
    except Exception as error:
        reason = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
        raise UserFunctionError(f"{what} raised {reason}") from error
