"""The wall of a rocket nozzle as a heat exchanger: a closed ring of gyroid sheet that converges and diverges along the axis.

A wrap around the axis is composed with the contour of a bell nozzle. The sheet is the mapped minimal surface with walls along its
normals, thickest at the throat, where the heat flux is greatest. The thickness is measured on the solid at several heights,
and the tunnels are counted in the STEP file.

    python examples/nozzle.py
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import build123d as bd
import numpy as np
from scipy.interpolate import KroghInterpolator

import tpmscad
from tpmscad import maps

CELL = 5.0
"""Cells are cubes of this edge at the inner side of the throat, mm."""

THROAT, RISE, EXIT_SLOPE = 0.4, (0.14, 0.24), 0.3
"""Of the inner contour, in lengths of the nozzle: height of the throat, rise of the radius to inlet and exit; final slope."""

THICKNESS, REACH = (0.4, 0.7), 0.25
"""Of the wall, mm, far from the throat and there; how far it is thickened, in lengths of the nozzle."""

PLACES = 8
"""Points at each height at which the thickness is measured."""


class Nozzle:
    """Map and thickness of a nozzle of `cells` around the axis, through the wall and along the axis."""

    def __init__(self, cells: tuple[int, int, int]) -> None:
        self.radius = CELL * cells[0] / (2 * np.pi)
        self.length = CELL * cells[2]
        self.throat = THROAT * self.length
        inlet, outlet = (self.radius + rise * self.length for rise in RISE)
        at = [0.0, 0.0, self.throat, self.throat, self.length, self.length]
        self.contour = KroghInterpolator(at, [inlet, 0.0, self.radius, 0.0, outlet, EXIT_SLOPE])  # one polynomial

    def shift(self, points: np.ndarray) -> np.ndarray:
        """Lattice points (..., 3) with y, the radial distance, shifted by the contour."""
        x, y, z = np.moveaxis(points, -1, 0)
        return np.stack([x, y + self.contour(z) - self.radius, z], axis=-1)

    @property
    def map(self) -> maps.Map:
        """From the block of cells, x around the axis and y outwards, to the ring."""
        return maps.composition(maps.cylinder(self.radius), maps.Map(self.shift, name="bell contour"), CELL)

    def thickness(self, points: np.ndarray) -> np.ndarray:
        """Thickness of the wall at points (..., 3), mm."""
        least, greatest = THICKNESS
        away = (points[..., 2] - self.throat) / (REACH * self.length)
        return least + (greatest - least) * np.exp(-(away**2))


def measure_thickness(model: tpmscad.Model, height: float) -> tuple[np.ndarray, np.ndarray]:
    """Least distances (n,) between the sides of the wall near a height, and their middles (n, 3), on the faces of the solid."""
    surfaces = [(f, f.geom_adaptor()) for f in model.solid.faces()]
    sides = [f for f, s in surfaces if min(s.UDegree(), s.VDegree()) > 1]  # the faces of the boundary are ruled
    centre, normal = (
        np.array([[*value] for value in values])
        for values in ([f.position_at(0.5, 0.5) for f in sides], [f.normal_at() for f in sides])
    )
    nearest = np.argsort(np.abs(centre[:, 2] - height))
    gaps, middles = [], []
    for k in nearest[:: len(nearest) // (20 * PLACES) or 1][:PLACES]:
        near = np.linalg.norm(centre - centre[k], axis=1) < CELL
        opposite = np.flatnonzero(near & (normal @ normal[k] < -0.5))
        point = bd.Vertex(*centre[k])
        gaps.append(min(point.distance_to(sides[i]) for i in opposite))
        middles.append(centre[k] - gaps[-1] / 2 * normal[k])
    return np.array(gaps), np.array(middles)


def count_tunnels(path: str | Path) -> int:
    """Tunnels of the solid in a STEP file, one piece without cavities: from its numbers of vertices, edges and faces."""
    solid = bd.import_step(path)
    euler = len(solid.vertices()) - len(solid.edges()) + len(solid.faces())
    return 1 - euler // 2


def main(path: str | Path = "nozzle.step", cells: tuple[int, int, int] = (8, 1, 3), tol: float = 0.2) -> dict[str, Any]:
    """Make, draw and write a nozzle of so many cells, in mm; return what was measured on it."""
    nozzle = Nozzle(cells)
    model = tpmscad.lattice(
        "gyroid", cell=CELL, cells=cells, thickness=nozzle.thickness, map=nozzle.map, boundary="natural", tol=tol
    )
    model.export(path)
    model.render(Path(path).with_suffix(".png"), section="y", view=(0.3, -1.0, 0.35))
    heights = {"inlet": CELL / 2, "throat": nozzle.throat, "exit": nozzle.length - CELL / 2}
    found = {name: measure_thickness(model, height) for name, height in heights.items()}
    certificate = model.certificate
    return {
        "met": certificate.met,
        "faces": certificate.n_faces,
        "deviation": certificate.max_deviation,
        "tolerance": tol,
        "betti": certificate.betti,
        "tunnels in the file": count_tunnels(path),
        "thickness": {name: float(gaps.mean()) for name, (gaps, _) in found.items()},
        "thickness off by at most": {
            name: float(np.abs(gaps - nozzle.thickness(middles)).max()) for name, (gaps, middles) in found.items()
        },
        "volume": model.volume,
    }


if __name__ == "__main__":
    for name, value in main().items():
        print(f"{name}: {value}")
