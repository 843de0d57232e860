"""Contours of a solid in many planes, as arrays."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.brep.sections.polygon_regions import Region

LayerSection = tuple[Region, float, float]
"""The contours of one layer, their area and their length."""


@dataclass(frozen=True, slots=True, eq=False)
class LayerContours:
    """Closed contours of all layers, one after the other, outer ones counter-clockwise and holes clockwise.

    points: (n, 2). starts: index of the first point of each contour, and n, (c + 1,). layer: of each contour, ascending, (c,).
    areas, perimeters: of each layer, exact or of more points than are kept, (l,). unresolved: number of chords longer than the
    error allows, beside points where a face is horizontal.
    """

    points: Array
    starts: IntArray
    layer: IntArray
    areas: Array
    perimeters: Array
    unresolved: int = 0

    def __iter__(self) -> Iterator[LayerSection]:
        """The section of each layer."""
        first = np.searchsorted(self.layer, np.arange(len(self.areas) + 1))
        for i, (area, length) in enumerate(zip(self.areas.tolist(), self.perimeters.tolist(), strict=True)):
            ends = self.starts[first[i] : first[i + 1] + 1]
            yield [self.points[a:b] for a, b in zip(ends[:-1].tolist(), ends[1:].tolist(), strict=True)], area, length
