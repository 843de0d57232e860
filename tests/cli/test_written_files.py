"""Every command that writes a file ends with the line that names it, with its size and the time of the whole command."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

import pytest

import tpmscad
from tests.cli.test_cli import Certificate, run
from tpmscad import cli


class Result(SimpleNamespace):
    """Stands for any result: it has every figure, and writes nine bytes."""

    name = "part"
    cell_groups = ("wall", "channel +")
    facet_groups = periodic = notes = triangles = ()
    cells: ClassVar[dict[str, Any]] = {}
    points = ()
    certificate = Certificate()
    met = True
    n_contours = n_points = volume = chord_error = unresolved = mismatch = 0
    deviation = area = center_of_mass = n_pieces = whole_cells = cut_cells = 0

    def __len__(self) -> int:
        return 1

    def __str__(self) -> str:
        return "the figures"

    def to_dict(self) -> dict[str, Any]:
        return {}

    def summary(self, *, verbose: bool) -> str:
        return str(self)

    def write(self, path: Path, **options: Any) -> None:
        path.write_text("nine byte")

    def export(self, path: Path, **options: Any) -> Any:
        self.write(path)
        told = "12 triangles within 0.018 mm of the faces" if path.suffix == ".stl" else ""
        return SimpleNamespace(triangles=12 if told else 0, deviation=0.018, summary=lambda: told)


def write_both(*arguments: Any, **options: Any) -> Result:
    """Writes the files among the arguments, two for a pattern."""
    files = [path for path in map(Path, map(str, arguments)) if path.suffix in (".png", ".csv", ".step")]
    parts = [Path(str(files[-1]).format(i)) for i in range(2)] if "{" in str(files[-1]) else files[-1:]
    for part in parts:
        part.write_text("nine byte")
    return Result(paths=tuple(parts))


LINES = {
    "lattice gyroid --cell 10 -o part.step": "part.step, 9 bytes",
    "lattice gyroid --cell 10 --instanced -o part.step": "part.step, 9 bytes",
    "lattice gyroid --cell 10 --slab 1 -o part_{}.step": "part_{}.step, 18 bytes in 2 files",
    "struts octet --cell 10 -o part.stl": "part.stl, 9 bytes, 12 triangles within 0.018 mm of the faces",
    "infill body.step gyroid --cell 10 -o part.brep": "part.brep, 9 bytes",
    "infill body.step gyroid --cell 10 --layer 0.1 -o part.cli": "part.cli, 9 bytes",
    "infill body.step gyroid --cell 10 --triangles -o part.stl": "part.stl, 9 bytes",
    "domains body.step gyroid --cell 10 -o part.step": "part.step, 9 bytes",
    "sweep table.csv -o results.csv": "results.csv, 9 bytes",
    "solidify recipe.toml -o part.step": "part.step, 9 bytes",
    "blend recipe.toml -o part.step": "part.step, 9 bytes",
    "template solidify -o mine.toml": r"mine.toml, [\d.]+ kB",
    "render body.step -o part.png": "part.png, 9 bytes",
    "slice body.step --height 1 -o part.svg": "part.svg, 9 bytes",
    "mesh body.step --size 1 -o part.msh": "part.msh, 9 bytes",
    "homogenize gyroid --porosity 0.7 -o part.inp": "part.inp, 9 bytes",
}


@pytest.fixture
def results(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Every public function returns a result at once."""
    monkeypatch.chdir(tmp_path)
    for name in ("lattice", "struts", "infill", "infill_layers", "infill_triangles", "fluid_domains", "homogenize"):
        monkeypatch.setitem(vars(tpmscad), name, lambda *arguments, **request: Result())
    for name in ("export_instances", "export_slabs", "render_step", "sweep"):
        monkeypatch.setitem(vars(tpmscad), name, write_both)
    made = SimpleNamespace(make=lambda progress: (Result(), {}), describe=lambda: ("the plan", {}))
    reader = SimpleNamespace(read=lambda *arguments, **options: made)
    stand_ins = {
        "tpmscad.studies._slice_step": {"slice_step": lambda *arguments, **options: Result()},
        "tpmscad.studies._mesh_step": {"mesh_step": lambda *arguments, **options: Result()},
        "tpmscad.recipe.recipe_runs": {"SolidRun": reader, "BlendRun": reader},
    }
    for module, content in stand_ins.items():
        monkeypatch.setitem(sys.modules, module, SimpleNamespace(**content))
    for name in ("body.step", "table.csv", "recipe.toml"):
        Path(name).touch()


@pytest.mark.parametrize("line", LINES)
def test_the_file_that_was_written_is_told(line: str, results: None, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(line) == 0
    last = capsys.readouterr().out.splitlines()[-1]
    assert re.fullmatch(rf"wrote       {LINES[line]}, after [\d.]+ s in all".replace("{}", r"\{\}"), last), last


def test_a_report_tells_the_deviation_of_a_mesh(results: None) -> None:
    assert run("struts octet --cell 10 -o part.stl --report part.json --quiet") == 0
    assert json.loads(Path("part.json").read_text())["mesh"] == {"triangles": 12, "deviation": 0.018}


@pytest.mark.parametrize("line", [line for line in LINES if not line.startswith("lattice")])
def test_quiet_commands_say_nothing(line: str, results: None, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(f"{line} --quiet") == 0
    assert capsys.readouterr().out == ""


def test_the_lines_above_are_of_every_command_that_writes() -> None:
    writing = {
        c.name for c in cli.COMMANDS if "output" in c.load().__annotations__ or "writing" in c.load().__annotations__
    }
    assert writing == {line.split()[0] for line in LINES}


@pytest.mark.parametrize("command", ["blend", "solidify"])
def test_a_dry_run_writes_nothing_and_says_so(command: str, results: None, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(f"{command} recipe.toml --dry-run -o part.step") == 0
    assert capsys.readouterr().out == "the plan\nfile        part.step would be written\n"
    assert not Path("part.step").exists()


def test_a_template_does_not_overwrite_a_recipe(results: None, capsys: pytest.CaptureFixture[str]) -> None:
    Path("mine.toml").write_text("changed")
    assert run("template solidify -o mine.toml") == 2
    assert "mine.toml exists and may be your own work: give --output another name" in capsys.readouterr().err
    assert Path("mine.toml").read_text() == "changed"
    assert run("template sweep -o designs.toml") == 2
