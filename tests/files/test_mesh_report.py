"""Files of triangles are reported and drawn as they are: closed or with their open sides, in pieces, inside out."""

from __future__ import annotations

import json
from pathlib import Path

import build123d as bd
import numpy as np
import pytest
import trimesh

import tpmscad
from tests.cli.test_cli import run
from tpmscad.brep.triangles.smooth_groups import label_smooth_groups
from tpmscad.errors import InvalidRequest
from tpmscad.file_suffixes import READ_TRIANGLE_SUFFIXES
from tpmscad.kernel.render.scene import Scene
from tpmscad.result_display import MAX_LINES

pytestmark = pytest.mark.kernel

SIZE = (2.0, 3.0, 5.0)


def write(file: Path, *, without: int = 0, copies: int = 1, flip: bool = False) -> Path:
    """A box of 2 x 3 x 5, without its first triangles, copied along x, inside out if asked for."""
    parts = []
    for k in range(copies):
        part = trimesh.creation.box(SIZE)
        part.apply_translation([10.0 * k, 0, 0])
        parts.append(part)
    box = trimesh.util.concatenate(parts)
    faces = box.faces[without:]
    trimesh.Trimesh(box.vertices, faces[:, ::-1] if flip else faces, process=False).export(file)
    return file


@pytest.mark.parametrize("suffix", READ_TRIANGLE_SUFFIXES)
def test_a_closed_mesh_of_every_format_is_ok_with_its_figures(suffix: str, tmp_path: Path) -> None:
    found = tpmscad.check_step(write(tmp_path / f"box{suffix}", copies=2))
    assert (found.ok, found.triangles, found.points, found.pieces, found.open_sides) == (True, 24, 16, 2, 0)
    assert found.volume == pytest.approx(60.0, rel=1e-6)
    assert found.area == pytest.approx(124.0, rel=1e-6)
    np.testing.assert_allclose(found.bounds, [(-1, -1.5, -2.5), (11, 1.5, 2.5)], atol=1e-6)
    assert found.healing == ()
    assert any("no length unit" in note for note in found.notes) == (suffix != ".3mf")


@pytest.mark.parametrize(("without", "sides"), [(1, 3), (2, 4)])
def test_an_open_mesh_has_no_volume_but_a_number_of_open_sides(without: int, sides: int, tmp_path: Path) -> None:
    found = tpmscad.check_step(write(tmp_path / "box.stl", without=without))
    assert (found.ok, found.open_sides, found.volume) == (False, sides, None)
    assert f"OPEN, not watertight: {sides} sides of triangles have no neighbour" in found.summary()
    assert found.healing[0].startswith("impossible: box.stl is open")
    assert "\narea        " in found.summary()
    assert len(repr(found).splitlines()) <= MAX_LINES
    assert json.loads(json.dumps(found.to_dict()))["open_sides"] == sides
    assert "<th>NOT ok</th>" in found._repr_html_()


def test_a_mesh_inside_out_is_not_ok_and_its_repair_is_told(tmp_path: Path) -> None:
    found = tpmscad.check_step(write(tmp_path / "box.ply", flip=True))
    assert (found.ok, found.volume) == (False, pytest.approx(-30.0))
    assert "INSIDE OUT" in found.summary()
    assert found.healing == ("box.ply was inside out: its triangles were reversed",)


def test_triangles_without_area_are_told(tmp_path: Path) -> None:
    (tmp_path / "box.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 0\nf 1 2 3\nf 1 4 2\n")
    found = tpmscad.check_step(tmp_path / "box.obj")
    assert found.triangles == 1
    assert "warning     box.obj: 1 of 2 triangles have two corners at one place" in found.summary()


def test_neighbours_that_hardly_bend_are_one_smooth_face() -> None:
    box, ball = trimesh.creation.box(SIZE), trimesh.creation.icosphere(2)
    assert len(set(label_smooth_groups(box.vertices, box.faces, 30.0).tolist())) == 6
    assert len(set(label_smooth_groups(ball.vertices, ball.faces, 30.0).tolist())) == 1


@pytest.mark.parametrize("without", [0, 2])
def test_a_mesh_is_drawn_as_it_is(without: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scenes: list[Scene] = []
    monkeypatch.setattr("tpmscad.studies.mesh_picture.draw_scene", lambda scene, **how: scenes.append(scene) or b"png")
    picture = tmp_path / "box.png"
    tpmscad.render_step(write(tmp_path / "box.stl", without=without, copies=2), picture, color_by="piece")
    assert picture.read_bytes() == b"png"
    (scene,) = scenes
    assert len(scene.triangles) == 24 - without
    assert scene.closed.tolist() == [without == 0]
    assert len(np.unique(scene.colours, axis=0)) == 2
    assert np.abs(scene.normals).max(axis=1) == pytest.approx(1.0)  # the edges of a box are sharp
    for refused in ({"color_by": "tag"}, {"hide": "wall"}):
        with pytest.raises(InvalidRequest, match="which a file of triangles has not"):
            tpmscad.render_step(tmp_path / "box.stl", picture, **refused)


def test_commands_take_triangles_and_brep(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    bd.export_brep(bd.Box(*SIZE), "box.brep")
    write(Path("box.stl"))
    write(Path("open.stl"), without=1)
    for file in ("box.stl", "box.brep"):
        assert run(f"check {file} --report found.json") == 0
        assert json.loads(Path("found.json").read_text())["volume"] == pytest.approx(30.0)
        assert run(f"render {file} --size 80x60 -o {file}.png") == 0
        assert Path(f"{file}.png").read_bytes().startswith(b"\x89PNG")
    assert run("check open.stl") == 1
    assert "open.stl fails the check" in capsys.readouterr().err
    assert run("render open.stl --section z=0 --size 80x60 -o open.png") == 0
    assert run("check box.stl --metrics") == 2
    assert "which the triangles of box.stl are not" in capsys.readouterr().err
    assert run("check box.stl --faces") == 2
    assert "--faces and --solid are of CAD files" in capsys.readouterr().err
