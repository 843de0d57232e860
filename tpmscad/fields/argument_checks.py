"""Checks of the arguments of public functions: each returns the argument in its final form or raises InvalidRequest."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from tpmscad._typing import Array, BoxCorners
from tpmscad.errors import InvalidRequest
from tpmscad.fields.evaluation import Triple

Direction = str | Sequence[float]
"""A coordinate axis "x", "-x", "y", ..., or a vector (3,) of any length."""


def as_triple(value: Any, name: str) -> Triple:
    """Three finite numbers."""
    try:
        numbers = np.asarray(value, float)
    except (TypeError, ValueError):
        numbers = np.empty(0)
    if numbers.shape != (3,) or not np.isfinite(numbers).all():
        raise InvalidRequest(f"{name} {value!r} must be three finite numbers (x, y, z)")
    return float(numbers[0]), float(numbers[1]), float(numbers[2])


def as_positive(value: Any, name: str) -> float:
    """One finite number above zero."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = np.nan
    if not 0 < number < np.inf:
        raise InvalidRequest(f"{name} {value!r} must be a finite number above zero")
    return number


def as_finite(value: float, name: str) -> float:
    """One finite number."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = np.nan
    if not np.isfinite(number):
        raise InvalidRequest(f"{name} {value!r} must be a finite number")
    return number


def as_periods(period: float | Sequence[float], name: str = "period") -> Triple:
    """Three positive lengths; one number stands for all three."""
    px, py, pz = as_triple(period, name) if np.ndim(period) else (period,) * 3
    return as_positive(px, name), as_positive(py, name), as_positive(pz, name)


DEFAULT_PERIOD = 10.0
"""Model units."""


def choose_periods(period: float | Sequence[float] | None, cell: float | Sequence[float] | None) -> Triple:
    """The three periods, called `period` or, as lattices call them, `cell`; `DEFAULT_PERIOD` if neither is given."""
    if period is not None and cell is not None:
        raise InvalidRequest(f"period {period!r} and cell {cell!r} are two words for one length: give one of them")
    if cell is not None:
        return as_periods(cell, "cell")
    return as_periods(DEFAULT_PERIOD if period is None else period)


def as_unit_vector(value: Any, name: str) -> Triple:
    """The unit vector of "x", "-x", "y", ... or of a vector of any length."""
    if isinstance(value, str):
        sign, letter = (-1.0, value[1:]) if value.startswith("-") else (1.0, value)
        if letter not in ("x", "y", "z"):
            raise InvalidRequest(f"{name} {value!r}: give x, y, z, -x, -y, -z or a vector")
        return tuple(sign if letter == axis else 0.0 for axis in "xyz")  # type: ignore[return-value]
    vector = np.array(as_triple(value, name))
    length = float(np.linalg.norm(vector))
    if length == 0:
        raise InvalidRequest(f"{name} {value!r} has no direction: its length is zero")
    return tuple(map(float, vector / length))  # type: ignore[return-value]


def as_box_corners(domain: BoxCorners) -> tuple[Array, Array]:
    """Lower and upper corner (3,) of a finite box that is not empty."""
    box = np.asarray(domain, float)
    if box.shape != (2, 3) or not np.isfinite(box).all() or not (box[0] < box[1]).all():
        raise InvalidRequest(
            f"domain {domain!r} must be two corners (x, y, z), each coordinate of the first below the second's"
        )
    return box[0], box[1]
