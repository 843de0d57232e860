"""A box that contains the solid of a field, proved from the field's formula.

A large cube is divided where the enclosure of the field's values over a cell (`fields.tape.tape_enclosures`) is not positive. The
cells that are left contain the solid. A solid without bounds, or one whose formula no enclosure holds (a function of the user),
leaves cells at the sides of the cube.
"""

from __future__ import annotations

import numpy as np

from tpmscad._typing import Array
from tpmscad.fields.field import Field
from tpmscad.fields.tape.tape_enclosures import TapeEnclosures

REACH = 2.0**17
"""Model units: half the edge of the cube that is searched, 131 m."""

CELLS_ALONG_SOLID = 24
"""Cells along the longest edge of the solid at which the search ends: the box is then a twelfth too large, at most."""

MAX_CELLS = 60_000
"""Cells of one level that are searched."""

SKEW = np.array([0.0137, -0.0071, 0.0213])
"""Place of the cube's centre, in REACH: symmetric solids would touch cells at their corners."""

OCTANTS = np.stack(np.meshgrid((0, 1), (0, 1), (0, 1), indexing="ij"), axis=-1).reshape(8, 3)


def bound_solid(field: Field) -> tuple[Array, Array] | None:
    """Corners (3,), (3,) of a box that contains {field <= 0}; None if no bounds are found, or nothing is solid."""
    enclosures = TapeEnclosures(field.tape)
    centre = SKEW * REACH
    low, size = (centre - REACH)[None], 2 * REACH
    while True:
        found = enclosures.enclose(low, low + size, False)
        low = low[~(found.value.low > 0)]
        if not len(low):
            return None
        start, end = low.min(axis=0), low.max(axis=0) + size
        if size < REACH / 4 and ((start <= centre - REACH) | (end >= centre + REACH)).any():
            return None
        if (end - start).max() >= CELLS_ALONG_SOLID * size:
            return start, end
        if 8 * len(low) > MAX_CELLS:
            return None
        size /= 2
        low = (low[:, None] + size * OCTANTS).reshape(-1, 3)
