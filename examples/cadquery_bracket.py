"""A bracket in CadQuery: an arm between two bosses, filled with a gyroid under a closed skin, the bores kept open."""

import cadquery as cq

import cq_plugins.tpms  # noqa: F401  (adds tpms and tpmsInfill to Workplane)
import tpmscad


def bracket(length: float = 30.0, cell: float = 8.0, tol: float = 0.05) -> cq.Workplane:
    """The bracket, in mm."""
    ends = [(-length / 2, 0), (length / 2, 0)]
    arm = cq.Workplane().box(length, 12, 8).tpmsInfill("gyroid", cell=cell, thickness=1, skin=1, tol=tol)
    bosses = cq.Workplane().pushPoints(ends).circle(8).extrude(5, both=True)
    bores = cq.Workplane().pushPoints(ends).circle(4).extrude(5, both=True)
    return arm.union(bosses).cut(bores)


def main(path: str = "cadquery_bracket.step", **size: float) -> dict[str, object]:
    """Make, draw and write the bracket; return what was measured."""
    part = bracket(**size)
    tpmscad.export_step(part.vals(), path)
    tpmscad.render(part.val(), path.replace(".step", ".png"), section="z=0")
    solid = part.val()
    return {"valid": solid.isValid(), "pieces": part.solids().size(), "volume": solid.Volume()}


if __name__ == "__main__":
    print(main())
