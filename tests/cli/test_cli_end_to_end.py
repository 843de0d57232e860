"""The command line with the real functions and the kernel: a lattice to a STEP file and back, and the requests it refuses."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import build123d as bd
import pytest

from tests.cli.test_cli import run
from tpmscad import check_step, export_beams, fields

pytestmark = pytest.mark.kernel

ROOT = Path(__file__).resolve().parents[2]


def tpmscad(*arguments: str, folder: Path) -> subprocess.CompletedProcess[str]:
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    return subprocess.run(
        [sys.executable, "-m", "tpmscad", *arguments], cwd=folder, env=environment, capture_output=True, text=True
    )


def list_warnings(error: str) -> list[str]:
    """The lines on standard error, but for the stages that a command tells where it takes long."""
    return [line for line in error.splitlines() if not line.endswith(" ...")]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """A folder with gyroid.step in it, and the report of making it."""
    folder = tmp_path_factory.mktemp("made")
    line = "lattice gyroid --cell 10 --thickness 1 --tol 0.02 -o gyroid.step --report gyroid.json"
    answer = tpmscad(*line.split(), folder=folder)
    told = [line for line in answer.stderr.splitlines() if not line.endswith(("...", "more"))]  # but for slow machines
    assert (answer.returncode, told) == (0, [])
    assert answer.stdout.startswith("met")
    assert sorted(os.listdir(folder)) == ["gyroid.json", "gyroid.step"]
    return folder, json.loads((folder / "gyroid.json").read_text())


def test_the_report_holds_the_certificate(made: tuple[Path, dict[str, Any]]) -> None:
    report = made[1]
    assert report["met"] is True
    assert report["max_deviation"] <= report["tol"] == 0.02
    # Steiner's formula for a symmetric sheet, 2 t A + 2 t^3 2 pi chi / 3 with t = 0.5, chi = -8 and A = 3.0915 cell edges squared
    assert report["volume"] == pytest.approx(309.15 - 4.19, rel=1e-3)


def test_check_finds_in_the_file_what_the_report_says(
    made: tuple[Path, dict[str, Any]], capfd: pytest.CaptureFixture[str]
) -> None:
    folder, report = made
    assert run(f"check {folder / 'gyroid.step'} --report {folder / 'check.json'}") == 0
    out, err = capfd.readouterr()
    assert list_warnings(err) == []
    assert "ok          valid, closed, the right way out\nsize        10 x 10 x 10 mm" in out
    assert "1 solid" in out
    found = json.loads((folder / "check.json").read_text())
    assert found["volume"] == pytest.approx(report["volume"], rel=1e-9)
    assert found["area"] == pytest.approx(report["area"], rel=1e-6)


def test_render_draws_a_picture_without_a_display(
    made: tuple[Path, dict[str, Any]], capfd: pytest.CaptureFixture[str]
) -> None:
    assert run(f"render {made[0] / 'gyroid.step'} -o {made[0] / 'gyroid.png'}") == 0
    assert list_warnings(capfd.readouterr().err) == []
    assert (made[0] / "gyroid.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("length", [0, 100, 100_000])
def test_check_of_a_file_that_is_no_step_or_cut_short_ends_in_an_error(
    made: tuple[Path, dict[str, Any]], tmp_path: Path, length: int, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "cut.step").write_bytes((made[0] / "gyroid.step").read_bytes()[:length])
    assert run(f"check {tmp_path / 'cut.step'}") == 2
    told = capfd.readouterr().err  # what the kernel itself writes there, too
    assert told.count("\n") == 1
    assert "cut.step" in told


def test_an_assembly_of_cells_is_made_on_request(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    line = "lattice schwarz_p --cell 10 --cells 3,2,1 --thickness 1 --tol 0.1 --instanced --schema ap214 -o p.step"
    assert run(line) == 0
    assert run("check p.step --report p.json") == 0
    assert json.loads((tmp_path / "p.json").read_text())["solids"] == 6


@pytest.mark.parametrize(
    ("request_line", "words"),
    [
        (
            "gyroid --cell 10 --cells 0,1,1 --thickness 1",
            "at least 1, or three, one for each axis, as in --cells 2,2,2",
        ),
        ("gyroid --cell 10 --thickness 9", "thickness below"),
        ("gyroid --cell 10 --thickness 1 --offset -0.5,0.5", "--thickness and --offset"),
        ("gyroid --cell 10 --volume-fraction 1.5", "--volume-fraction 1.5"),
    ],
)
def test_a_request_out_of_bounds_ends_in_2_naming_it(
    request_line: str,
    words: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(f"lattice {request_line} -o out.step") == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert words in err
    assert not os.listdir()


def test_a_file_of_beams_is_made_a_solid(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("lib3mf")
    monkeypatch.chdir(tmp_path)
    field = fields.struts([[0, 0, 0], [9, 0, 0], [0, 9, 0]], [[0, 1], [0, 2]], [[2.0, 1.0], [1.6, 1.6]])
    export_beams(field, "beams.3mf")
    assert run("solidify beams.3mf -o beams.step --report beams.json") == 0
    assert json.loads(Path("beams.json").read_text())["betti"] == [1, 0, 0]
    assert check_step("beams.step").shape.bounds[0] == pytest.approx((-1, -1, -1), abs=1e-6)
    assert run("solidify beams.3mf --level 0.5 -o out.step") == 2
    assert "--level: for images, not for beams" in capsys.readouterr().err


def test_the_field_of_a_recipe_fills_a_body(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Struts beyond all sides of a box: what is left is what the recipe's own domain, the same box, cuts from them."""
    monkeypatch.chdir(tmp_path)
    bd.export_step(bd.Pos(4, 2, 2) * bd.Box(8, 4, 4), "box.step")
    struts = 'kind = "strut_lattice"\nstructure = "cubic"\ncell = 4\ncells = [3, 2, 2]\ndiameter = 1\n'
    moved = f'[field]\nkind = "translate"\nvector = [-1, -1, -1]\nof = "struts"\n[fields.struts]\n{struts}'
    (tmp_path / "struts.toml").write_text(f"tol = 0.02\ndomain = [[0, 0, 0], [8, 4, 4]]\n{moved}")
    volumes = []
    for command in ("infill box.step struts.toml", "solidify struts.toml"):
        assert run(f"{command} -o out.step --report out.json") == 0
        volumes.append(json.loads(Path("out.json").read_text())["volume"])
    assert volumes[0] == pytest.approx(volumes[1], rel=1e-6)
    assert run("infill box.step none.toml -o out.step") == 2
    assert "none.toml" in capsys.readouterr().err
