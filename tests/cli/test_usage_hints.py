"""Words of other programs, and other orders, are answered with what is meant here."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import pytest

import tpmscad
from tests.cli.test_cli import Recorder, recorder, run  # noqa: F401
from tpmscad.cli import COMMANDS, make_app
from tpmscad.cli.usage_hints import COMMAND_REMEDIES, OPTION_REMEDIES, OPTION_SYNONYMS


def read_error(line: str, capsys: pytest.CaptureFixture[str]) -> str:
    assert run(line) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    return err


@pytest.mark.parametrize(
    ("line", "meant"),
    [
        ("lattice gyroid --wall 1 -o a.step", "did you mean --thickness? "),
        ("lattice gyroid --density 0.3 -o a.step", "did you mean --volume-fraction or --porosity? "),
        ("lattice --surface gyroid --cell 10 -o a.step", "stands without an option"),
        ("lattice gyroid --units mm -o a.step", "lengths are in mm"),
        ("homogenize gyroid --thickness 1", "did you mean --volume-fraction? "),
        ("homogenize gyroid", "give exactly one of --volume-fraction, --porosity; here: none of them"),
        ("permeability gyroid", "give exactly one of --porosity, --thickness; here: none of them"),
        ("permeability gyroid --porosity 0.3 --thickness 0.1", "here: both"),
        ("permeability gyroid --porosity 1.2", "--porosity 1.2 must lie between 0 and 1"),
        ("permeability gyroid --thickness 0", "--thickness 0 must be a positive number"),
        ("permeability gyroid --porosity 0.4 --report p.txt", ".json"),
        ("flow gyroid", "did you mean `tpmscad permeability`?"),
        ("lattice gyroid --cell 10mm -o a.step", "leave the unit out, lengths are in mm"),
        ("lattice gyroid --cell 10 --thickness 0.6mm -o a.step", "'0.6mm' is not a number: leave the unit out"),
        ("lattice gyroid --cell 10 --thickness 0,6 -o a.step", "'0,6' is not a number: write a decimal point"),
        ("lattice gyroid --cell 10 --thickness thin -o a.step", "--thickness': 'thin' is not a number ("),
        ("lattice gyroid --cell 10 --porosity 70% -o a.step", "'70%' is not a number: write 0.7"),
        ("lattice gyroid --cell 10 --infill 30% -o a.step", "did you mean --volume-fraction 0.3? "),
        ("lattice gyroid --cell 10 --infill=30 -o a.step", "did you mean --volume-fraction 0.3? "),
        ("lattice gyroid --cell 10 --infill 100% -o a.step", "did you mean --volume-fraction? "),
        ("lattice gyroid --cell 10 --infill", "did you mean --volume-fraction? "),
        ("homogenize gyroid --thickness 30%", "did you mean --volume-fraction? "),
        ("lattice gyroid --cell 10 --jobs 2.5 -o a.step", "'2.5' is not a whole number"),
        ("lattice gyriod --cell 10 -o a.step", "did you mean 'gyroid'?"),
        (
            "infill gyroid part.step --cell 10 -o a.step",
            "the file comes first, as in `tpmscad infill body.step gyroid`",
        ),
        ("slice part.step -o a.cli", "'--height': as in `tpmscad slice gyroid.step --height 0.05 -o gyroid.cli`"),
        ("lattice P --cell 10 --thickness 1", "'--output' / '-o': name the file to write, as in -o P.step ("),
        ("lattice --thickness 1 --cell 10 diamond", "as in -o diamond.step ("),
        ("infill part.step gyroid --cell 10", "as in -o part_gyroid.step ("),
        ("slice part.step --height 1", "as in -o part.cli ("),
        ("solidify part.toml", "give --output, the file to write, as in -o part.step, or --dry-run"),
        ("sweep", "as in `tpmscad sweep designs.csv -o results.csv`"),
        ("gyroid --cell 10", "did you mean `tpmscad lattice gyroid`?"),
        ("latice gyroid", "Did you mean 'lattice'"),
        ("version", "`tpmscad --version`"),
        ("convert a.step a.stl", "-o part.stl"),
        ("knit gyroid", "the commands are lattice, struts, infill"),
        ("export a.step a.stl", "No such command 'export': the commands that make solids"),
    ],
)
def test_a_word_of_another_program_is_answered_with_ours(
    recorder: Recorder,  # noqa: F811
    capsys: pytest.CaptureFixture[str],
    line: str,
    meant: str,
) -> None:
    Path("part.step").touch()
    Path("part.toml").touch()
    assert meant in read_error(line, capsys)
    assert not recorder.called


def test_an_option_that_is_only_misspelled_keeps_its_suggestions(capsys: pytest.CaptureFixture[str]) -> None:
    assert "--thickness" in read_error("lattice gyroid --thicknes 1 -o a.step", capsys)


def test_every_word_leads_to_an_option_or_command_that_there_is() -> None:
    import typer

    command = typer.main.get_command(make_app())
    known = {option for sub in command.commands.values() for p in sub.params for option in p.opts}  # type: ignore[attr-defined]
    python_only = {"--domain", "--cells", "--skin", "--tol", "--cell"}
    assert {option for meant in OPTION_SYNONYMS.values() for option in meant} - known <= python_only
    assert not known & set(OPTION_REMEDIES)
    names = set(command.commands)  # type: ignore[attr-defined]
    assert len(names) == len(COMMANDS)
    assert not names & set(COMMAND_REMEDIES)
    for remedy in COMMAND_REMEDIES.values():
        for word in remedy.split("`tpmscad ")[1:]:
            assert word.split("`")[0].split(" ")[0] in names | {"--version", "--help"}


def test_numbers_are_separated_by_commas_or_by_x(recorder: Recorder) -> None:  # noqa: F811
    assert run("lattice gyroid --cell 10 --cells 2x3X1 --thickness 1 -o a.step") == 0
    assert recorder.called["cells"] == (2.0, 3.0, 1.0)


@pytest.mark.parametrize(
    ("options", "wall"),
    [
        ("--porosity 0.4", {"side": "-", "volume_fraction": 0.4}),
        ("--thickness 0.8 --cell 8", {"side": "-", "offset": -0.4}),
        ("--thickness 0.8 --cell 8 --side +", {"side": "+", "offset": 0.4}),
    ],
)
def test_a_channel_is_what_the_wall_leaves_on_one_side(
    monkeypatch: pytest.MonkeyPatch, options: str, wall: dict[str, object]
) -> None:
    called: dict[str, dict[str, object]] = {}

    def make(surface: str, **request: object) -> str:
        called["lattice"] = request
        return "the channel"

    def solve(channel: str, **request: object) -> SimpleNamespace:
        assert channel == "the channel"
        called["permeability"] = request
        return SimpleNamespace(to_dict=dict)

    monkeypatch.setitem(vars(tpmscad), "lattice", make)
    monkeypatch.setitem(vars(tpmscad), "permeability", solve)
    assert run(f"permeability gyroid {options} --size 0.2") == 0
    cell = 8.0 if "--cell" in options else 1.0
    fixed = {"cell": cell, "kind": "skeletal", "reference": None, "loose": "keep"}
    called["lattice"].pop("progress")
    assert called["lattice"] == fixed | wall
    assert called["permeability"]["size"] == pytest.approx(0.2 * cell)
