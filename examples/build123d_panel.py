"""A sandwich panel in build123d: two skins, a core of Schwarz P between them, a bolt hole at every corner."""

import build123d as bd

import tpmscad
from tpmscad.build123d import Tpms

WIDTH, DEPTH, CORE, SKIN = 36, 26, 10, 2


def panel() -> tuple[bd.Part, Tpms]:
    """The panel, in mm, and its core, whose certificate says what was measured."""
    with bd.BuildPart() as built:
        with bd.Locations((0, 0, -(CORE + SKIN) / 2), (0, 0, (CORE + SKIN) / 2)):
            bd.Box(WIDTH, DEPTH, SKIN)
        core = Tpms("P", cell=CORE, cells=(2, 1, 1), thickness=1, tol=0.02)
        with bd.GridLocations(WIDTH - 8, DEPTH - 8, 2, 2):
            bd.Hole(radius=1.5)
    return built.part, core


if __name__ == "__main__":
    part, core = panel()
    print(core.certificate)
    assert core.certificate.met
    assert part.is_valid
    assert len(part.solids()) == 1
    tpmscad.export_step(part, "panel.step")
    print(tpmscad.check_step("panel.step"))
