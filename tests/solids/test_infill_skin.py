"""Skins with faces left open: one solid of one shell, whose channels reach the outside."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import build123d as bd
import numpy as np
import pytest

import tpmscad
from tpmscad.kernel.body_import.cad_body import read_body
from tpmscad.kernel.boolean.hollow_body import resolve_open_faces

pytestmark = [pytest.mark.kernel, pytest.mark.slow]

P: dict[str, Any] = {"surface": "P", "cell": 10, "thickness": 1, "tol": 0.1}
SKIN = 1.5


def block() -> bd.Part:
    return bd.Box(20, 16, 14) - bd.Pos(1, 0, 0) * bd.Cylinder(2, 30)


def ends(body: bd.Part) -> list[bd.Face]:
    below, *_, above = body.faces().sort_by(bd.Axis.Z)
    return [below, above]


@pytest.fixture(scope="module")
def filled() -> Any:
    body = block()
    return tpmscad.infill(body, **P, skin=SKIN, open_faces=ends(body))


def test_the_channels_reach_the_outside(filled: Any, tmp_path: Path) -> None:
    found = filled.certificate
    assert found.met
    assert isinstance(filled.solid, bd.Solid)
    assert len(filled.solid.shells()) == 1
    assert found.betti[::2] == (1, 0)
    assert not any("closes off" in note for note in found.notes)
    filled.export_step(tmp_path / "open.step")
    again = tpmscad.check_step(tmp_path / "open.step")
    assert again.ok
    assert again.shape.shells == 1


def test_what_is_left_is_the_wall_and_the_lattice(filled: Any) -> None:
    inner = bd.Box(20 - 2 * SKIN, 16 - 2 * SKIN, 14) - bd.Pos(1, 0, 0) * bd.Cylinder(2 + SKIN, 30)
    lattice = tpmscad.infill(inner, **P, loose="keep").certificate  # chips there are part of the skin here
    # both volumes are taken about the middle of their solids, and edges lie off faces by up to 2.5e-8
    assert filled.certificate.volume == pytest.approx(block().volume - inner.volume + lattice.volume, rel=1e-8)
    mouth = sum(f.area for f in filled.solid.faces() if abs(f.center().Z - 7) < 1e-9)
    rim = 20 * 16 - np.pi * 4 - (17 * 13 - np.pi * (2 + SKIN) ** 2)
    assert mouth > rim
    assert mouth < 20 * 16 - np.pi * 4


def test_a_sandwich_is_two_plates_and_the_lattice_between_them() -> None:
    made = tpmscad.infill(bd.Box(12, 11, 14), **P, skin=SKIN, open_faces="#Z")
    core = tpmscad.infill(bd.Box(12, 11, 11), **P, loose="keep").certificate
    assert made.certificate.met
    assert made.volume == pytest.approx(2 * 12 * 11 * SKIN + core.volume, rel=1e-8)
    assert len(made.solid.shells()) == 1


def test_sides_and_top_of_a_block_with_rounded_corners_may_be_open() -> None:
    body = bd.fillet(bd.Box(12, 11, 12).edges().filter_by(bd.Axis.Z), 3)
    made = tpmscad.infill(body, **P, skin=SKIN, open_faces="#Z,>Z", loose="keep")
    assert made.certificate.met
    assert made.solid.is_valid
    outside = sum(f.area for f in made.solid.faces() if f.geom_type == bd.GeomType.CYLINDER and f.radius > 2.9)
    assert outside == pytest.approx(2 * np.pi * 3 * 12, rel=1e-9)  # the corners keep their skin


def test_faces_may_be_given_by_number() -> None:
    body = read_body(block())
    numbers = [i for i, f in enumerate(bd.Solid(body.shape).faces()) if abs(abs(f.center().Z) - 7) < 1e-9]
    assert len(numbers) == 2
    assert sorted(bd.Face(f).center().Z for f in resolve_open_faces(body, numbers)) == pytest.approx([-7, 7])


def test_what_can_not_stay_open_is_refused() -> None:
    for faces, words in (([bd.Face.make_rect(2, 2)], "no face of"), ([0], "not planar")):
        with pytest.raises(tpmscad.InvalidRequest, match=words):
            tpmscad.infill(bd.Cylinder(7, 14), **P, skin=SKIN, open_faces=faces)
