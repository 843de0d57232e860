"""Values of keywords as finite numbers, with errors that name the keyword, the value and the limit."""

from __future__ import annotations

from typing import Any

import numpy as np

from tpmscad.errors import InvalidRequest


def check_finite(label: str, value: Any) -> float:
    """The value as a float; InvalidRequest if it is not a finite number."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise InvalidRequest(f"{label} {value!r} is not a number") from None
    if not np.isfinite(number):
        raise InvalidRequest(f"{label} {number:g} must be finite")
    return number


def check_positive(label: str, value: Any) -> float:
    """The value as a float; InvalidRequest if it is not a positive number."""
    number = check_finite(label, value)
    if number <= 0:
        raise InvalidRequest(f"{label} {number:g} must be positive")
    return number


def check_triple(label: str, value: Any) -> tuple[float, float, float]:
    """Three finite numbers, one for each axis."""
    values = list(value) if np.ndim(value) else [value]
    if len(values) != 3:
        raise InvalidRequest(f"{label} takes three numbers, one for each axis; here {len(values)}")
    x, y, z = (check_finite(label, v) for v in values)
    return x, y, z


def check_positive_triple(label: str, value: Any) -> tuple[float, float, float]:
    """Three positive numbers; one number stands for three."""
    x, y, z = (check_positive(label, v) for v in check_triple(label, [value] * 3 if not np.ndim(value) else value))
    return x, y, z


def check_cell_counts(cells: Any) -> tuple[int, int, int]:
    """Three positive whole numbers; one number stands for three."""
    x, y, z = check_positive_triple("cells", cells)
    for value in (x, y, z):
        if value != int(value):
            raise InvalidRequest(f"cells {value:g} must be a whole number; trim the solid to take part of a cell")
    return int(x), int(y), int(z)
