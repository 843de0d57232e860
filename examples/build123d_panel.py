"""A sandwich panel in build123d: two skins, a core of Schwarz P between them, a bolt hole at every corner."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import build123d as bd

import tpmscad
from tpmscad.build123d import Tpms

CORE, SKIN, RIM = 10, 2, 16
"""Edge of a cell, thickness of a skin, and by how much the skins are longer and wider than the core, mm."""


def panel(cells: tuple[int, int] = (2, 1)) -> tuple[bd.Part, Tpms]:
    """The panel, in mm, and its core, whose certificate says what was measured."""
    width, depth = (count * CORE + RIM for count in cells)
    with bd.BuildPart() as built:
        with bd.Locations((0, 0, -(CORE + SKIN) / 2), (0, 0, (CORE + SKIN) / 2)):
            bd.Box(width, depth, SKIN)
        core = Tpms("P", cell=CORE, cells=(*cells, 1), thickness=1, tol=0.02)
        with bd.GridLocations(width - 8, depth - 8, 2, 2):
            bd.Hole(radius=1.5)
    return built.part, core


def main(path: str | Path = "panel.step", cells: tuple[int, int] = (2, 1)) -> dict[str, Any]:
    """Make, draw and write a panel with so many cells; return what was measured."""
    part, core = panel(cells)
    tpmscad.export_step(part, path)
    tpmscad.render(part, Path(path).with_suffix(".png"))
    certificate = core.certificate
    return {
        "met": certificate.met,
        "valid": part.is_valid,
        "pieces": len(part.solids()),
        "faces": len(part.faces()),
        "deviation": certificate.max_deviation,
        "betti": certificate.betti,  # of the core
    }


if __name__ == "__main__":
    for name, value in main().items():
        print(f"{name}: {value}")
