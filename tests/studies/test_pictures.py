"""Pictures of results, shapes and files: what the colours say, and what is refused."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import build123d as bd
import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

import tpmscad
from tpmscad.errors import InvalidRequest
from tpmscad.kernel.render.picture import draw_scene
from tpmscad.kernel.step.face_labels import NamedSolid
from tpmscad.studies import _render
from tpmscad.studies._render import find_pieces, render_bytes

pytestmark = pytest.mark.kernel

RED, BLUE = (0.9, 0.1, 0.1), (0.1, 0.2, 0.9)


def decode(picture: bytes) -> NDArray[np.float64]:
    """Colours (height, width, 3) of a picture, from 0 to 1."""
    return np.asarray(Image.open(BytesIO(picture)).convert("RGB"), float) / 255


def two_boxes() -> bd.Compound:
    """A small box left of a tall one, side by side."""
    return bd.Compound([bd.Box(2, 2, 2).solid(), (bd.Pos(4, 0, 1) * bd.Box(2, 2, 4)).solid()])


def hues(picture: bytes) -> tuple[int, int]:
    """Hues of the left and of the right part of the middle row: 0 for red, 1 for green, 2 for blue."""
    image = decode(picture)
    row = image[image.shape[0] * 6 // 10]
    return int(np.argmax(row[len(row) // 4])), int(np.argmax(row[3 * len(row) // 4]))


def test_every_solid_has_its_own_colour_when_coloured_by_piece() -> None:
    plain, coloured = (
        decode(render_bytes(two_boxes(), view="front", size=(200, 160), color_by=c)) for c in (None, "piece")
    )
    left, right = (coloured[100, x] for x in (50, 150))
    assert np.abs(left - right).max() > 0.2
    assert np.abs(plain[100, 50] - plain[100, 150]).max() < 0.05


def test_the_children_of_an_assembly_are_pieces_by_their_labels() -> None:
    wall, fluid, plain = bd.Box(1, 1, 1), bd.Pos(3, 0, 0) * bd.Sphere(1), bd.Pos(6, 0, 0) * bd.Box(1, 1, 2)
    wall.label, fluid.label = "wall", "fluid"
    pieces = find_pieces(bd.Compound(children=[wall, fluid, plain]), with_groups=True)
    assert [piece.name for piece in pieces] == ["wall", "fluid", "piece 3"]
    assert [bd.Solid(piece.shape).volume for piece in pieces] == pytest.approx([1.0, 4 / 3 * np.pi, 2.0])
    assert [piece.name for piece in find_pieces(wall + plain, with_groups=True)] == ["piece", "piece 2"]


def test_the_colours_in_a_file_are_shown_unless_others_are_asked_for(tmp_path: Path) -> None:
    small, tall = two_boxes().solids()
    small.color, tall.color = bd.Color(*RED), bd.Color(*BLUE)
    small.label, tall.label = "left", "right"
    path = tmp_path / "pair.step"
    bd.export_step(bd.Compound(children=[small, tall], label="pair"), path)
    tpmscad.render_step(path, tmp_path / "pair.png", view="front", size=(200, 160))
    assert hues((tmp_path / "pair.png").read_bytes()) == (0, 2)
    assert hues(render_bytes(path, view="front", size=(200, 160), hide="left"))[0] != 0
    with pytest.raises(InvalidRequest, match="no piece 'top' to hide; the pieces are 'left', 'right'"):
        render_bytes(path, hide="top")


def test_domains_have_their_colours_by_default_and_a_key() -> None:
    small, tall = two_boxes().solids()
    solids = [NamedSolid("a", small.wrapped, (), RED), NamedSolid("b", tall.wrapped, (), BLUE)]
    parts = SimpleNamespace(named_solids=lambda: solids)
    assert hues(render_bytes(parts, view="front", size=(200, 160))) == (0, 2)
    with_key = decode(render_bytes(parts, view="front", size=(400, 320)))
    assert with_key[:40, :20].min() < 0.6  # the squares of the key in the upper corner


def test_colours_of_values_come_with_a_scale_that_leaves_the_body_room() -> None:
    picture = decode(render_bytes(bd.Sphere(2), color_by="curvature", size=(400, 300)))
    assert np.ptp(picture[60:240, 300:330].reshape(-1, 3), axis=0).max() > 0.5  # the bar
    red, _, blue = picture[150, 140]
    assert red > blue + 0.1  # 1/2 at every point, the upper end


@pytest.mark.slow
def test_the_deviation_of_a_lattice_is_shown_up_to_the_certificate_s_and_only_on_its_surfaces(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    model = tpmscad.lattice("schwarz_p", cell=10, thickness=1, tol=0.05)
    drawn: list[Any] = []
    draw = draw_scene
    monkeypatch.setitem(
        vars(_render),
        "draw_scene",
        lambda scene, **options: (drawn.append((scene, options)), draw(scene, **options))[1],
    )
    render_bytes(model, color_by="deviation", size=(64, 64))
    scene, options = drawn[0]
    assert options["scale"].greatest == pytest.approx(model.certificate.max_deviation, rel=0.05)
    assert not scene.has_spline().all()  # the caps
    np.testing.assert_array_equal(np.isnan(scene.values), ~scene.has_spline()[scene.face])
    assert {group for piece in find_pieces(model, with_groups=True) for group in piece.face_groups} == {
        "surface +",
        "surface -",
        "cap",
    }
