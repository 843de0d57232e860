"""The interface of public functions: what a call of a public function passes on its way in, and every error on its way out.

`public` is the decorator of public functions. On the way in, a call that does not fit is answered with the keyword that was meant
and the call as it is written (MisusedCall), and every value is read as `tpmscad.api.argument_table` declares it (InvalidRequest).
On the way out, an exception that is no TpmscadError becomes one, with the original as its cause. The traceback of an
InvalidRequest is the caller's line and one frame of this module, hidden by tools that honour `__tracebackhide__` (pytest).
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from difflib import get_close_matches
from inspect import Parameter, Signature, signature
from typing import TYPE_CHECKING, Any, Concatenate, ParamSpec, TypeVar

from tpmscad.api.argument_kinds import ArgumentKind, InvalidValue, show_value
from tpmscad.api.arguments import Argument, arguments_of, document_arguments
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

if TYPE_CHECKING:
    from tpmscad._typing import Array

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
}
"""Words of other programs, and of other functions of this one, for our keywords."""

P = ParamSpec("P")
Q = ParamSpec("Q")
R = TypeVar("R")
S = TypeVar("S")
T = TypeVar("T")


def validate_call(example: str | None = None) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Decorator of public functions and methods; `example` is a call of it, by default made of the examples of its arguments."""

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        return _validate(function, signature(function), arguments_of(function), example, translate_errors(function))

    return decorate


def validate_options(options: Callable[P, S], example: str) -> Callable[[Callable[[S], R]], Callable[P, R]]:
    """Decorator of public functions whose arguments are the fields of a dataclass: it takes them one by one."""

    def decorate(function: Callable[[S], R]) -> Callable[P, R]:
        guarded = translate_errors(function)

        def take_one_by_one(*args: P.args, **kwargs: P.kwargs) -> R:
            __tracebackhide__ = True
            return guarded(options(*args, **kwargs))

        shown = signature(options).replace(return_annotation=signature(function).return_annotation)
        return _validate(function, shown, arguments_of(options), example, take_one_by_one)

    return decorate


def validate_method_options(
    options: Callable[P, S], example: str
) -> Callable[[Callable[[T, S], R]], Callable[Concatenate[T, P], R]]:
    """The same for methods: the dataclass follows `self`."""

    def decorate(function: Callable[[T, S], R]) -> Callable[Concatenate[T, P], R]:
        guarded = translate_errors(function)

        def take_one_by_one(self: T, /, *args: P.args, **kwargs: P.kwargs) -> R:
            __tracebackhide__ = True
            return guarded(self, options(*args, **kwargs))

        first = next(iter(signature(function).parameters.values()))
        fields = signature(options).parameters.values()
        shown = signature(function).replace(parameters=[first, *fields])
        return _validate(function, shown, arguments_of(options), example, take_one_by_one)

    return decorate


def _validate(
    function: Callable[..., Any],
    shown: Signature,
    arguments: Mapping[str, Argument],
    example: str | None,
    target: Callable[Q, R],
) -> Callable[Q, R]:
    """The function `target` behind the validation of its arguments; it looks like `function` with the signature `shown`."""
    name = function.__qualname__.removesuffix(".__init__")
    written = example or _make_example(name.rpartition(".")[2], arguments)

    @functools.wraps(function)
    def call(*args: Q.args, **kwargs: Q.kwargs) -> R:
        __tracebackhide__ = True
        try:
            bound = shown.bind(*args, **kwargs)
        except TypeError as error:
            raise MisusedCall(_explain(name, shown, args, kwargs, str(error), written)) from None
        try:
            for key, value in bound.arguments.items():
                if key in arguments:
                    bound.arguments[key] = _read_argument(arguments[key], value)
            return target(*bound.args, **bound.kwargs)
        except InvalidRequest as error:
            # Its message says what to change; frames inside the package say nothing to the caller.
            raise error.with_traceback(None) from find_foreign_cause(error)

    plain = [
        p.replace(annotation=arguments[p.name].type) if p.name in arguments else p for p in shown.parameters.values()
    ]
    call.__signature__ = shown.replace(parameters=plain)  # type: ignore[attr-defined]
    call.__arguments__ = arguments  # type: ignore[attr-defined]
    call.__doc__ = document_arguments(function.__doc__, arguments)
    return call


def _read_argument(argument: Argument, value: Any) -> Any:
    """The value in its final form, or each one of those that `*args` and `**kwargs` have gathered."""
    if argument.passed is Parameter.VAR_POSITIONAL:
        return tuple(read_value(f"{argument.name}[{i}]", argument.kind, item) for i, item in enumerate(value))
    if argument.passed is Parameter.VAR_KEYWORD:
        return {key: read_value(key, argument.kind, item) for key, item in value.items()}
    return value if value is argument.default else read_value(argument.name, argument.kind, value)


def read_value(name: str, kind: ArgumentKind, value: Any) -> Any:
    """The value of an argument in its final form; InvalidRequest names the argument, the value, what it takes and an example."""
    try:
        return kind.read(value)
    except InvalidValue as error:
        reason = str(error)
    except RecursionError:
        reason = "is nested too deeply"
    wanted = "" if kind.text in reason else f"; it takes {kind.text}"
    written = f", as in {name}={kind.example}" if kind.example else ""
    raise InvalidRequest(f"{name} {show_value(value)} {reason}{wanted}{written}")


def translate_errors(function: Callable[P, R]) -> Callable[P, R]:
    """The function, from which only errors of the package come: a foreign exception is the cause of a TpmscadError."""

    @functools.wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        __tracebackhide__ = True
        try:
            return function(*args, **kwargs)
        except InvalidRequest as error:
            raise error.with_traceback(None) from find_foreign_cause(error)
        except TpmscadError as error:
            error.__cause__ = find_foreign_cause(error)
            raise
        except Exception as error:
            name = function.__qualname__.removesuffix(".__init__")
            if isinstance(error, TypeError) and error.__traceback__ and error.__traceback__.tb_next is None:
                raise MisusedCall(f"{error}; its arguments are {', '.join(signature(function).parameters)}") from None
            raise translate_error(name, error) from error

    return call


def find_foreign_cause(error: BaseException) -> BaseException | None:
    """The first cause of an error that is none of the package; what the package's own say is in the message."""
    cause = error.__cause__
    return find_foreign_cause(cause) if isinstance(cause, TpmscadError) else cause


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
        f"{name} failed by a fault of its own ({type(error).__name__}: {error}): please report the call, which should have "
        "worked, or have been refused with the reason"
    )


def _make_example(name: str, arguments: Mapping[str, Argument]) -> str:
    """The call of a function with the examples of its required arguments."""
    gathered = {Parameter.VAR_POSITIONAL: True, Parameter.VAR_KEYWORD: False}
    written = (
        argument.kind.example if argument.passed in gathered else f"{argument.name}={argument.kind.example}"
        for argument in arguments.values()
        if gathered.get(argument.passed, argument.is_required)
    )
    return f"{name}({', '.join(written)})"


def _explain(
    name: str, shown: Signature, args: tuple[Any, ...], kwargs: dict[str, Any], reason: str, example: str
) -> str:
    """What does not fit, and how the call is written."""
    parameters = shown.parameters.values()
    positional = [p.name for p in parameters if p.kind is Parameter.POSITIONAL_OR_KEYWORD and p.name != "self"]
    keywords = [p.name for p in parameters if p.kind is Parameter.KEYWORD_ONLY]
    args = args[1:] if "self" in shown.parameters else args
    unknown = [key for key in kwargs if key not in positional and key not in keywords]
    if unknown:
        meant = [SYNONYMS.get(unknown[0].lower(), "")]
        near = [m for m in meant if m in keywords or m in positional] or get_close_matches(
            unknown[0], [*positional, *keywords]
        )
        hint = f"; it is called {near[0]}=" if near else f"; its keywords are {', '.join([*positional, *keywords])}"
        return f"{name} has no keyword {unknown[0]!r}{hint}, as in {example}"
    if len(args) > len(positional):
        taken = " and ".join(positional)
        return f"{name} takes {taken} by position and everything else by name: {example}"
    return f"{name}: {reason}; it is called as in {example}"


def validate_constructor(kind: type[T]) -> type[T]:
    """Decorator of dataclasses that users construct: their fields are validated in the same way."""
    constructor: Any = kind.__init__
    shown, arguments = signature(constructor), arguments_of(kind)
    kind.__init__ = _validate(constructor, shown, arguments, None, translate_errors(constructor))  # type: ignore[method-assign]
    kind.__doc__ = document_arguments(kind.__doc__, arguments)
    return kind


def show_constructor(kind: type[T]) -> type[T]:
    """Decorator of classes: signature and docstring are those of the constructor, which a metaclass would hide."""
    constructor: Any = kind.__init__
    shown = signature(constructor)
    shown = shown.replace(parameters=list(shown.parameters.values())[1:], return_annotation=kind)
    kind.__signature__ = shown  # type: ignore[attr-defined]
    kind.__doc__ = document_arguments(kind.__doc__, constructor.__arguments__)
    return kind


def call_for_array(what: str, function: Callable[..., Any], *args: Any) -> Array:
    """The numbers that a function given to the package returns; UserFunctionError if it raises or returns something else."""
    import numpy as np  # the help of the command line goes without it

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
