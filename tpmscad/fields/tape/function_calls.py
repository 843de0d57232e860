"""Calls of foreign functions: how a function takes points, whether it is vectorised, and its derivatives by differences.

A foreign function, given by a user or by another room, is called with flat arrays: points (n, 3), or three arrays (n,). Its
results are checked for shape and finiteness. Without a gradient function, derivatives are central differences of fourth order.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from tpmscad._typing import Array
from tpmscad.api.public_calls import call_for_array
from tpmscad.errors import InvalidRequest, UserFunctionError, format_point

DIFFERENCE_STEP = 1e-3
"""Default step of the difference quotients, in model units. For a wave of amplitude 1 and length L a derivative is off by about
330 step^4 / L^5 + 2e-16 / step: 4e-13 for L = 10, 3e-10 for L = 1. Finer structures need a smaller step."""

PROBE_POINTS = np.array(
    [[0.51, 0.52, 0.53], [0.67, 0.44, 0.59], [0.27, 0.91, 0.02], [0.84, 0.65, 0.24], [0.04, 0.3, 0.37]]
)
"""Points of the unit cube on which a function is tried. There are five because the results for three points would not tell a
function of points from one of x, y, z."""

BATCH_INDEPENDENCE_TOL = 1e-9
"""Relative change of a probe's value without the other probes above which a function mixes its points; round-off is far below."""

CHECKED_CALLS, CHECKED_POINTS = 3, 16
"""Calls in which stated derivatives are compared with differences, and points of each: some of the first points may be kinks."""

STEADY_RTOL = 0.05
"""Relative change of a derivative, from one step of the differences to twice the step, from which a kink or noise is near."""

DERIVATIVE_RTOL = 0.3
"""Relative error of a stated derivative from which it counts as wrong: a sign or a factor of two is, an approximation is not."""

LEAST_STEADY_POINTS = 3
"""Points without a kink or noise nearby that a verdict needs; stated derivatives that are wrong at most of them are refused."""

_REMEDY = (
    "it must take arrays and return one value for each point; use NumPy's functions in it (np.sin, np.where, not math.sin or if) "
    "and sums over the last axis, or wrap it with numpy.vectorize"
)


def call_function(f: Callable[..., Any], points: Array, takes_coordinates: bool) -> Array:
    """f(points (n, 3)), or f(x, y, z) of the coordinates (n,); three results become the columns of an array."""

    def collect(*args: Array) -> Any:
        result = f(*args)
        if isinstance(result, tuple | list) and len(result) == 3:
            return np.stack([np.broadcast_to(part, len(points)) for part in result], axis=-1)
        return result

    args = [points[:, axis].copy() for axis in range(3)] if takes_coordinates else [points]
    return call_for_array(describe_function(f), collect, *args)


def call_for_values(f: Callable[..., Any], points: Array, takes_coordinates: bool) -> Array:
    """Values (n,) of f at points (n, 3); InvalidRequest if the result has another shape."""
    values = call_function(f, points, takes_coordinates)
    if values.shape != points.shape[:1]:
        raise InvalidRequest(f"{describe_function(f)} gave shape {values.shape} for {len(points)} points: {_REMEDY}")
    return values


def call_for_gradient(
    f: Callable[..., Any], gradient: Callable[..., Any], points: Array, takes_coordinates: bool
) -> Array:
    """Gradients (n, 3) of f by its gradient function, whose result may be transposed; InvalidRequest for other shapes."""
    gradients = call_function(gradient, points, takes_coordinates)
    if gradients.shape == (3, len(points)) and len(points) != 3:
        gradients = gradients.T
    if gradients.shape != points.shape:
        raise InvalidRequest(
            f"the gradient of {describe_function(f)} gave shape {gradients.shape} for {len(points)} points: "
            "it must return (n, 3), a row for each point"
        )
    return gradients


def check_finite(f: Callable[..., Any], values: Array, points: Array) -> None:
    """Raise InvalidRequest, naming the first point (n, 3), if a value (n, ...) is not finite."""
    if np.isfinite(values).all():
        return
    bad = ~np.isfinite(values.ravel())
    where = ", ".join(f"{c:g}" for c in points[np.flatnonzero(bad)[0]])
    raise InvalidRequest(
        f"{describe_function(f)} is not finite at {bad.sum()} of {bad.size} points, first at ({where}): "
        "define finite values there, or exclude these points from the domain"
    )


def central_differences(f: Callable[[Array], Array], points: Array, step: float) -> Array:
    """Derivatives of f(points (n, 3)) -> (n, ...) by x, y, z on a new last axis: central differences of fourth order."""
    derivatives = []
    for move in step * np.eye(3):
        inner, outer = f(points + move) - f(points - move), f(points + 2 * move) - f(points - 2 * move)
        derivatives.append((8 * inner - outer) / (12 * step))
    return np.stack(derivatives, axis=-1)


@dataclass(slots=True, eq=False)
class DerivativeCheck:
    """Compares stated derivatives with central differences, in the first calls that ask for them."""

    what: str
    calls_left: int = CHECKED_CALLS

    def run(self, f: Callable[[Array], Array], points: Array, stated: Array, step: float) -> None:
        """InvalidRequest if derivatives (n, ..., 3) of f(points (n, 3)) -> (n, ...) are wrong at most points that show it."""
        if not self.calls_left or not len(points):
            return
        self.calls_left -= 1
        chosen = np.unique(np.linspace(0, len(points) - 1, CHECKED_POINTS).astype(int))
        try:
            differences = [central_differences(f, points[chosen], s).reshape(len(chosen), -1) for s in (step, 2 * step)]
        except InvalidRequest:  # the function ends a step beyond the points
            return
        (measured, wider), given = differences, stated[chosen].reshape(len(chosen), -1)
        with np.errstate(all="ignore"):
            size = np.linalg.norm(measured, axis=1)
            steady = np.linalg.norm(measured - wider, axis=1) <= STEADY_RTOL * size
            steady &= np.isfinite(given).all(axis=1) & (size > 0)
            wrong = steady & (np.linalg.norm(given - measured, axis=1) > DERIVATIVE_RTOL * size)
        if steady.sum() < LEAST_STEADY_POINTS or 2 * wrong.sum() <= steady.sum():
            return
        first = int(np.flatnonzero(wrong)[0])
        turned = np.linalg.norm(given + measured, axis=1)[wrong] <= DERIVATIVE_RTOL * size[wrong]
        raise InvalidRequest(
            f"{self.what} is wrong at {wrong.sum()} of {steady.sum()} points: at {format_point(points[chosen][first])} it is "
            f"{format_point(given[first])}, differences over {step:g} give {format_point(measured[first])}. "
            f"{'Turn its sign' if turned.all() else 'Correct it'}, or leave it out, for central differences"
        )


def detect_coordinate_arguments(f: Callable[..., Any], probes: Array) -> bool:
    """True if f takes x, y, z, False if it takes points: by the number of its required arguments, else by trial."""
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
            f"{describe_function(f)} takes {len(positional)} arguments: one (points) or three (x, y, z) are needed"
        )
    for takes_coordinates in (False, True):
        try:
            values = call_function(f, probes, takes_coordinates)
        except InvalidRequest:  # a trial: errors are reported by check_vectorised
            continue
        if values.shape == (len(probes),):
            return takes_coordinates
    return len(positional) >= 3


def check_vectorised(f: Callable[..., Any], takes_coordinates: bool, probes: Array) -> None:
    """Raise InvalidRequest unless f takes arrays and gives each point a value that is independent of the other points."""
    try:
        with np.errstate(all="ignore"):
            together = call_function(f, probes, takes_coordinates)
            alone = [call_function(f, probes[i : i + 1], takes_coordinates) for i in range(len(probes))]
    except UserFunctionError as error:
        raise UserFunctionError(
            f"{error}; it can't be called with arrays: {_REMEDY}; if it is defined in a part of space only, give a box there as "
            "domain="
        ) from error.__cause__
    if together.shape != (len(probes),):
        raise InvalidRequest(f"{describe_function(f)} gave shape {together.shape} for {len(probes)} points: {_REMEDY}")
    single = np.array([values.ravel()[0] if values.size == 1 else np.nan for values in alone])
    scale = BATCH_INDEPENDENCE_TOL * np.maximum(1.0, np.abs(together))
    if (np.abs(together - single) > scale).any() or (np.isfinite(together) & ~np.isfinite(single)).any():
        raise InvalidRequest(
            f"{describe_function(f)} gives a point a value that depends on the other points of the call: {_REMEDY}"
        )


def describe_function(f: Any) -> str:
    """The function's name for messages."""
    return f"the function {getattr(f, '__name__', type(f).__name__)}"
