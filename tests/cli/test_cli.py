"""The command line's own promises, with the workflows replaced by a recorder: options, exit status, what is left behind."""

from __future__ import annotations

import io
import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import typer

import tpmscad.workflows
from tpmscad import cli
from tpmscad.cli import output
from tpmscad.errors import InvalidRequest, KernelError, NotMet

ROOT = Path(__file__).resolve().parents[2]
LINE = re.compile(r"^  tpmscad (.+)$", re.MULTILINE)
HELP_LINES = [line for command in cli.app.registered_commands for line in LINE.findall(command.epilog or "")]
README_LINES = re.findall(r"^(?:.* && )?tpmscad (.+?)(?: +#.*)?$", (ROOT / "README.md").read_text(), re.MULTILINE)


class Certificate:
    def __init__(self, met: bool = True) -> None:
        self.met = met
        self.shortfalls = () if met else ("deviation 0.0625 exceeds tol 0.01", "not closed")

    def to_dict(self) -> dict[str, Any]:
        return {"met": self.met, "max_deviation": 0.0625}

    def __str__(self) -> str:
        return "met, all of it"


class Recorder:
    """Stands for the functions of tpmscad.workflows: notes how it was called and does what `outcome` says."""

    def __init__(self) -> None:
        self.called: dict[str, Any] = {}
        self.outcome: Certificate | Exception = Certificate()

    def lattice(self, surface: str, **request: Any) -> Any:
        self.called = {"surface": surface, **request}
        if isinstance(self.outcome, Exception):
            raise self.outcome
        return SimpleNamespace(certificate=self.outcome, export_step=self.export_step)

    def export_step(self, path: Path, **how: Any) -> None:
        self.called |= how
        path.write_text("ISO-10303-21;")

    def check_step(self, path: Path) -> Any:
        ok = "bad" not in path.name

        class Found(SimpleNamespace):
            def to_dict(self) -> dict[str, Any]:
                return {"ok": self.ok}

        return Found(ok=ok)

    def render_step(self, path: Path, picture: Path) -> None:
        picture.write_bytes(b"\x89PNG")


@pytest.fixture
def workflows(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Recorder:
    recorder = Recorder()
    for name in ("lattice", "check_step", "render_step"):
        monkeypatch.setitem(vars(tpmscad.workflows), name, getattr(recorder, name))
    monkeypatch.chdir(tmp_path)
    return recorder


def run(line: str) -> int:
    with pytest.raises(SystemExit) as stop:
        cli.main(shlex.split(line))
    return int(stop.value.code or 0)


LATTICE = "lattice gyroid --cell 10 -o out.step"


def test_every_option_of_lattice_reaches_the_workflow(workflows: Recorder) -> None:
    assert (
        run(
            "lattice gyroid --cell 10,10,14 --cells 2,3,4 --offset -0.6,0.4 --tol 0.01 --kind skeletal --side + "
            "--reference nodal --boundary natural --phase 0.125,0,-0.5 --instanced --schema ap214 -o out.step"
        )
        == 0
    )
    assert workflows.called == {
        "surface": "gyroid",
        "cell": (10.0, 10.0, 14.0),
        "cells": (2, 3, 4),
        "thickness": None,
        "offset": (-0.6, 0.4),
        "volume_fraction": None,
        "tol": 0.01,
        "kind": "skeletal",
        "side": "+",
        "reference": "nodal",
        "boundary": "natural",
        "phase": (0.125, 0.0, -0.5),
        "progress": None,
        "instanced": True,
        "schema": "ap214",
    }


def test_defaults_of_lattice_are_those_of_the_api(workflows: Recorder) -> None:
    assert run(f"{LATTICE} --thickness 1") == 0
    called = workflows.called
    assert (called["cell"], called["cells"], called["phase"], called["thickness"]) == (10.0, (1, 1, 1), (0, 0, 0), 1.0)
    assert [called[name] for name in ("kind", "side", "reference", "boundary", "instanced", "schema")] == [
        "sheet",
        "-",
        None,
        "box",
        False,
        "ap242",
    ]


def test_what_is_made_and_met_ends_in_0_with_file_and_report(
    workflows: Recorder, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(f"{LATTICE} --volume-fraction 0.3 --report out.json") == 0
    assert json.loads(Path("out.json").read_text()) == {"met": True, "max_deviation": 0.0625}
    assert sorted(os.listdir()) == ["out.json", "out.step"]
    assert capsys.readouterr() == ("met, all of it\n", "")


def test_quiet_says_nothing(workflows: Recorder, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(f"{LATTICE} --quiet") == 0
    assert capsys.readouterr() == ("", "")


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
    workflows: Recorder,
    capsys: pytest.CaptureFixture[str],
    outcome: Certificate | Exception,
    status: int,
    words: str,
) -> None:
    workflows.outcome = outcome
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
        "lattice gyroid --cell 10 -o out.stl",
        "lattice gyroid --cell 10 -o nowhere/out.step",
        "lattice gyroid --cell 10 -o out.step --report nowhere/out.json",
        "lattice gyroid --cell 10 -o out.step --report out.txt",
        "check missing.step",
        "render missing.step -o out.png",
        "weave gyroid",
    ],
)
def test_bad_usage_ends_in_2_before_anything_is_made(
    workflows: Recorder, capsys: pytest.CaptureFixture[str], line: str
) -> None:
    assert run(line) == 2
    assert capsys.readouterr().err
    assert not workflows.called
    assert not os.listdir()


def test_check_ends_in_1_for_a_file_that_fails(workflows: Recorder, capsys: pytest.CaptureFixture[str]) -> None:
    Path("good.step").touch()
    Path("bad.step").touch()
    assert run("check good.step") == 0
    assert capsys.readouterr().err == ""
    assert run("check bad.step --report bad.json") == 1
    assert capsys.readouterr().err.count("\n") == 1
    assert json.loads(Path("bad.json").read_text()) == {"ok": False}


def test_render_writes_the_picture(workflows: Recorder) -> None:
    Path("part.step").touch()
    assert run("render part.step -o part.jpg") == 2
    assert run("render part.step -o part.png --report part.json") == 0
    assert json.loads(Path("part.json").read_text())["bytes"] == Path("part.png").stat().st_size


@pytest.mark.parametrize("line", [*README_LINES, *HELP_LINES])
def test_an_example_in_readme_or_help_is_good_usage(line: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("gyroid.step", "bracket.step", "filled.step"):
        Path(name).touch()
    Path("examples").symlink_to(ROOT / "examples")
    group: Any = typer.main.get_command(cli.app)
    with group.make_context("tpmscad", shlex.split(line)) as context:  # parsed and validated, not run
        name, command, rest = group.resolve_command(context, shlex.split(line))
        command.make_context(name, rest, parent=context)


def test_help_on_any_command_loads_no_kernel() -> None:
    commands = [[], *([command.callback.__name__] for command in cli.app.registered_commands)]
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
    assert {line.split()[0] for line in HELP_LINES} == {c.callback.__name__ for c in cli.app.registered_commands}


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
    monkeypatch.setattr(output, "BAR_DELAY_SECONDS", delay)
    monkeypatch.setenv("TERM", "xterm")
    terminal = Terminal()
    with monkeypatch.context() as patch:
        patch.setattr(sys, "stderr", terminal)
        with output.progress_bar("weaving", quiet=False) as progress:
            assert progress is not None
            progress("knotting", 0.5)
    text = terminal.getvalue()
    assert ("knotting" in text) is shown
    assert shown or "\n" not in text.strip()


def test_no_bar_where_nobody_watches() -> None:
    with output.progress_bar("weaving", quiet=False) as progress:
        assert progress is None
