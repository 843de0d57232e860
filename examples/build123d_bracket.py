"""A bracket in build123d: an arm between two bosses, filled with a gyroid under a closed skin, the bores kept open."""

import build123d as bd

import tpmscad
from tpmscad.build123d import TpmsInfill


def bracket(length: float = 24.0, cell: float = 8.0, tol: float = 0.05) -> tuple[bd.Part, TpmsInfill]:
    """The bracket, in mm, and its filled arm, whose certificate says what was measured."""
    core = TpmsInfill(bd.Box(length, 12, 8), "gyroid", cell=cell, thickness=1, skin=1, tol=tol)
    ends = bd.Locations((-length / 2, 0, 0), (length / 2, 0, 0)).locations
    part = core + [end * bd.Cylinder(8, 10) for end in ends] - [end * bd.Cylinder(4, 10) for end in ends]
    return part, core


def main(path: str = "bracket.step", **size: float) -> dict[str, object]:
    """Make, draw and write the bracket; return what was measured."""
    part, core = bracket(**size)
    tpmscad.export_step(part, path)
    tpmscad.render(part, path.replace(".step", ".png"), section="z=0")
    certificate = core.certificate
    return {
        "met": certificate.met,
        "valid": part.is_valid,
        "pieces": len(part.solids()),
        "faces": len(part.faces()),
        "deviation": certificate.max_deviation,
        "betti": certificate.betti,  # of the filled arm
    }


if __name__ == "__main__":
    print(main())
