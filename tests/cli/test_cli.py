"""The command line's own promises, with a recorder for the public functions: options, exit status, what is left behind."""

from __future__ import annotations

import io
import json
import os
import re
import shlex
import subprocess
import sys
from importlib import import_module
from inspect import signature
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import typer

import tpmscad
from tpmscad import cli, maps, progress_display
from tpmscad.catalogue import CATALOGUE
from tpmscad.cli import output
from tpmscad.errors import InvalidRequest, KernelError, NotMet
from tpmscad.meshing.volume_mesh import VolumeMesh

ROOT = Path(__file__).resolve().parents[2]
LINE = re.compile(r"^  tpmscad (.+)$", re.MULTILINE)
HELP_LINES = [line for command in cli.make_app().registered_commands for line in LINE.findall(command.epilog or "")]
COMMAND_NAMES = [str(command.name) for command in cli.make_app().registered_commands]
SHELL = re.compile(r"^```sh\n(.*?)^```$", re.MULTILINE | re.DOTALL)
COMMAND = re.compile(r"^(?:.* && )?tpmscad (.+?)(?: +#.*)?$", re.MULTILINE)
DOCUMENTED_LINES = [
    line
    for page in (ROOT / "README.md", *sorted((ROOT / "docs" / "guide").glob("*.md")))
    for block in SHELL.findall(page.read_text())
    for line in COMMAND.findall(block)
]


class Certificate:
    def __init__(self, met: bool = True) -> None:
        self.met = met
        self.shortfalls = () if met else ("deviation 0.0625 exceeds tol 0.01", "not closed")

    def to_dict(self) -> dict[str, Any]:
        return {"met": self.met, "max_deviation": 0.0625}

    def summary(self, *, verbose: bool) -> str:
        return "met, all of it" + (", bound 0.25" if verbose else "")


class Recorder:
    """Stands for the public functions: notes how it was called and does what `outcome` says."""

    def __init__(self) -> None:
        self.called: dict[str, Any] = {}
        self.outcome: Certificate | Exception = Certificate()

    def make(self, *operands: Any, **request: Any) -> Any:
        progress = request.pop("progress")  # never None, which would leave the bar to the function
        progress("make", 0.5)
        self.called = {"operands": operands, **request}
        if isinstance(self.outcome, Exception):
            raise self.outcome
        return SimpleNamespace(certificate=self.outcome, export=self.export)

    def export(self, path: Path, **how: Any) -> Any:
        self.called |= {"file": path.name, **how}
        path.write_text("ISO-10303-21;")
        return SimpleNamespace(triangles=0, summary=lambda: "")

    def export_instances(self, surface: str, path: Path, **request: Any) -> Any:
        self.called = {"operands": (surface, path), **request}
        path.write_text("ISO-10303-21;")
        return SimpleNamespace(to_dict=lambda: {"copies": 8000}, summary=lambda verbose: "8000 copies")

    def check_step(self, path: Path, *, faces: bool, solid: int | None) -> Any:
        ok = "bad" not in path.name

        class Found(SimpleNamespace):
            def summary(self, *, verbose: bool) -> str:
                return "ok" if self.ok else "NOT ok"

            def to_dict(self) -> dict[str, Any]:
                return {"ok": self.ok}

        return Found(ok=ok)

    def render_step(self, path: Path, picture: Path, **how: Any) -> None:
        self.called = how
        picture.write_bytes(b"\x89PNG")

    def slice_step(self, path: Path, height: float, chord_error: float | None) -> Any:
        class Found(SimpleNamespace):
            def __len__(self) -> int:
                return 1

            def write(self, output: Path) -> None:
                output.write_text("$$HEADERSTART")

        self.called = {"height": height, "chord_error": chord_error}
        return Found(n_contours=1, n_points=3, volume=1.0, chord_error=chord_error, unresolved=0)


@pytest.fixture
def recorder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Recorder:
    stand_in = Recorder()
    for name in ("lattice", "infill", "fluid_domains", "struts"):
        monkeypatch.setitem(vars(tpmscad), name, stand_in.make)
    for name in ("check_step", "export_instances", "render_step"):
        monkeypatch.setitem(vars(tpmscad), name, getattr(stand_in, name))
    monkeypatch.setitem(sys.modules, "tpmscad.studies._slice_step", SimpleNamespace(slice_step=stand_in.slice_step))
    monkeypatch.chdir(tmp_path)
    return stand_in


def run(line: str) -> int:
    with pytest.raises(SystemExit) as stop:
        cli.main(shlex.split(line))
    return int(stop.value.code or 0)


LATTICE = "lattice gyroid --cell 10 -o out.step"


def test_every_option_of_lattice_reaches_the_workflow(recorder: Recorder) -> None:
    assert (
        run(
            "lattice gyroid --cell 10,10,14 --cells 2,3,4 --offset -0.6,0.4 --tol 0.01 --kind skeletal --side + "
            "--reference nodal --boundary natural --phase 0.125,0,-0.5 --keep-loose --schema ap214 -o out.step"
        )
        == 0
    )
    assert recorder.called == {
        "operands": ("gyroid",),
        "cell": (10.0, 10.0, 14.0),
        "cells": (2, 3, 4),
        "offset": (-0.6, 0.4),
        "tol": 0.01,
        "kind": "skeletal",
        "side": "+",
        "reference": "nodal",
        "boundary": "natural",
        "phase": (0.125, 0.0, -0.5),
        "loose": "keep",
        "file": "out.step",
        "schema": "ap214",
    }


def test_instanced_asks_for_copies_of_one_cell(recorder: Recorder, capsys: pytest.CaptureFixture[str]) -> None:
    line = "lattice gyroid --cell 10 --cells 20 --thickness 1 --instanced --verify kernel --report out.json -o out.step"
    assert run(line) == 0
    called = {key: value for key, value in recorder.called.items() if key != "progress"}
    assert called == {
        "operands": ("gyroid", Path("out.step")),
        "cell": 10.0,
        "cells": 20,
        "thickness": 1.0,
        "schema": "ap242",
        "verify": "kernel",
    }
    assert capsys.readouterr().out.startswith("8000 copies\nwrote       out.step, 13 bytes, ")
    assert json.loads(Path("out.json").read_text()) == {"copies": 8000}


def test_every_option_of_infill_reaches_the_workflow(recorder: Recorder) -> None:
    for name in ("part.step", "bosses.step", "bolts.step"):
        Path(name).touch()
    line = (
        'infill part.step P --porosity 0.7 --pore-size 0.6 --skin 1.5 --open-faces ">Z, 3" --rotation 0,0,45 '
        "--keep bosses.step --clear bolts.step --deviation 0.05 -o out.3mf"
    )
    assert run(line) == 0
    called = recorder.called
    assert called["operands"] == (Path("part.step"), "P")
    expected = {
        "porosity": 0.7,
        "pore_size": 0.6,
        "skin": 1.5,
        "open_faces": ">Z, 3",
        "rotation": (0.0, 0.0, 45.0),
        "keep": Path("bosses.step"),
        "clear": Path("bolts.step"),
        "deviation": 0.05,
    }
    assert {name: called[name] for name in expected} == expected
    assert run(line.replace("bosses.step", "bosses,3,2.5")) == 0
    assert recorder.called["keep"] == ("bosses", 3.0, 2.5)
    assert run(line.replace("bosses.step", "bosses.step,bosses,3")) == 0
    assert recorder.called["keep"] == [Path("bosses.step"), ("bosses", 3.0)]
    assert run(line.replace("bosses.step", "bosses,wide")) == 2


def test_domains_asks_for_the_fluid_domains_of_the_body(recorder: Recorder) -> None:
    Path("body.step").touch()
    assert run("domains body.step gyroid --cell 8 --thickness 0.8 -o out.brep --quiet") == 0
    called = recorder.called
    assert (called["operands"], called["cell"], called["thickness"]) == ((Path("body.step"), "gyroid"), 8.0, 0.8)


def test_openings_are_given_channel_by_channel(recorder: Recorder) -> None:
    Path("body.step").touch()
    call = "domains body.step gyroid --cell 8 --thickness 0.8 --open +=<X,>X --open -=<Y --open -=3 --transition 6"
    assert run(f"{call} -o out.brep --quiet") == 0
    assert recorder.called["openings"] == {"+": "<X,>X", "-": "<Y,3"}
    assert recorder.called["transition"] == 6.0
    assert run("domains body.step gyroid --cell 8 --thickness 0.8 --open X -o out.brep --quiet") == 2


@pytest.mark.kernel
@pytest.mark.parametrize("name", ["lattice", "infill", "fluid_domains"])
def test_options_left_out_keep_the_defaults_of_the_function(recorder: Recorder, name: str) -> None:
    real = getattr(import_module(f"tpmscad.solids._{name}"), name)  # what the recorder stands for
    Path("part.step").touch()
    start = {
        "lattice": "lattice gyroid",
        "infill": "infill part.step gyroid",
        "fluid_domains": "domains part.step gyroid",
    }
    assert run(f"{start[name]} --cell 10 -o out.step --quiet") == 0
    defaults = {key: p.default for key, p in signature(real).parameters.items()}
    for key, value in recorder.called.items():
        if key not in ("operands", "cell", "file"):
            assert value == defaults[key], key


@pytest.mark.parametrize(
    ("text", "radius"), [("cylinder", 10 * 12 / (2 * np.pi)), ("cylinder:30", 30.0), ("sphere:40", 40.0)]
)
def test_a_map_wraps_the_lattice_or_closes_the_ring(recorder: Recorder, text: str, radius: float) -> None:
    assert run(f"lattice P --cell 10 --cells 12,1,1 --thickness 1 --map {text} -o out.step --quiet") == 0
    assert recorder.called["boundary"] == "natural"  # the box of a lattice has no flat faces when it is wrapped
    make = maps.sphere if text.startswith("sphere") else maps.cylinder
    points = np.random.default_rng(0).uniform(0, 5, (20, 3))
    np.testing.assert_array_equal(recorder.called["map"].function(points), make(radius).function(points))


def test_a_map_makes_a_stent_of_a_net(recorder: Recorder) -> None:
    assert run("struts rhombic-net --cell 3,1,2 --cells 12,1,4 --diameter 0.3 --map cylinder -o out.step --quiet") == 0
    points = np.random.default_rng(0).uniform(0, 5, (20, 3))
    ring = maps.cylinder(36 / (2 * np.pi)).function(points)
    np.testing.assert_array_equal(recorder.called["map"].function(points), ring)


@pytest.mark.parametrize("text", ["torus:3", "sphere", "cylinder:wide", "cylinder:0"])
def test_a_map_that_is_not_understood_is_bad_usage(
    recorder: Recorder, capsys: pytest.CaptureFixture[str], text: str
) -> None:
    assert run(f"lattice P --cell 10 --thickness 1 --map {text} -o out.step") == 2
    assert "radius" in capsys.readouterr().err.lower()
    assert not recorder.called


def test_what_is_made_and_met_ends_in_0_with_file_and_report(recorder: Recorder) -> None:
    assert run(f"{LATTICE} --volume-fraction 0.3 --report out.json") == 0
    assert json.loads(Path("out.json").read_text()) == {"met": True, "max_deviation": 0.0625}
    assert sorted(os.listdir()) == ["out.json", "out.step"]


def test_verbose_tells_the_bounds(recorder: Recorder, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(f"{LATTICE} --verbose") == 0
    assert capsys.readouterr().out.startswith("met, all of it, bound 0.25\nwrote ")


@pytest.mark.parametrize("command", ["lattice gyroid", "infill part.step gyroid", "domains part.step gyroid"])
def test_a_command_tells_the_result_unless_it_is_quiet(
    recorder: Recorder, capsys: pytest.CaptureFixture[str], command: str
) -> None:
    Path("part.step").touch()
    assert run(f"{command} --cell 10 -o out.step") == 0
    told, complaints = capsys.readouterr()
    assert re.fullmatch(r"met, all of it\nwrote       out\.step, 13 bytes, after [\d.]+ s in all\n", told)
    assert complaints == ""
    assert run(f"{command} --cell 10 -o out.step --quiet") == 0
    assert capsys.readouterr() == ("", "")
    assert run(f"{command} --cell 10 -o out.step --quiet --progress lines") == 0
    steps = ('{"stage": "make", "done": 0.5}', '{"stage": "write", "done": 0.0}')
    assert capsys.readouterr() == ("", "\n".join([*steps, ""]))


def test_mesh_reports_what_was_made(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    Path("part.step").touch()
    corners = 2.0 * np.vstack([np.zeros(3), np.eye(3)])
    made = VolumeMesh(
        corners,
        {"tetra": np.arange(4)[None]},
        {"triangle": np.array([[1, 2, 3]])},
        {"solid": np.array([0])},
        {"cap X+": np.array([0])},
        collapsed=3,
    )
    monkeypatch.setitem(sys.modules, "tpmscad.studies._mesh_step", SimpleNamespace(mesh_step=lambda *_, **__: made))
    assert run("mesh part.step --size 0.8 -o part.msh --report part.json --quiet") == 0
    told = json.loads(Path("part.json").read_text())
    assert (told["cells"], told["nodes"]) == ({"tetra": 1}, 4)
    assert told["volume"] == pytest.approx(8 / 6)
    assert told["size"] == pytest.approx(1 + np.sqrt(2))
    assert (told["groups"], told["periodic"]) == (["solid", "cap X+"], [])
    assert (told["collapsed"], told["swapped"], told["straightened"]) == (3, 0, 0)
    assert 0 < told["smallest_scaled_jacobian"] < 1


@pytest.mark.parametrize(
    ("outcome", "status", "words"),
    [
        (Certificate(met=False), 1, "0.0625 exceeds tol 0.01; not closed"),
        (NotMet("no fit\nwithin tol 1e-9", Certificate(met=False)), 1, "no fit within tol 1e-9"),
        (KernelError("BRepCheck", "not closed"), 1, "BRepCheck: not closed"),
        (PermissionError(13, "Permission denied", "out.step"), 1, "Permission denied"),
        (InvalidRequest("thickness 9 exceeds 3.2"), 2, "thickness 9 exceeds 3.2"),
    ],
    ids=["missed", "NotMet", "KernelError", "OSError", "InvalidRequest"],
)
def test_what_fails_says_one_line_and_leaves_no_model(
    recorder: Recorder,
    capsys: pytest.CaptureFixture[str],
    outcome: Certificate | Exception,
    status: int,
    words: str,
) -> None:
    recorder.outcome = outcome
    assert run(f"{LATTICE} --report out.json") == status
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert words in err
    missed = outcome.certificate if isinstance(outcome, NotMet) else outcome
    assert os.listdir() == (["out.json"] if isinstance(missed, Certificate) else [])


@pytest.mark.parametrize(
    "line",
    [
        "lattice gyroid --cell 10",
        "lattice gyroid --cell ten -o out.step",
        "lattice gyroid --cell 10 --cells 2,,2 -o out.step",
        "lattice gyroid --cell 10 --kind solid -o out.step",
        "lattice gyroid --cell 10 --colour red -o out.step",
        "lattice gyroid --cell 10 -o out.obj",
        "lattice gyroid --cell 10 -o folder.step",
        "lattice gyroid --cell 10 --deviation 0.1 -o out.step",
        "lattice gyroid --cell 10 --deviation -1 -o out.stl",
        "lattice gyroid --cell 10 --instanced -o out.stl",
        "infill part.step P --cell 10 --schema ap214 -o out.3mf",
        "domains part.step P --cell 10 -o out.stl",
        "lattice gyroid --cell 10 -o nowhere/out.step",
        "lattice gyroid --cell 10 -o out.step --report nowhere/out.json",
        "lattice gyroid --cell 10 -o out.step --report out.txt",
        "lattice gyroid --cell 10 -o out.step --report folder.json",
        "render part.step -o out.png --size 100",
        "solidify part.npy -o out.step",
        "template weave",
        "recipe-keys weave",
        "check missing.step",
        "render missing.step -o out.png",
        "weave gyroid",
    ],
)
def test_bad_usage_ends_in_2_before_anything_is_made(
    recorder: Recorder, capsys: pytest.CaptureFixture[str], line: str
) -> None:
    for name in ("folder.step", "folder.json"):
        Path(name).mkdir()
    for name in ("part.step", "part.npy"):
        Path(name).touch()
    before = sorted(os.listdir())
    assert run(line) == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert err.startswith("tpmscad: ")
    assert not recorder.called
    assert sorted(os.listdir()) == before


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ("--thickness 1 --jobs 2", "--jobs is the number of processes that make slabs: give --slab, too"),
        (
            "--thickness 1 --slab 2 --instanced",
            "--instanced stores the whole lattice in one file: leave it out of slabs",
        ),
        ("--thickness 1 --slab 2 --verify kernel", "slabs are verified by their text: leave --verify out"),
    ],
)
def test_options_that_do_not_go_together_are_refused_by_name(
    recorder: Recorder, capsys: pytest.CaptureFixture[str], options: str, words: str
) -> None:
    assert run(f"lattice gyroid --cell 10 --cells 4 {options} -o out.step") == 2
    assert words in capsys.readouterr().err
    assert not recorder.called
    assert os.listdir() == []


def test_a_ring_without_a_cell_or_a_radius_is_refused(recorder: Recorder, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("lattice P --pore-size 3 --thickness 1 --map cylinder -o out.step") == 2
    assert "a ring of whole cells needs --cell: give it, or the radius, cylinder:20" in capsys.readouterr().err
    assert not recorder.called


def test_check_ends_in_1_for_a_file_that_fails(recorder: Recorder, capsys: pytest.CaptureFixture[str]) -> None:
    Path("good.step").touch()
    Path("bad.step").touch()
    assert run("check good.step") == 0
    assert capsys.readouterr().err == ""
    assert run("check bad.step --report bad.json") == 1
    assert capsys.readouterr().err.count("\n") == 1
    assert json.loads(Path("bad.json").read_text()) == {"ok": False}


def test_render_writes_the_picture(recorder: Recorder) -> None:
    Path("part.step").touch()
    assert run("render part.step -o part.jpg") == 2
    assert run("render part.step -o part.png --report part.json") == 0
    assert json.loads(Path("part.json").read_text())["bytes"] == Path("part.png").stat().st_size
    assert recorder.called == {}
    assert run("render part.step --view 1,1,0.5 --section z=5 --size 1600x1200 --color-by piece -o part.png") == 0
    assert recorder.called == {"view": "1,1,0.5", "section": "z=5", "size": (1600, 1200), "color_by": "piece"}
    assert run('render part.step --hide wall --hide "channel +" -o part.png') == 0
    assert recorder.called == {"hide": ["wall", "channel +"]}


@pytest.mark.parametrize("line", [*DOCUMENTED_LINES, *HELP_LINES])
def test_an_example_in_readme_guide_or_help_is_good_usage(
    line: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    line = line.split(" > ")[0]  # into a file
    for name in (
        "gyroid.step",
        "scaffold.step",
        "bracket.step",
        "bosses.step",
        "bolts.step",
        "filled.step",
        "body.step",
        "exchanger.step",
        "density.npy",
        "rho.npy",
        "rho.vtu",
        "labels.nii",
        "scan.stl",
        "designs.csv",
        "exchangers.csv",
        "flow.toml",
        "implant.3mf",
    ):
        Path(name).touch()
    Path("examples").symlink_to(ROOT / "examples")
    group: Any = typer.main.get_command(cli.make_app())
    with group.make_context("tpmscad", shlex.split(line)) as context:  # parsed and validated, not run
        name, command, rest = group.resolve_command(context, shlex.split(line))
        command.make_context(name, rest, parent=context)


def test_help_on_any_command_loads_no_kernel() -> None:
    commands = [[], *([name] for name in COMMAND_NAMES)]
    script = (
        "import sys; from tpmscad import cli\n"
        f"for command in {commands!r}:\n"
        "    try: cli.main([*command, '--help'])\n"
        "    except SystemExit as stop: assert stop.code == 0, command\n"
        "print(sorted({'OCP', 'build123d', 'numpy'} & sys.modules.keys()), file=sys.stderr)"
    )
    answer = subprocess.run([sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, check=True)
    assert answer.stdout.count("Usage: ") == len(commands) > 5
    assert answer.stderr.strip() == "[]"


def test_every_command_has_an_example() -> None:
    assert {line.split()[0] for line in HELP_LINES} == set(COMMAND_NAMES)


def test_no_line_of_help_is_wider_than_the_terminal(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    for name in ("", *COMMAND_NAMES):
        assert run(f"{name} --help") == 0
        assert 40 < max(map(len, capsys.readouterr().out.splitlines())) <= 80


def test_surfaces_lists_the_catalogue_within_80_columns(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("surfaces") == 0
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= 80
    assert [line.split()[0] for line in lines[1 : len(CATALOGUE) + 1]] == list(CATALOGUE)
    assert run("surfaces --json") == 0
    rows = {row["name"]: row for row in json.loads(capsys.readouterr().out)}
    # the exact gyroid: its greatest curvature is known in closed form, through the catalogue's Bonnet angle
    assert rows["gyroid"]["thickest_wall"] == pytest.approx(0.37647151)
    assert rows["gyroid"]["formula"] == CATALOGUE["gyroid"].formula


def test_a_template_is_printed_as_it_is_kept(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("template blend") == 0
    assert capsys.readouterr().out == (ROOT / "tpmscad/recipe/templates/blend.toml").read_text()


def test_without_arguments_the_help_is_shown(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("") == 2
    out = capsys.readouterr().out
    assert all(name in out for name in COMMAND_NAMES)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "expected"),
    [("tpmscad inf", "infill"), ("tpmscad lattice gy", "gyroid"), ("tpmscad lattice P --kind sk", "skeletal")],
)
def test_the_shell_completes_commands_surfaces_and_choices(words: str, expected: str) -> None:
    asked = {
        "_TPMSCAD_COMPLETE": "complete_bash",
        "COMP_WORDS": words,
        "COMP_CWORD": str(len(words.split()) - 1),
    }
    script = "from tpmscad import cli; cli.main([])"
    answer = subprocess.run(
        [sys.executable, "-c", script], cwd=ROOT, env=os.environ | asked, capture_output=True, text=True, check=True
    )
    assert answer.stdout.split() == [expected]


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize(("delay", "shown"), [(60.0, False), (0.0, True)])
def test_the_bar_shows_on_a_terminal_only_after_its_delay(
    monkeypatch: pytest.MonkeyPatch, delay: float, shown: bool
) -> None:
    monkeypatch.setattr(progress_display, "DELAY_SECONDS", delay)
    monkeypatch.setenv("TERM", "xterm")
    terminal = Terminal()
    with monkeypatch.context() as patch:
        patch.setattr(sys, "stderr", terminal)
        with output.progress_bar("weaving", quiet=False) as progress:
            progress("knotting", 0.5)
    text = terminal.getvalue()
    assert ("knotting" in text) is shown
    assert shown or "\n" not in text.strip()


@pytest.mark.parametrize("quiet", [False, True])
def test_no_bar_where_nobody_watches(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], quiet: bool
) -> None:
    monkeypatch.setattr(progress_display, "DELAY_SECONDS", 0.0)
    with output.progress_bar("weaving", quiet=quiet) as progress:
        progress("knotting", 0.5)
    assert capsys.readouterr() == ("", "")


def test_progress_in_lines_is_json_for_each_percent_on_standard_error(capsys: pytest.CaptureFixture[str]) -> None:
    with output.progress_bar("weaving", quiet=True, form="lines") as progress:
        for done in (0.0, 0.251, 0.254, 1.0):
            progress("knotting", done)
        progress("hemming", 1.0)
    out, err = capsys.readouterr()
    knots = [{"stage": "knotting", "done": done} for done in (0.0, 0.25, 1.0)]
    assert out == ""
    assert list(map(json.loads, err.splitlines())) == [*knots, {"stage": "hemming", "done": 1.0}]
