"""A cross-flow heat exchanger without baffles: each channel opens at two sides of a box, and ends before the others."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import build123d as bd

import tpmscad
from tpmscad.results.domain_results import FluidDomains

OPENINGS = {"+": ["<X", ">X"], "-": ["<Y", ">Y"]}


def exchanger(size: tuple[float, float, float], skin: float, tol: float) -> FluidDomains:
    """Wall, channel + from side to side along x, and channel - along y, which end `skin` before other sides; in mm."""
    return tpmscad.fluid_domains(bd.Box(*size), "gyroid", cell=10, thickness=1, tol=tol, openings=OPENINGS, skin=skin)


def main(
    folder: str | Path = ".",
    size: tuple[float, float, float] = (16.0, 14.0, 12.0),
    skin: float = 1.0,
    tol: float = 0.2,
) -> dict[str, Any]:
    """Make, draw and write the exchanger; return what was measured on it."""
    made = exchanger(size, skin, tol)
    print(made.summary())
    made.render(Path(folder) / "exchanger_openings.png", section="z=0", size=(640, 480))
    made.render(Path(folder) / "exchanger_openings_channels.png", hide="wall", size=(640, 480))
    made.export_step(Path(folder) / "exchanger_openings.step")
    certificate = made.certificate
    return {
        "met": certificate.met,
        "faces": certificate.n_faces,
        "deviation": certificate.max_deviation,
        "betti": certificate.betti,
        "volumes": {name: domain.volume for name, domain in made.domains.items()},
    }


if __name__ == "__main__":
    for name, value in main().items():
        print(f"{name}: {value}")
