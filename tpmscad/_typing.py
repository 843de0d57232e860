"""Type aliases that all packages share, and a tuple of three with its type."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
UIntArray = NDArray[np.uint64]

Colour = tuple[float, float, float]
"""Red, green and blue from 0 to 1."""

BoxCorners = Sequence[Sequence[float]]
"""Opposite corners of a box, ((x0, y0, z0), (x1, y1, z1)), in model units."""

Progress = Callable[[str, float], None]
"""Called with the name of a stage and the fraction of it that is done, from 0 to 1."""

ProgressOption = Progress | bool | None
"""Who shows the progress: a callable; None or True for a bar in a terminal or notebook, nothing elsewhere; False for nobody."""

FractionProgress = Callable[[float], None]
"""Called with the fraction of one stage that is done, from 0 to 1."""

T = TypeVar("T")


def triple(values: Iterable[T]) -> tuple[T, T, T]:
    """Three values, one for each axis, as a tuple of that length."""
    x, y, z = values
    return x, y, z
