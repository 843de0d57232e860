"""A sandwich panel in CadQuery: two skins, a core of Schwarz P between them, a bolt hole at every corner."""

import cadquery as cq

import cq_plugins.tpms  # noqa: F401  (adds tpms and tpmsInfill to Workplane)
import tpmscad

WIDTH, DEPTH, CORE, SKIN = 36, 26, 10, 2


def panel(cells: tuple[int, int, int] = (2, 1, 1)) -> cq.Workplane:
    """The panel, in mm."""
    skins = cq.Workplane().box(WIDTH, DEPTH, CORE + 2 * SKIN)
    skins = skins.cut(cq.Workplane().box(WIDTH, DEPTH, CORE))
    core = cq.Workplane().tpms("P", cell=CORE, cells=cells, thickness=1, tol=0.02, centered=True)
    holes = cq.Workplane().rarray(WIDTH - 8, DEPTH - 8, 2, 2).circle(1.5).extrude(CORE + 2 * SKIN, both=True)
    return skins.union(core).cut(holes)


def main(path: str = "cadquery_panel.step", cells: tuple[int, int, int] = (2, 1, 1)) -> dict[str, object]:
    """Make, draw and write the panel; return what was measured."""
    part = panel(cells)
    tpmscad.export_step(part.vals(), path)
    tpmscad.render(part.val(), path.replace(".step", ".png"))
    solid = part.val()
    return {"valid": solid.isValid(), "pieces": part.solids().size(), "volume": solid.Volume()}


if __name__ == "__main__":
    print(main())
