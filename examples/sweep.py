"""Area against porosity of three surfaces: a sweep of wall thicknesses, and a plot of its results.

The results are kept in a CSV file: run again, the script makes only the designs that are missing there. On a machine with many
cores give `tpmscad.sweep` a process pool, as `tpmscad sweep designs.csv --jobs 8` does.

    python examples/sweep.py
"""

from __future__ import annotations

from pathlib import Path

import tpmscad
from tpmscad.sweeps import SweepResults

SURFACES = ("gyroid", "diamond", "schwarz_p")
CELL = 10.0


def main(path: str | Path = "sweep.csv", thicknesses: tuple[float, ...] = (0.5, 1.0, 1.5, 2.0)) -> SweepResults:
    """Make one cell of each surface with each thickness and return the results."""
    designs = [
        {"surface": surface, "cell": CELL, "thickness": thickness, "tol": 0.1, "boundary": "natural", "loose": "keep"}
        for surface in SURFACES
        for thickness in thicknesses
    ]
    return tpmscad.sweep(designs, output=path)


def picture(results: SweepResults, path: str | Path = "sweep.png") -> None:
    """Draw area per volume against porosity. Needs matplotlib."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(6, 4), layout="constrained")
    for surface in SURFACES:
        rows = [row for row in results.rows if row["surface"] == surface and row["met"]]
        axes.plot([r["porosity"] for r in rows], [r["area"] / CELL**3 for r in rows], "o-", label=surface)
    axes.set(xlabel="porosity", ylabel="area of the solid / volume of the cell, 1/mm")
    axes.legend()
    figure.savefig(path, dpi=100)
    plt.close(figure)


if __name__ == "__main__":
    found = main()
    print(found)
    picture(found)
