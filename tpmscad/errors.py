"""The errors and the warnings that reach a user. Each message names the value, the limit and what to change."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any


class TpmscadError(Exception):
    """Base class of every error that leaves tpmscad. Errors can be pickled, so that they travel between processes."""

    def __reduce__(self) -> Any:
        return _restore_error, (type(self), self.args, self._portable_state())

    def _portable_state(self) -> dict[str, Any]:
        """The attributes that a pickle holds."""
        return dict(self.__dict__)


def _restore_error(kind: type[TpmscadError], args: tuple[Any, ...], state: dict[str, Any]) -> TpmscadError:
    """The error of a pickle, without a call of its constructor, whose parameters may differ from `args`."""
    error = kind.__new__(kind, *args)
    error.__dict__.update(state)
    return error


class InvalidRequest(TpmscadError, ValueError):
    """The request cannot be carried out as written; nothing was written."""


class MisusedCall(InvalidRequest, TypeError):
    """The arguments do not fit the function; the message shows the call as it is written."""


class NestedTooDeeply(InvalidRequest, RecursionError):
    """A field, a formula or a list is nested more deeply than Python can follow."""


class OutOfMemory(InvalidRequest, MemoryError):
    """The request needs more memory than the machine has; the message says how much, and what to change."""


class FileError(TpmscadError, OSError):
    """A file cannot be read or written; the message names it and the reason."""


class UnexpectedError(TpmscadError, RuntimeError):
    """A failure that the package did not foresee; its cause is the exception met."""


class UserFunctionError(InvalidRequest):
    """A function that was given, such as a field's or a map's, raised an exception, which is the cause of this one."""


class RecipeError(InvalidRequest):
    """A recipe is invalid; the message begins with the file, the line and the key."""


class MissingDomain(InvalidRequest):
    """The body holds no wall, or lacks one of the two channels."""


class EmptyInfill(InvalidRequest):
    """No part of the lattice lies in the body."""


class NotQuadric(InvalidRequest):
    """The body has faces that a boundary representation in arrays cannot hold exactly.

    `faces` are their indices in the kernel's order of exploration.
    """

    def __init__(self, message: str, faces: tuple[int, ...]) -> None:
        super().__init__(message)
        self.faces = faces


class NotMet(TpmscadError):
    """The result misses the request.

    Attributes
    ----------
    certificate : Certificate, BlendResult or None
        What was measured; `certificate.to_dict()` gives plain values.
    """

    def __init__(self, message: str, certificate: Any = None) -> None:
        super().__init__(message)
        self.certificate = certificate


class OutsideSpan(InvalidRequest):
    """A field leaves the range that it was given for, at a place that the message names."""


class NoFoot(TpmscadError):
    """A point is too far from a level set for its orthogonal projection to be found."""


class TrimmingError(TpmscadError):
    """A cut could not be resolved with certainty; the message says where."""


class NothingLeft(TrimmingError):
    """A cut leaves no face."""


class NoOffset(TrimmingError):
    """A face, an edge or a corner of a body has no offset surface at a distance, nor at one that is nearly the same."""


class LevelSetError(TpmscadError):
    """No boundary representation of a field could be made in its box; the message says where, why and what to change."""


class CrossingSurfaces(LevelSetError):
    """Level sets that bound a solid cross each other, in edges that patches of a single level set cannot have."""


class ThinWall(LevelSetError):
    """Two level sets come too close to each other for the tolerance; `thickness` is the least that was found, model units."""

    def __init__(self, message: str, thickness: float) -> None:
        super().__init__(message)
        self.thickness = thickness


class KernelError(TpmscadError):
    """The kernel refused an operation, or returned a result that its own checks reject.

    Attributes
    ----------
    operation : str
        Name of the operation.
    status : str
        The kernel's answer.
    shape : TopoDS_Shape or None
        The input of the operation, if there is one; a pickle leaves it out.
    """

    def __init__(self, operation: str, status: str, shape: Any = None) -> None:
        super().__init__(f"{operation}: {status}")
        self.operation = operation
        self.status = status
        self.shape = shape

    def _portable_state(self) -> dict[str, Any]:
        return {**self.__dict__, "shape": None}


class MissingKernel(TpmscadError, ImportError):
    """The CAD kernel, or the CAD library above it, is not installed or does not load; the message says how to fix it."""


class KernelConflictWarning(UserWarning):
    """Two CAD kernels are installed over each other, or one is damaged; the message names the two lines that fix it."""


def format_point(point: Iterable[float], digits: int = 4) -> str:
    """A point or vector for a message, in parentheses."""
    return "(" + ", ".join(f"{x:.{digits}g}" for x in point) + ")"
