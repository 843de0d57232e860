"""The bounding surfaces of a sheet or skeletal solid, as primitives over the mid surface's patch."""

from __future__ import annotations

from dataclasses import dataclass

from tpmscad.splines.bspline import BSplineSurface

LATTICE_TAGS = ("offset+", "offset-", "gap")
"""Of faces: above the mid surface, below it, between the two along a natural boundary."""

TOUCH_TOL_CELLS = 1e-9
"""Cells: patches that reach into a box by less do not; far above round-off, far below any tolerance."""


@dataclass(frozen=True, slots=True, eq=False)
class OffsetSurfaces:
    """The bounding offset surfaces over one mid patch: a primitive each, and whether it is turned over.

    `lower` and `upper` index `primitives`; None where the solid is on one side of a single surface.
    """

    primitives: tuple[BSplineSurface, ...]
    lower: tuple[int, bool] | None
    upper: tuple[int, bool] | None
