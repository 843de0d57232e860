"""Type aliases that every room shares."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

Progress = Callable[[str, float], None]
"""Called with the name of a stage and the fraction of it that is done, from 0 to 1."""

FractionProgress = Callable[[float], None]
"""Called with the fraction of one stage that is done, from 0 to 1."""
