"""Periods and directions in the forms that fields keep them: three lengths, and a unit vector."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.errors import InvalidRequest
from tpmscad.fields.tape.evaluation import Triple

Direction = str | Sequence[float]
"""A coordinate axis "x", "-x", "y", ..., or a vector (3,) of any length."""

DEFAULT_PERIOD = 10.0
"""Model units."""

ROUND_OFF = 1e-12
"""In greatest coordinates of a box: distance within which a length is a multiple of another. Products, and the nearest decimals
of products, are some units in the last place off, 1e-16 each; what is taken for a multiple must be one to far below 1e-7 mm, the
kernel's tolerance."""


def count_whole(lo: Array, hi: Array, lengths: Array) -> IntArray:
    """How many lengths (3,) the sides of the box [lo, hi] hold, but for round-off; 0 for no whole number, and for no length."""
    divisor = np.where(lengths > 0, lengths, np.inf)
    number = np.rint((hi - lo) / divisor)
    off = np.abs(number * np.where(lengths > 0, lengths, 0.0) - (hi - lo))
    return np.where(off <= ROUND_OFF * np.abs([lo, hi]).max(), number, 0).astype(np.int64)


def as_periods(period: float | Sequence[float]) -> Triple:
    """Three lengths; one number stands for all three."""
    px, py, pz = np.broadcast_to(period, 3).tolist()
    return px, py, pz


def choose_periods(period: float | Sequence[float] | None, cell: float | Sequence[float] | None) -> Triple:
    """The three periods, called `period` or, as lattices call them, `cell`; `DEFAULT_PERIOD` if neither is given."""
    if period is not None and cell is not None:
        raise InvalidRequest(f"period {period} and cell {cell} are two words for one length: give one of them")
    given = cell if period is None else period
    return as_periods(DEFAULT_PERIOD if given is None else given)


def as_unit_vector(direction: Direction) -> Triple:
    """The unit vector of "x", "-x", "y", ... or of a vector of any length but zero."""
    if isinstance(direction, str):
        sign = -1.0 if direction.startswith("-") else 1.0
        x, y, z = (sign if direction[-1] == axis else 0.0 for axis in "xyz")
    else:
        vector = np.array(direction, float)
        x, y, z = (vector / np.linalg.norm(vector)).tolist()
    return x, y, z
