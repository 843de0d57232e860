"""A porous tooth: three structures, denser from the inside outwards, blended in a block and carried over to a free form.

It follows figure 13 of the porous-blending paper. The design domain is a trivariate B-spline solid. The structures, rods of
Schwarz P of three volume fractions in concentric regions, are blended in its parameter block, where cells are cubes; the spline
carries the solid over. Its Jacobian is proved positive, so that the tooth has the topology of the structure in the block, which
is counted on a grid.

    python examples/tooth.py
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

import tpmscad
from tpmscad import fields, maps, topology
from tpmscad.blending import BlendResult

SURFACE = "schwarz_p"
VOLUME_FRACTIONS = (0.3, 0.42, 0.55)
"""From the inside outwards."""

INTERFACES = (0.4, 0.75)
"""Radii of the cylinders between the regions, in half widths of the block."""

BAND = 0.5
"""Width of a blending region, in cells."""

DEGREE = 4
HALF_WIDTHS = (2.8, 2.6, 3.0, 6.2, 4.8)
"""Half widths of the control net, mm, from the root to the crown."""

DEPTH, ROUNDING, CUSP = 0.85, 0.6, 5.0
"""Depth over width; rounding of the cross-section, 0 for a square and 1 for an ellipse; rise of the poles of the cusps, mm."""

HEIGHT, ROOT = 14.0, 1.2
"""Height of the net and depth of the root's tip below it, mm."""

SAMPLES_PER_CELL = 24
"""Of the grid on which the topology in the block is counted."""


def tooth(cells: tuple[int, int, int]) -> maps.SplineMap:
    """The map from a block of so many unit cells to the tooth: one span of degree 4, with the root down."""
    t = np.linspace(0.0, 1.0, DEGREE + 1)
    u, v, w = np.meshgrid(2 * t - 1, 2 * t - 1, t, indexing="ij")
    half = np.broadcast_to(HALF_WIDTHS, u.shape)
    x = half * u * np.sqrt(1 - ROUNDING * v**2 / 2)
    y = DEPTH * half * v * np.sqrt(1 - ROUNDING * u**2 / 2)
    cusps = CUSP * (np.sin(np.pi * u) * np.sin(np.pi * v)) ** 2 * w**5
    z = HEIGHT * w + cusps - ROOT * (1 - (u**2 + v**2) / 2) * (1 - w) ** 3
    knots = [np.repeat([0.0, n], DEGREE + 1) for n in cells]
    return maps.trivariate(np.stack([x, y, z], axis=-1), knots, (DEGREE,) * 3)


def blend_regions(cells: tuple[int, int, int]) -> BlendResult:
    """The structures in the block, in concentric regions, blended without isolated components and cavities."""
    block, middle = fields.box((0, 0, 0), cells), (cells[0] / 2, cells[1] / 2, 0)
    phi = fields.tpms(SURFACE, period=1.0)
    radii = [share * min(cells[:2]) / 2 for share in INTERFACES]
    first, second = (fields.cylinder(middle, r, axis="z") for r in radii)
    bands = [
        fields.cylinder(middle, r + BAND / 2, axis="z") & ~fields.cylinder(middle, r - BAND / 2, axis="z")
        for r in radii
    ]
    return tpmscad.blend(
        [fields.rod(phi, fields.threshold_for(phi, part, "rod")) for part in VOLUME_FRACTIONS],
        [first & block, second & ~first & block, block & ~second],
        [band & block for band in bands],
        progress=False,
    )


def count_topology(field: fields.Field, cells: tuple[int, int, int]) -> tuple[int, int, int]:
    """Pieces, tunnels and cavities of the structure in the block, on a grid."""
    found = topology.betti(field.on_grid(*(np.linspace(0, n, SAMPLES_PER_CELL * n + 1) for n in cells)))
    return found.b0, found.b1, found.b2


def main(
    path: str | Path = "tooth.step", cells: tuple[int, int, int] = (3, 3, 3), tol: float = 0.015
) -> dict[str, Any]:
    """Make, draw and write a tooth of so many cells, in mm; return what was measured on it."""
    domain, blended = tooth(cells), blend_regions(cells)
    model = tpmscad.solidify(blended.field, domain, tol=tol)
    model.export(path)
    model.render(Path(path).with_suffix(".png"), section="y", view=(0.5, -1.0, 0.4))
    certificate = model.certificate
    return {
        "met": certificate.met,
        "faces": certificate.n_faces,
        "deviation": certificate.max_deviation,
        "tolerance": tol,
        "betti": certificate.betti,
        "betti in the block": count_topology(blended.field, cells),
        "least Jacobian, proved": domain.least_jacobian,
        "isolated parts of the blend": blended.errors.remaining,
        "pieces left out": len(certificate.dropped),
        "volume": model.volume,
        "shortfalls": certificate.shortfalls,
    }


if __name__ == "__main__":
    for name, value in main().items():
        print(f"{name}: {value}")
