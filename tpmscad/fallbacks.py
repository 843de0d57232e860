"""One policy for methods that may fail: try them in order, and say what was tried.

A trimming on exact parameters is fast but may meet a configuration that it cannot resolve with certainty; then a slower and more
robust method follows. A `Fallbacks` states as data what is tried, after which failures the next method follows, and what each
costs. Its method `run` runs them in order and keeps the reasons of the failures, for the notes of the certificate or for the
message of the last error. What failed, and what follows, is shown in the progress before it starts.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, ParamSpec, TypeVar

from tpmscad.errors import InvalidRequest, KernelError, MissingDomain, TrimmingError
from tpmscad.stage_timer import show_activity

P = ParamSpec("P")
T = TypeVar("T")

RETRYABLE = (InvalidRequest, TrimmingError, KernelError)
"""Errors of a method after which another one is tried.

InvalidRequest is among them because the exact trimming refuses bodies with free-form faces and patches that are already trimmed,
which the kernel accepts.
"""

FINAL = (MissingDomain,)
"""Errors that no other method can avoid."""


@dataclass(frozen=True, slots=True)
class Fallback(Generic[P, T]):
    """A method by its name, the function that carries it out, and what it takes, in words."""

    name: str
    run: Callable[P, T]
    cost: str = ""


@dataclass(frozen=True, slots=True)
class Outcome(Generic[T]):
    """The value of the first method that succeeded, its name, and the errors of those before it."""

    value: T
    name: str
    failures: tuple[Exception, ...]

    @property
    def reasons(self) -> str:
        """The messages of the failures, each once, or "" if the first method succeeded."""
        return "; ".join(dict.fromkeys(map(str, self.failures)))


@dataclass(frozen=True, slots=True)
class Fallbacks(Generic[P, T]):
    """Methods for one task in the order in which they are tried, the next one after errors of `retry_on` but not of `final`.

    remedy: what a user may change where all methods fail; an InvalidRequest has a remedy of its own.
    """

    methods: tuple[Fallback[P, T], ...]
    retry_on: tuple[type[Exception], ...] = RETRYABLE
    final: tuple[type[Exception], ...] = FINAL
    remedy: str = ""

    def run(self, *args: P.args, **kwargs: P.kwargs) -> Outcome[T]:
        """The outcome of the first method that succeeds.

        Any other error is raised at once. If all methods fail, the error of the first one that applies to the request is raised,
        and its message is completed by what the others met: the first method is the most exact one, and those after it are
        general ones whose errors are often about something that they made themselves. A method that raises InvalidRequest
        does not apply; if none does, the first one's reason is raised.
        """
        failures: list[Exception] = []
        for method in self.methods:
            if failures:
                show_activity(f"{method.name}, after {failures[-1]}")
            is_next = bool(failures)
            try:
                return Outcome(method.run(*args, **kwargs), method.name, tuple(failures))
            except self.final:
                raise
            except self.retry_on as error:
                failures.append(error)
            finally:
                if is_next:
                    show_activity(None)
        reason = next((f for f in failures if not isinstance(f, InvalidRequest)), failures[0])
        raise self._with_history(reason, failures) from None

    def _with_history(self, reason: Exception, failures: list[Exception]) -> Exception:
        """The error with a message that ends in the other methods and their reasons, each reason once."""
        names = {str(failure): method.name for method, failure in reversed([*zip(self.methods, failures, strict=True)])}
        name = names.pop(str(reason))
        message = str(reason)
        if names:
            history = "; ".join(f"{other}: {why}" for why, other in reversed(names.items()))
            message = f"{reason} ({name}; also tried: {history})"
        if self.remedy and not isinstance(reason, InvalidRequest):
            message = f"{message}; {self.remedy}"
        reason.args = (message, *reason.args[1:])
        return reason
