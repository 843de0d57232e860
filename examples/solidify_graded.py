"""A gyroid whose wall thickens from 0.3 to 1.2 mm over four cells, as one solid in STEP."""

from __future__ import annotations

from pathlib import Path

from tpmscad import fields
from tpmscad.solids._solidify import solidify

GRADIENT = 0.961
"""One over the mean of 1 / slope of the 10 mm gyroid's field on its mid surface, per mm: level = slope x half the thickness."""


def main(path: str | Path = "graded.step", cells: int = 4) -> dict[str, object]:
    """Write the solid and return what its certificate says."""
    phi = fields.tpms("gyroid", period=10.0)
    level = fields.ramp("x", (0.0, 10.0 * cells), (0.15 * GRADIENT, 0.60 * GRADIENT))
    model = solidify(fields.sheet(phi, -level, level), ((0, 0, 0), (10.0 * cells, 10, 10)), tol=0.01)
    model.export_step(path)
    return model.certificate.to_dict()


if __name__ == "__main__":
    print(main())
