"""The table of the page "Which cell": walls, pores and cells of sheets by porosity, from closed forms and pore radii.

    python -m benchmarks.cell_choice

writes docs/reference/cell_choice.csv. All lengths of a lattice grow with its cell, so that a wall and a pore in cells give the
cell of any wall, and the pore that comes with it.
"""

from __future__ import annotations

import csv

from benchmarks.gallery import ROOT
from tpmscad import surfaces
from tpmscad.errors import InvalidRequest
from tpmscad.requests.lattice_request import read_lattice_request

TABLE = ROOT / "docs" / "reference" / "cell_choice.csv"
SURFACES = {"gyroid": "gyroid", "diamond": "diamond", "schwarz_p": "Schwarz P"}
POROSITIES = (0.5, 0.6, 0.7, 0.8, 0.9)
WALLS = {0.2: "powder bed, 0.2", 0.4: "one line of a 0.4 nozzle", 0.8: "two lines, 0.8"}
"""Walls in mm that printers make, and their column."""


def find_row(surface: str, porosity: float) -> list[str]:
    """Surface, porosity, wall and pore in cells, and cell / pore in mm for each wall; dashes where no such wall exists."""
    try:
        wall = surfaces.thickness_for(surface, "minimal", 1 - porosity)
    except InvalidRequest:
        return [SURFACES[surface], f"{porosity:.0%}", *["–"] * (2 + len(WALLS))]
    pore = 1 / read_lattice_request(surface, porosity=porosity, pore_size=1.0).cell[0]
    sizes = [f"{least / wall:.2g} / {pore * least / wall:.2g}" for least in WALLS]
    return [SURFACES[surface], f"{porosity:.0%}", f"{wall:.3f}", f"{pore:.3f}", *sizes]


def main() -> None:
    with TABLE.open("w", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(["sheet", "porosity", "wall, cells", "pore, cells", *WALLS.values()])
        for surface in SURFACES:
            table.writerows(find_row(surface, porosity) for porosity in POROSITIES)
    print(TABLE.read_text())


if __name__ == "__main__":
    main()
