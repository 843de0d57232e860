"""Names of the pieces of one thing, in files, meshes and pictures: the largest has the plain name, the others say where they lie.

"wall" is the largest piece of the wall, "wall (X+ Y- Z-)" the one in the corner of the greatest x and the least y and z, and
"wall (middle Z+)" the one in the middle of the upper side. Pieces in the same place are numbered: "wall (X+ Y- Z- 2)".
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from tpmscad._typing import Array

MIDDLE = 1.0 / 3.0
"""Part of the half extent of the whole, along an axis, within which a piece counts as in the middle."""

_PLACE = re.compile(r" (\([^()]*\)|\d+)$")
"""What `name_pieces`, or a number, adds to the name of the whole."""


def name_pieces(name: str, vertices: Sequence[Array]) -> list[str]:
    """Distinct names of the pieces of one thing, the largest first, given the vertices (n, 3) of each."""
    if len(vertices) < 2:
        return [name] * len(vertices)
    boxes = np.array([(points.min(axis=0), points.max(axis=0)) for points in vertices])
    whole = boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)
    names, used = [name], Counter[str]()
    for box in boxes[1:]:
        place = describe_place(box.mean(axis=0), whole)
        used[place] += 1
        names.append(f"{name} ({place}{f' {used[place]}' if used[place] > 1 else ''})")
    return names


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
