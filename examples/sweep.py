"""Stiffness against porosity: a sweep of surfaces and wall thicknesses with homogenised properties, and a plot of it.

The results are kept in a CSV file: run again, the script makes only the designs that are missing there. On a machine with many
cores give `tpmscad.sweep` a process pool, as `tpmscad sweep designs.csv --properties --jobs 8` does.

    pip install "tpmscad[simulation,plot]"

    python examples/sweep.py
"""

from __future__ import annotations

from pathlib import Path

import tpmscad
from tpmscad.sweeps._sweep import SweepResults

SURFACES = ("schwarz_p", "gyroid", "diamond")
THICKNESSES = (0.5, 1.0, 1.5, 2.0)
"""All of them take two minutes: `main(surfaces=SURFACES, thicknesses=THICKNESSES)`."""

CELL = 10.0


def main(
    path: str | Path = "sweep.csv",
    surfaces: tuple[str, ...] = SURFACES[:1],
    thicknesses: tuple[float, ...] = THICKNESSES[1::2],
) -> SweepResults:
    """Make one cell of each surface with each thickness, plot Young's modulus over porosity, and return the results."""
    designs = [
        {"surface": surface, "cell": CELL, "thickness": thickness, "tol": 0.1, "boundary": "natural", "loose": "keep"}
        for surface in surfaces
        for thickness in thicknesses
    ]
    results = tpmscad.sweep(designs, output=path, properties=True)
    axes = results.plot("porosity", "E1", by="surface")
    axes.set_title("one cell of the sheet, Poisson's ratio of the solid 0.3")
    axes.set_ylim(bottom=0.0)
    axes.grid(alpha=0.3)
    axes.figure.savefig(Path(path).with_suffix(".png"), dpi=100)
    return results


if __name__ == "__main__":
    found = main()
    print(found)
    for row in found.rows:
        print(f"{row['surface']:10} {row['thickness']:.1f} mm  porosity {row['porosity']:.3f}  E {row['E1']:.4f}")
