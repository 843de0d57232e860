"""One policy for methods that may fail: try them in order, and say what was tried.

A trimming on exact parameters is fast but may meet a configuration that it cannot resolve with certainty; then a slower and more
robust method follows. A ladder of methods is a sequence of `Fallback`; `first_success` runs them in order and keeps the reasons
of the failures, for the notes of the certificate or for the message of the last error.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

from tpmscad.errors import InvalidRequest, KernelError, MissingDomain, TrimmingError

T = TypeVar("T")

RETRYABLE = (InvalidRequest, TrimmingError, KernelError)
"""Errors of a method after which another one is tried.

InvalidRequest is among them because the exact trimming refuses bodies with free-form faces and patches that are already trimmed,
which the kernel accepts.
"""

FINAL = (MissingDomain,)
"""Errors that no other method can avoid."""


@dataclass(frozen=True, slots=True)
class Fallback(Generic[T]):
    """A method by its name, and the function that carries it out."""

    name: str
    run: Callable[[], T]


@dataclass(frozen=True, slots=True)
class Outcome(Generic[T]):
    """The value of the first method that succeeded, its name, and the errors of those before it."""

    value: T
    name: str
    failures: tuple[Exception, ...]

    @property
    def reasons(self) -> str:
        """The messages of the failures, or "" if the first method succeeded."""
        return "; ".join(map(str, self.failures))


def first_success(attempts: Sequence[Fallback[T]], retry_on: tuple[type[Exception], ...] = RETRYABLE) -> Outcome[T]:
    """The outcome of the first attempt that succeeds.

    An error that is not one of `retry_on` is raised at once. If all attempts fail, the last error is raised; its message is
    completed by what was tried before.
    """
    failures: list[Exception] = []
    for number, attempt in enumerate(attempts, 1):
        try:
            return Outcome(attempt.run(), attempt.name, tuple(failures))
        except FINAL:
            raise
        except retry_on as error:
            if number == len(attempts):
                raise _with_history(error, attempts, failures) from (failures[-1] if failures else None)
            failures.append(error)
    raise ValueError("there is nothing to try")


def _with_history(error: Exception, attempts: Sequence[Fallback[T]], failures: list[Exception]) -> Exception:
    """The error with a message that ends in the methods tried before and their reasons."""
    if failures:
        history = "; ".join(f"{attempt.name}: {reason}" for attempt, reason in zip(attempts, failures, strict=False))
        error.args = (f"{error} ({attempts[-1].name}; tried before: {history})", *error.args[1:])
    return error
