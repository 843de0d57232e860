"""Labels and grey values: what the whole numbers of an array are.

A segmentation has a whole number for each voxel that names a material or an organ; a mean of two labels means nothing. Its type
does not tell it from a CT, whose Hounsfield units are integers, too: these have many different values, and negative ones for air.
"""

from __future__ import annotations

import numpy as np

from tpmscad._typing import Array

MAX_LABELS = 64
"""Different values up to which integers are taken as labels: a CT has thousands, a grey image of 8 bits nearly 256."""

MAX_LABELS_SHOWN = 12
"""Labels that a message lists."""


def list_labels(values: Array) -> str | None:
    """The values of an array that holds labels, in words; None for numbers.

    Labels are bools, or integers of at most MAX_LABELS different values and none below zero.
    """
    return _list_few(values) if values.dtype.kind in "biu" else None


def _list_few(values: Array) -> str | None:
    """The different values in words; None if they are more than MAX_LABELS or some are below zero."""
    found = np.unique(values)
    return None if found[0] < 0 or len(found) > MAX_LABELS else format_labels(found)


def format_labels(found: Array) -> str:
    """Some labels in words."""
    shown = ", ".join(str(int(label)) for label in found[:MAX_LABELS_SHOWN])
    return f"{shown} and {len(found) - MAX_LABELS_SHOWN} more" if len(found) > MAX_LABELS_SHOWN else shown


def describe_whole_numbers(name: str, values: Array) -> list[str]:
    """Notes on whole numbers that are taken as grey values: integers, and floating-point numbers that may be labels."""
    if values.dtype.kind in "iu":
        return [f"{name}: its integers, from {values.min()} to {values.max()}, are taken as grey values, not as labels"]
    known = values[~np.isnan(values)]
    found = _list_few(known) if known.size and (known == np.rint(known)).all() else None
    if found is None or found in ("0", "1", "0, 1"):
        return []
    return [f"{name}: the whole numbers {found} are taken as grey values; fields.labels if they are labels"]
