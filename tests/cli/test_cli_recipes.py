"""tpmscad blend and tpmscad solidify on real files: exit status, what is said, what is left behind."""

from __future__ import annotations

import json
import os
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from tests.cli.test_cli import run

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
RODS = "\n".join(
    f'[[structures]]\nkind = "rod"\nsurface = "{name}"\nperiod = 2.5\nlevel = {level}'
    for name, level in (("schwarz_p", -0.8), ("iwp", -2.0))
)
BOXES = "\n".join(
    f'[[{where}]]\nkind = "box"\nlo = [{low}, 0, 0]\nhi = [{high}, 5, 5]'
    for where, low, high in (("regions", 0, 10), ("regions", 10, 20), ("blending_regions", 6, 14))
)
TORN = f'tol = 0.05\nmethod = "initial"\nresolution = [100, 26, 26]\n{RODS}\n{BOXES}\n'
"""A blend left as it starts: in pieces."""


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for example in EXAMPLES.glob("*.toml"):
        shutil.copy(example, tmp_path)
    (tmp_path / "torn.toml").write_text(TORN)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def made() -> list[str]:
    return [name for name in sorted(os.listdir()) if not name.endswith(".toml")]


def test_a_dry_run_blends_and_writes_the_report_only(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("blend transition.toml --dry-run --report out.json") == 0
    assert "no topological error of the blend at 25x25x25 and 50x50x50" in capsys.readouterr().out
    assert made() == ["out.json"]
    report = json.loads(Path("out.json").read_text())
    assert report["converged"] is True
    assert report["errors"]["n0"]["final"] == [0, 0]


def test_a_blend_with_errors_left_ends_in_1_with_its_message_and_no_model(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("blend torn.toml -o out.step --report out.json") == 1
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert "errors left: 100x26x26: " in err
    assert made() == ["out.json"]
    assert json.loads(Path("out.json").read_text())["converged"] is False
    assert run("blend torn.toml --dry-run --allow-errors") == 0


@pytest.mark.parametrize(
    "line",
    [
        "blend scaffold.toml",
        "blend missing.toml -o out.step",
        "blend scaffold.toml -o out.obj",
        "blend scaffold.toml -o nowhere/out.step",
        "solidify graded.toml --dry-run --report nowhere/out.json",
    ],
)
def test_bad_usage_ends_in_2_before_anything_is_made(capsys: pytest.CaptureFixture[str], line: str) -> None:
    assert run(line) == 2
    assert capsys.readouterr().err
    assert made() == []


def test_an_error_of_the_file_ends_in_2_with_its_line(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    (folder / "torn.toml").write_text(TORN.replace("period = 2.5", "period = -3", 1))
    assert run("blend torn.toml -o out.step") == 2
    assert capsys.readouterr().err == "tpmscad: torn.toml, line 7, structures[0].period: -3 must be positive\n"


@pytest.mark.kernel
@pytest.mark.parametrize("line", ["blend transition.toml", "solidify graded.toml"])
def test_the_solid_is_written_and_reads_back_as_reported(capsys: pytest.CaptureFixture[str], line: str) -> None:
    assert run(f"{line} -o out.step --report out.json") == 0
    assert capsys.readouterr().out.startswith("met\n")
    report = json.loads(Path("out.json").read_text())
    assert report["met"] is True
    assert report["max_deviation"] <= report["tol"]
    assert ("blend" in report) == line.startswith("blend")
    assert run("check out.step --report found.json") == 0
    assert json.loads(Path("found.json").read_text())["volume"] == pytest.approx(report["volume"], rel=1e-9)


@pytest.mark.kernel
def test_the_domain_may_be_the_body_of_a_step_file(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    import build123d as bd

    bd.export_step(bd.Pos(5, 5, 5) * bd.Cylinder(5, 9), str(folder / "drum.step"))
    text = (folder / "graded.toml").read_text()
    (folder / "drum.toml").write_text(re.sub("domain = .*", 'domain = "drum.step"', text).replace('"growth"', "-0.3"))
    assert run("solidify drum.toml --dry-run") == 0
    assert run("solidify drum.toml -o out.step") == 0, capsys.readouterr().err
    assert run("check out.step --report found.json") == 0
    assert 0.2 * 707 < json.loads(Path("found.json").read_text())["volume"] < 0.6 * 707


class TestArrays:
    """Options on an array of grey values, of elements, of labels."""

    @pytest.fixture(autouse=True)
    def arrays(self, folder: Path) -> None:
        np.save(folder / "organs.npy", np.indices((6, 5, 5))[0] // 2)
        density = np.zeros((24, 12, 8))
        density[:, :6] = 1
        np.save(folder / "density.npy", density)
        np.savez(folder / "density.npz", rho=density, smooth=np.arange(5.0) * np.ones((7, 6, 5)))

    def made(self) -> list[str]:
        return [name for name in made() if not name.endswith((".npy", ".npz"))]

    @pytest.mark.parametrize(
        ("line", "message"),
        [
            ("organs.npy --level 0.5", "organs.npy holds the labels 0, 1, 2, .*: --label makes the surface of one"),
            (
                "organs.npy --label 1 --level 0.5",
                "give either --level or --volume-fraction, for grey values, or --label",
            ),
            ("organs.npy --label 1 --point-data", "leave --point-data out"),
            ("density.npy", "grey values: it needs --level.*; of a segmentation give --label"),
            ("density.npy --level 0.5 --volume 1", "volume 1: density.npy holds one volume: leave --volume out"),
            ("density.npy --as gyroid", "a lattice needs --cell, the edge of its cell"),
            ("density.npy --as gyroid --cell 6 --level 0.5", "--level: a lattice is graded by all of the densities"),
            ("density.npy --cell 6 --level 0.5", "--cell is that of a lattice: give --as too"),
            ("organs.npy --as gyroid --cell 6", "organs.npy holds values that are no densities from 0 to 1, 0 to 2"),
            ("organs.npy --label 0 --among 1,2", "label 0 is none of those in --among, 1, 2"),
            ("organs.npy --among 1,2", "give one --label of those in --among, 1, 2"),
            ("organs.npy --among 1,2 --level 0.5", "--among is for labels: leave it out, or --level"),
            ("organs.npy --smoothing 1", "leave --smoothing out, it is for grey values"),
            ("density.npz --level 0.5", "holds 2 arrays, 'rho', 'smooth': name one of them, --array-name rho"),
            ("density.npy --level 0.5 --frame RAS", "states no frame.*leave --frame out"),
            (
                "graded.toml --label 1 --cell-data --frame file --tol 0.1",
                "--label, --cell-data, --frame, --tol: a recipe says these itself",
            ),
        ],
    )
    def test_what_does_not_fit_is_refused(self, capsys: pytest.CaptureFixture[str], line: str, message: str) -> None:
        assert run(f"solidify {line} -o out.step") == 2
        assert re.search(message, capsys.readouterr().err)
        assert self.made() == []

    @pytest.mark.slow
    def test_a_dry_run_tells_what_is_assumed(self, capsys: pytest.CaptureFixture[str]) -> None:
        assert run("solidify density.npy --level 0.5 --dry-run --report out.json") == 0
        assert (
            "values are taken at points, the solid ends at the outermost ones; --cell-data if"
            in capsys.readouterr().out
        )
        assert len(json.loads(Path("out.json").read_text())["notes"]) == 2
        assert run("solidify density.npy --level 0.5 --cell-data --dry-run") == 0
        out = capsys.readouterr().out
        assert "box (-0.5, -0.5, -0.5) to (23.5, 11.5, 7.5)" in out
        assert "taken at points" not in out

    def test_an_array_of_an_archive_its_smoothing_and_the_volume_that_it_fills(
        self, capsys: pytest.CaptureFixture[str]
    ) -> None:
        line = "solidify density.npz --array-name smooth --volume-fraction 0.4 --smoothing 0.5 --cell-data --dry-run"
        assert run(line) == 0
        out = capsys.readouterr().out
        assert "about 40.0 % of it solid" in out
        assert "density.npz: smoothed by a Gaussian of 0.5 samples" in out

    @pytest.mark.slow
    def test_a_density_is_a_lattice_of_as_much_volume(self, capsys: pytest.CaptureFixture[str]) -> None:
        """Half of the plate is full and half is empty: .6 and .15 of it, as a lattice."""
        line = "solidify density.npy --as gyroid --cell 4 --cell-data --dry-run"
        assert run(f"{line} --report out.json") == 0
        assert json.loads(Path("out.json").read_text())["volume_fraction"] == pytest.approx(0.375, abs=0.01)
        assert (
            "a gyroid sheet with the densities as volume fractions, 2304 of 2304 of which were"
            in capsys.readouterr().out
        )

    def test_integers_are_all_labels_unless_one_is_named(self, capsys: pytest.CaptureFixture[str]) -> None:
        assert run("solidify organs.npy --dry-run") == 0
        assert "labels 1, 2 of 0, 1, 2 as one solid; --label takes one of them" in capsys.readouterr().out
        assert run("solidify organs.npy --label 2 --dry-run") == 0
        assert "label 2 of 0, 1, 2" in capsys.readouterr().out

    def test_a_label_among_others_fills_what_they_leave(self, capsys: pytest.CaptureFixture[str]) -> None:
        for number in (1, 2):
            assert run(f"solidify organs.npy --label {number} --among 1,2 --dry-run --report {number}.json") == 0
            assert "labels 1, 2 of 0, 1, 2, divided by smooth surfaces" in capsys.readouterr().out
        shares = [json.loads(Path(f"{number}.json").read_text())["volume_fraction"] for number in (1, 2)]
        assert shares == pytest.approx([1 / 3, 1 / 3], rel=0.01)

    @pytest.mark.kernel
    def test_elements_reach_to_their_ends(self) -> None:
        """The size of the elements, 24 by 6 by 8; points end half an element earlier on every side but the one that is cut."""
        options = "--level 0.5 --origin 0.5,0.5,0.5 --report out.json -o out.step"
        for option, size in (("--cell-data", 24 * 6 * 8), ("--point-data", 23 * 5.5 * 7)):
            assert run(f"solidify density.npy {option} {options}") == 0
            report = json.loads(Path("out.json").read_text())
            assert report["met"]
            assert report["volume"] == pytest.approx(size, rel=1e-6)

    @pytest.mark.kernel
    def test_bosses_and_bolts_are_exact(self, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
        """The plate of 24 by 6 by 8, a boss of 4 by 4 beside it, and a bolt of radius 1 through it."""
        import build123d as bd

        bd.export_step(bd.Pos(10.1, 7.1, 3.7) * bd.Box(4, 4, 6), str(folder / "boss.step"))
        bd.export_step(bd.Pos(10.1, 7.3, 3.7) * bd.Cylinder(1, 20), str(folder / "bolt.step"))
        line = "solidify density.npy --level 0.5 --cell-data --keep boss.step --clear bolt.step"
        assert run(f"{line} --dry-run") == 0
        out = capsys.readouterr().out
        assert "boss.step is contained, 96 mm3" in out
        assert "bolt.step stays empty, 62.8319 mm3" in out
        assert run(f"{line} --report out.json -o out.step") == 0
        report = json.loads(Path("out.json").read_text())
        assert report["met"]
        assert report["volume"] == pytest.approx(24 * 6 * 8 + 4 * (9.1 - 5.5) * 6 - np.pi * 6, rel=1e-5)
        assert report["betti"] == [1, 1, 0]
        assert run("solidify graded.toml --keep boss.step -o out.step") == 2
        assert "--keep: a recipe says these itself" in capsys.readouterr().err

    @pytest.mark.kernel
    def test_a_recipe_names_what_is_kept(self, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
        import build123d as bd

        bd.export_step(bd.Pos(5, 5, 5) * bd.Box(2, 2, 30), str(folder / "bar.step"))
        text = (folder / "graded.toml").read_text()
        (folder / "kept.toml").write_text('keep = "bar.step"\n' + text)
        assert run("solidify kept.toml --dry-run") == 0
        assert "bar.step is contained, 120 mm3" in capsys.readouterr().out
        (folder / "kept.toml").write_text('clear = "none.step"\n' + text)
        assert run("solidify kept.toml --dry-run") == 2
        assert "kept.toml, line 1, clear: there is no file none.step" in capsys.readouterr().err

    @pytest.mark.kernel
    def test_the_certificate_of_a_label_says_what_it_is_measured_from(self) -> None:
        assert run("solidify organs.npy --label 1 --report out.json -o out.step") == 0
        report = json.loads(Path("out.json").read_text())
        assert report["volume"] == pytest.approx(2 * 25, rel=0.1)  # two voxels thick: within a voxel
        assert any("the deviation is that from its smoothed surface" in note for note in report["notes"])


@pytest.mark.parametrize(("name", "remedy"), [("part.step", "tpmscad infill"), ("points.csv", "recipe-keys scattered")])
def test_a_file_that_is_no_array_is_refused_with_the_way_to_use_it(
    folder: Path, capsys: pytest.CaptureFixture[str], name: str, remedy: str
) -> None:
    (folder / name).write_text("1,2,3,4\n")
    assert run(f"solidify {name} --level 0.5 -o out.step") == 2
    error = capsys.readouterr().err
    assert "no recipe and no array" in error
    assert remedy in error


@pytest.mark.parametrize(
    ("command", "recipe", "other"), [("blend", "graded", "solidify"), ("solidify", "scaffold", "blend")]
)
def test_a_recipe_of_the_other_command_is_refused_with_its_name(
    capsys: pytest.CaptureFixture[str], command: str, recipe: str, other: str
) -> None:
    assert run(f"{command} {recipe}.toml --dry-run") == 2
    assert f"hand it to `tpmscad {other}`" in capsys.readouterr().err
