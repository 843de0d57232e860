"""A gyroid wrapped to a closed ring: eight cells around, so no end and no seam; and a dome of the same lattice."""

from pathlib import Path

import numpy as np

import tpmscad
from tpmscad import maps

CELL, THICKNESS = 10.0, 1.0


def ring(cells: int = 8, surface: str = "gyroid", tol: float = 0.02) -> tpmscad.Model:
    """The ring closes because its length, cells x cell, is the circumference of the cylinder at the inner radius."""
    wrap = maps.cylinder(cells * CELL / (2 * np.pi))
    return tpmscad.lattice(
        surface, cell=CELL, cells=(cells, 1, 1), thickness=THICKNESS, map=wrap, boundary="natural", tol=tol
    )


def dome(cells: int = 4, surface: str = "gyroid", tol: float = 0.02) -> tpmscad.Model:
    """A square of length pi x radius covers half the sphere, and its corners reach beyond."""
    wrap = maps.sphere(cells * CELL / np.pi)
    return tpmscad.lattice(
        surface, cell=CELL, cells=(cells, cells, 1), thickness=THICKNESS, map=wrap, boundary="natural", tol=tol
    )


def main(
    path: str | Path = "closed_ring.step", cells: int = 8, surface: str = "gyroid", tol: float = 0.02
) -> dict[str, object]:
    """Make and write the ring; return what was measured on it."""
    model = ring(cells, surface, tol)
    model.export_step(path)
    certificate = model.certificate
    pieces, tunnels, cavities = certificate.betti
    # A lattice that is longer than the turn would lie on itself: it is refused.
    try:
        tpmscad.lattice(surface, cell=CELL, cells=(5, 1, 1), thickness=0.6, map=maps.cylinder(7.0), boundary="natural")
        refused = ""
    except tpmscad.InvalidRequest as error:
        refused = str(error)
    return {
        "met": certificate.met,
        "pieces": pieces,
        "tunnels": tunnels,
        "cavities": cavities,
        "volume": certificate.volume,
        "seam gap": certificate.gap,
        "refused": refused,
    }


if __name__ == "__main__":
    for name, value in main().items():
        print(f"{name}: {value}")
