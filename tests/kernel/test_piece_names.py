"""Pieces of one thing are named by their place, in the files as well."""

from __future__ import annotations

import re
from pathlib import Path

import build123d as bd
import pytest

import tpmscad
from tpmscad.brep.solid_names import describe_place, name_pieces, strip_place
from tpmscad.kernel.occt.exploration import vertices_of

pytestmark = pytest.mark.kernel

BOX = ((0.0, 0.0, 0.0), (30.0, 30.0, 30.0))


@pytest.mark.parametrize(
    ("point", "place"),
    [
        ((29, 1, 2), "X+ Y- Z-"),
        ((15, 15, 29), "middle Z+"),
        ((11, 19, 14), "middle"),
        ((1, 15, 29), "middle X- Z+"),
    ],
)
def test_a_place_names_the_sides_of_the_box_that_are_near(point: tuple[float, ...], place: str) -> None:
    assert describe_place(point, BOX) == place


def test_a_flat_box_has_no_sides_across() -> None:
    assert describe_place((9, 1, 0), ((0, 0, 0), (10, 10, 0))) == "middle X+ Y-"


def test_the_place_is_no_part_of_the_name_of_the_whole() -> None:
    names = ("wall (X+ Y- Z-)", "wall (X+ Y- Z- 2)", "wall 2", "wall", "channel +", "part (v2) (middle)")
    assert [*map(strip_place, names)] == ["wall", "wall", "wall", "wall", "channel +", "part (v2)"]


def test_loose_pieces_are_found_in_the_file_where_their_names_say(tmp_path: Path) -> None:
    model = tpmscad.lattice("gyroid", cell=8, thickness=0.8, phase=(0, 0, 0), loose="keep", tol=0.1, progress=False)
    model.export_step(tmp_path / "a.step")
    names = re.findall(r"MANIFOLD_SOLID_BREP\('([^']*)'", (tmp_path / "a.step").read_text())
    assert names == [solid.name for solid in model.named_solids()]
    _, *chips = bd.import_step(tmp_path / "a.step").solids()
    assert len(chips) == 2
    for name, solid in zip(names[1:], chips, strict=True):
        at = solid.center(bd.CenterOf.MASS) - bd.Vector(4, 4, 4)
        place = " ".join(axis + ("+" if value > 0 else "-") for axis, value in zip("XYZ", at, strict=True))
        assert name == f"{model.name} ({place})"
    assert names[0] == model.name


def test_companions_in_one_place_are_numbered() -> None:
    boxes = [vertices_of((bd.Pos(x, 0, 0) * bd.Box(1, 1, 1)).wrapped) for x in (0, 8, 9.5, -9)]
    assert name_pieces("wall", boxes) == [
        "wall",
        "wall (middle X+)",
        "wall (middle X+ 2)",
        "wall (middle X-)",
    ]
