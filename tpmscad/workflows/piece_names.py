"""Names of the pieces of one thing, in files, meshes and pictures: the largest has the plain name, the others say where they lie.

"wall" is the largest piece of the wall, "wall (X+ Y- Z-)" the one in the corner of the greatest x and the least y and z, and
"wall (middle Z+)" the one in the middle of the upper side. Pieces in the same place are numbered: "wall (X+ Y- Z- 2)".
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tpmscad import kernel

MIDDLE = 1.0 / 3.0
"""Part of the half extent of the whole, along an axis, within which a piece counts as in the middle."""

_PLACE = re.compile(r" (\([^()]*\)|\d+)$")
"""What `name_pieces`, or a number, adds to the name of the whole."""


def name_pieces(name: str, solids: Sequence[Any], box: ArrayLike) -> list[str]:
    """Distinct names of TopoDS solids, the largest first, that make up one thing; `box` (2, 3) holds the corners of the whole."""
    names, used = [name], Counter[str]()
    for solid in solids[1:]:
        place = describe_place(np.mean(kernel.bounding_box(solid), axis=0), box)
        used[place] += 1
        names.append(f"{name} ({place}{f' {used[place]}' if used[place] > 1 else ''})")
    return names[: len(solids)]


def describe_place(point: ArrayLike, box: ArrayLike) -> str:
    """Sides of a box (2, 3) that are near to a point (3,): "X+ Y- Z+", "middle Z-", "middle"."""
    low, high = np.asarray(box, dtype=np.float64)
    half = 0.5 * (high - low)
    off = np.divide(np.subtract(point, low + half), half, out=np.zeros(3), where=half > 0)
    sides = [f"{axis}{'+' if of > 0 else '-'}" for axis, of in zip("XYZ", off, strict=True) if abs(of) > MIDDLE]
    return " ".join(sides if len(sides) == 3 else ["middle", *sides])


def strip_place(name: str) -> str:
    """The name of the whole to which a piece belongs: "wall" for "wall (X+ Y- Z-)" and for "wall 2"."""
    return _PLACE.sub("", name)
