"""A spinal cage of given pores: gyroid sheets of 70 % porosity between two windows, in a part made in build123d.

The cell follows from the porosity and the pore size, the diameter of the largest sphere in the void. With pores of 0.5 mm, into
which bone grows, the cage has a thousand cells: `main(pore_size=0.5)`.

    python examples/spinal_cage.py
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import build123d as bd

import tpmscad

LENGTH, WIDTH, HEIGHT = 20.0, 12.0, 7.0
POROSITY = 0.7


def cage() -> bd.Part:
    """A rounded block with two windows along its height, in mm."""
    block = bd.Pos(0, 0, HEIGHT / 2) * bd.Box(LENGTH, WIDTH, HEIGHT)
    block = bd.fillet(block.edges().filter_by(bd.Axis.Z), 4)
    window = bd.Cylinder(2.5, 3 * HEIGHT)
    return block - bd.Pos(-4.5, 0, 0) * window - bd.Pos(4.5, 0, 0) * window


def main(path: str | Path = "spinal_cage.step", pore_size: float = 2.4, tol: float | None = None) -> dict[str, Any]:
    """Make, draw and write the cage; return what was measured on it."""
    body = cage()
    model = tpmscad.infill(body, "gyroid", porosity=POROSITY, pore_size=pore_size, tol=tol or pore_size / 30)
    model.export(path)
    model.render(Path(path).with_suffix(".png"), view=(0.5, -1.0, 1.2))
    certificate = model.certificate
    return {
        "met": certificate.met,
        "faces": certificate.n_faces,
        "deviation": certificate.max_deviation,
        "betti": certificate.betti,
        "porosity": 1 - model.volume / body.volume,
        "notes": certificate.notes,
    }


if __name__ == "__main__":
    for name, value in main().items():
        print(f"{name}: {value}")
