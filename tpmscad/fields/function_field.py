"""Fields from functions that come from elsewhere: a user's, or another room's.

They are called with flat arrays, points (n, 3) or three arrays (n,), whatever the shape asked for, and what they return is
checked. Without a gradient of their own it is taken by central differences of fourth order.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tpmscad._typing import Array
from tpmscad.errors import InvalidRequest
from tpmscad.fields.evaluation import FieldJet, as_positive, as_triple, is_grid, stack_points
from tpmscad.fields.field import Field

DIFFERENCE_STEP = 1e-3
"""Step of the difference quotients, in model units. For a wave of amplitude 1 and length L the error of a derivative is about
330 step^4 / L^5 + 2e-16 / step: 4e-13 for L = 10, 3e-10 for L = 1; give a smaller step for finer structures."""

PROBE_POINTS = np.array(
    [[0.51, 0.52, 0.53], [0.67, 0.44, 0.59], [0.27, 0.91, 0.02], [0.84, 0.65, 0.24], [0.04, 0.3, 0.37]]
)
"""Points of the unit cube that tell a function of points from one of x, y, z, and a vectorised one from another; five of them,
since three would be ambiguous."""

BATCH_INDEPENDENCE_TOL = 1e-9
"""Relative change of a probe's value when the other probes are left out: round-off of a reordered sum stays far below."""


@dataclass(frozen=True, slots=True, eq=False)
class FunctionField(Field):
    """A foreign function of points (n, 3), or of x, y, z (n,) if `split`, and its gradient called likewise, or None.

    A foreign object's own `on_grid` is used where it has one. Values that are not finite raise InvalidRequest.
    """

    function: Callable[..., Any]
    slope: Callable[..., Any] | None
    split: bool
    step: float

    def at(self, x: Array, y: Array, z: Array) -> Array:
        fast = getattr(self.function, "on_grid", None)
        if fast is not None and is_grid(x, y, z):
            values = np.asarray(fast(x.ravel(), y.ravel(), z.ravel()), float)
            return self._finite(values, *stack_points(x, y, z))
        points, shape = stack_points(x, y, z)
        return self._finite(self._values(points), points, shape)

    def jet(self, x: Array, y: Array, z: Array) -> FieldJet:
        points, shape = stack_points(x, y, z)
        value = self._finite(self._values(points), points, shape)
        slopes = (
            central_differences(self._values, points, self.step) if self.slope is None else self._own_slopes(points)
        )
        gx, gy, gz = (self._finite(slopes[:, axis], points, shape) for axis in range(3))
        return value, gx, gy, gz

    def _values(self, points: Array) -> Array:
        values = np.asarray(call_function(self.function, points, self.split), float)
        if values.shape != points.shape[:1]:
            raise InvalidRequest(
                f"{_describe_function(self.function)} gave shape {values.shape} for {len(points)} points: {_REMEDY}"
            )
        return values

    def _own_slopes(self, points: Array) -> Array:
        assert self.slope is not None
        slopes = np.asarray(call_function(self.slope, points, self.split), float)
        if slopes.shape == (3, len(points)) and len(points) != 3:
            slopes = slopes.T
        if slopes.shape != points.shape:
            raise InvalidRequest(
                f"the gradient of {_describe_function(self.function)} gave shape {slopes.shape} for {len(points)} points: "
                "it must return (n, 3), a row for each point"
            )
        return slopes

    def _finite(self, values: Array, points: Array, shape: tuple[int, ...]) -> Array:
        if not np.isfinite(values).all():
            bad = ~np.isfinite(values.ravel())
            where = ", ".join(f"{c:g}" for c in points[np.flatnonzero(bad)[0]])
            raise InvalidRequest(
                f"{_describe_function(self.function)} is not finite at {bad.sum()} of {bad.size} points, first at ({where}): "
                "mend the function there, or keep these points out of the domain"
            )
        return values.reshape(shape)


def from_function(
    f: Callable[..., Any],
    gradient: Callable[..., Any] | None = None,
    *,
    step: float = DIFFERENCE_STEP,
    domain: Sequence[Sequence[float]] = ((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)),
) -> Field:
    """The field of f(points (n, 3)) -> (n,) or f(x, y, z) -> (n,); which of the two is found out by its signature or a trial.

    gradient: called like f, returns (n, 3) (or a tuple of three). By default f's own attribute `gradient`, or else central
    differences of fourth order with `step` in model units (12 calls of f; accuracy: see `STEP`). domain: a box in which f is
    tried on a few points.
    Raises InvalidRequest for functions that take single points only or mix the points of a call, and, when evaluated, for
    values that are not finite.
    """
    if isinstance(f, Field) and gradient is None:
        return f
    if not callable(f):
        raise InvalidRequest(f"{f!r} can't be called: a function of points (n, 3) or of x, y, z is needed")
    low, high = (np.array(as_triple(corner, "domain")) for corner in domain)
    probes = low + PROBE_POINTS * (high - low)
    split = _takes_coordinates(f, probes)
    _check_vectorised(f, split, probes)
    own = gradient if gradient is not None else getattr(f, "gradient", None)
    return FunctionField(f, own, split, as_positive(step, "step"))


def call_function(f: Callable[..., Any], points: Array, split: bool) -> Any:
    """f of points, or of their coordinates; a tuple or list of three becomes an array's columns."""
    result = f(*(points[:, axis].copy() for axis in range(3))) if split else f(points)
    if isinstance(result, tuple | list) and len(result) == 3:
        return np.stack([np.broadcast_to(part, len(points)) for part in result], axis=-1)
    return result


def central_differences(f: Callable[[Array], Array], points: Array, step: float) -> Array:
    """Derivatives of f(points (n, 3)) -> (n, ...) by x, y, z on a new last axis: central differences of fourth order."""
    slopes = []
    for move in step * np.eye(3):
        near, far = f(points + move) - f(points - move), f(points + 2 * move) - f(points - 2 * move)
        slopes.append((8 * near - far) / (12 * step))
    return np.stack(slopes, axis=-1)


_REMEDY = (
    "it must take arrays and return one value for each point; use NumPy's functions in it (np.sin, np.where, not math.sin or if) "
    "and sums over the last axis, or wrap it with numpy.vectorize"
)


def _takes_coordinates(f: Callable[..., Any], probes: Array) -> bool:
    """Whether f wants x, y, z: by the number of its required arguments, else by trial."""
    try:
        parameters, unknown = list(inspect.signature(f).parameters.values()), False
    except (TypeError, ValueError):
        parameters, unknown = [], True
    positional = [p for p in parameters if p.kind in (p.POSITIONAL_ONLY, p.POSITIONAL_OR_KEYWORD)]
    required = sum(p.default is p.empty for p in positional)
    open_ended = unknown or any(p.kind is p.VAR_POSITIONAL for p in parameters)
    if not open_ended and required in (1, 3):
        return required == 3
    if not open_ended and not required <= 3 <= len(positional) and not required <= 1 <= len(positional):
        raise InvalidRequest(
            f"{_describe_function(f)} takes {len(positional)} arguments: one (points) or three (x, y, z) are needed"
        )
    for split in (False, True):
        try:
            values = np.asarray(call_function(f, probes, split), float)
        except Exception:  # a trial: what goes wrong is reported by the check that follows
            continue
        if values.shape == (len(probes),):
            return split
    return len(positional) >= 3


def _check_vectorised(f: Callable[..., Any], split: bool, probes: Array) -> None:
    try:
        with np.errstate(all="ignore"):
            together = np.asarray(call_function(f, probes, split), float)
            alone = [np.asarray(call_function(f, probes[i : i + 1], split), float) for i in range(len(probes))]
    except InvalidRequest:
        raise
    except Exception as error:
        raise InvalidRequest(
            f"{_describe_function(f)} can't be called with arrays ({type(error).__name__}: {error}): {_REMEDY}; "
            "if it is defined in a part of space only, give a box there as domain="
        ) from error
    if together.shape != (len(probes),):
        raise InvalidRequest(f"{_describe_function(f)} gave shape {together.shape} for {len(probes)} points: {_REMEDY}")
    single = np.array([values.ravel()[0] if values.size == 1 else np.nan for values in alone])
    scale = BATCH_INDEPENDENCE_TOL * np.maximum(1.0, np.abs(together))
    if (np.abs(together - single) > scale).any() or (np.isfinite(together) & ~np.isfinite(single)).any():
        raise InvalidRequest(f"{_describe_function(f)} gives a point another value in the company of others: {_REMEDY}")


def _describe_function(f: Any) -> str:
    return f"the function {getattr(f, '__name__', type(f).__name__)}"
