"""The second-order jet of a surface at its parameters: what a fit, a joint or a Newton step needs to know of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Jet:
    """Position, first and second derivatives with respect to (u, v), and the unit normal; all (..., 3).

    The normal is that of the mid surface, which its offset surfaces share.
    """

    position: Array
    du: Array
    dv: Array
    duu: Array
    duv: Array
    dvv: Array
    normal: Array
