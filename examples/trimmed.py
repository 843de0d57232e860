"""A trimmed Schwarz P: a body with bores, counterbores and rounded edges filled with it, drawn cut open.

It follows case study 9 of the TPMS2STEP paper. The body's own planes and cylinders stay exact.
"""

from __future__ import annotations

from pathlib import Path

import build123d as bd

import tpmscad


def drilled_block(length: float = 24.0) -> bd.Part:
    """A block with rounded edges, a bore through it and two counterbored holes, in mm."""
    with bd.BuildPart() as part:
        bd.Box(length, 20, 12)
        bd.fillet(part.edges().filter_by(bd.Axis.Z), 4)
        bd.Hole(4)
        with bd.GridLocations(length - 10, 1, 2, 1):
            bd.CounterBoreHole(1.5, 2.5, 2)
    return part.part


def main(
    folder: str | Path = ".",
    surfaces: tuple[str, ...] = ("schwarz_p",),
    length: float = 24.0,
    cell: float = 12.0,
    tol: float = 0.1,
) -> dict[str, dict[str, object]]:
    """Fill the body with each surface, write it and draw it cut open; return what was measured."""
    body, found = drilled_block(length), {}
    for surface in surfaces:
        model = tpmscad.infill(body, surface, cell=cell, thickness=cell / 10, tol=tol)
        path = Path(folder) / f"trimmed_{surface}.step"
        model.export(path)
        model.render(path.with_suffix(".png"), section="y,z")
        certificate = model.certificate
        found[surface] = {
            "met": certificate.met,
            "faces": certificate.n_faces,
            "deviation": certificate.max_deviation,
            "betti": certificate.betti,
            "megabytes": round(path.stat().st_size / 1e6, 2),
        }
    return found


if __name__ == "__main__":
    for name, values in main().items():
        print(name, values)
