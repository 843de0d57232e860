"""What the volumes between a surface and its offsets follow from, by Steiner's formula."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Measures:
    """Of one cubic cell: area, integrals of mean and Gauss curvature, the fraction where f < 0, the least and greatest offset.

    Lengths in cells. Mean curvature is positive where the surface bends towards the normal.
    """

    area: float
    mean: float
    gauss: float
    below: float
    lowest: float
    highest: float

    def swept(self, offset: float) -> float:
        """Volume between the mid surface and its offset, positive along the normal."""
        return self.area * offset - self.mean * offset**2 + self.gauss * offset**3 / 3
