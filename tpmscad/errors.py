"""The errors that reach a user: each message names the value, the limit and what to change."""

from __future__ import annotations

from typing import Any


class TpmscadError(Exception):
    """Base of every error that tpmscad raises on purpose."""


class InvalidRequest(TpmscadError, ValueError):
    """The request can't be carried out as it stands: nothing was computed and nothing written."""


class NotMet(TpmscadError):
    """The result misses what was asked for; `certificate` holds the figures that were measured."""

    def __init__(self, message: str, certificate: Any = None) -> None:
        super().__init__(message)
        self.certificate = certificate


class KernelError(TpmscadError):
    """The kernel refused an operation, or returned a result that its own checks reject.

    `operation` names it, `status` is what the kernel said, `shape` the input, where there is one.
    """

    def __init__(self, operation: str, status: str, shape: Any = None) -> None:
        super().__init__(f"{operation}: {status}")
        self.operation = operation
        self.status = status
        self.shape = shape
