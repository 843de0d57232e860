"""A strut lattice with nodes: an octet truss whose struts meet in balls.

All faces are cylinders, spheres and planes, exact in STEP.

    python examples/octet_truss.py
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import tpmscad

CELL, DIAMETER, NODE_RADIUS = 10.0, 1.2, 1.1


def main(path: str | Path = "octet_truss.step", cells: int = 1) -> dict[str, Any]:
    """Make, draw and write a cube of so many cells along each edge, in mm; return what was measured on it."""
    model = tpmscad.struts("octet", cell=CELL, cells=cells, diameter=DIAMETER, node_radius=NODE_RADIUS)
    model.export(path)
    model.render(Path(path).with_suffix(".png"))
    certificate = model.certificate
    return {
        "met": certificate.met,
        "faces": certificate.n_faces,
        "deviation": certificate.max_deviation,
        "betti": certificate.betti,
        "volume fraction": model.volume / (cells * CELL) ** 3,
    }


if __name__ == "__main__":
    for name, value in main().items():
        print(f"{name}: {value}")
