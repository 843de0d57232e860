"""Sweeps of exchangers with two fluids: figures by samples beside those of solids, the front, and what is made again."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import build123d as bd
import pytest

import tpmscad
from tests.cli.test_cli import run

pytestmark = pytest.mark.kernel

WATER = {"density": 998.0, "viscosity": 1.0e-3, "conductivity": 0.6, "specific_heat": 4180.0}
FLOW = {
    "plus": WATER | {"volume_flow": 2e-5, "temperature": 60.0},
    "minus": WATER | {"volume_flow": 2e-5, "temperature": 20.0},
    "arrangement": "cross",
    "wall_conductivity": 15.0,
    "wall_density": 7900.0,
}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    bd.export_step(bd.Box(24, 20, 16), tmp_path / "box.step")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def design(**given: Any) -> dict[str, Any]:
    return {"kind": "domains", "body": "box.step", "surface": "gyroid", "cell": 8, "tol": 0.1} | given


def sweep(rows: list[dict[str, Any]], **given: Any) -> Any:
    rows = [{"openings": "+=<X,>X;-=<Y,>Y"} | row for row in rows]
    return tpmscad.sweep(rows, progress=False, **({"flow": FLOW} | given))


def test_samples_say_about_what_the_solids_measure(folder: Path) -> None:
    (coarse,) = sweep([design(thickness=0.8)], solids=False).rows
    results = sweep([design(thickness=0.8)])
    (solid,) = results.rows
    assert results.reused == 0
    assert (coarse["coarse"], solid["coarse"]) == (True, False)
    assert coarse["faces"] is None
    for name in ("volume", "volume_plus", "volume_minus", "mass"):
        assert coarse[name] == pytest.approx(solid[name], rel=0.02)
    for name in ("pressure_drop_plus", "pressure_drop_minus", "effectiveness", "heat", "compactness"):
        assert coarse[name] == pytest.approx(solid[name], rel=0.04)
    for name in ("opening_area_plus", "opening_area_minus"):
        assert coarse[name] == pytest.approx(solid[name], rel=0.1)
    assert sweep([design(thickness=0.8)]).reused == 1
    assert sweep([design(thickness=0.8)], solids=False).reused == 1
    assert sweep([design(thickness=0.8)], solids=False, flow=FLOW | {"wall_density": 2700.0}).reused == 0


def test_the_front_holds_the_designs_that_none_beats(folder: Path) -> None:
    results = sweep([design(cell=c, thickness=t) for c in (7, 8) for t in (0.5, 0.9)], solids=False)
    drops, masses = results.column("pressure_drop_plus"), results.column("mass")
    pairs = list(zip(drops, masses, strict=True))
    best = {i for i, (a, b) in enumerate(pairs) if not any(c <= a and d <= b and (c, d) != (a, b) for c, d in pairs)}
    chosen = results.pareto(least="pressure_drop_plus,mass")
    assert [(row["cell"], row["thickness"]) for row in chosen] == [
        (results.rows[i]["cell"], results.rows[i]["thickness"]) for i in sorted(best)
    ]
    assert 0 < len(best) < 4
    axes = results.plot("pressure_drop_plus", "effectiveness", by="cell", front="least,greatest")
    assert axes.get_xlabel() == "pressure drop of channel +, Pa"
    front = axes.lines[-1]
    assert len(front.get_xdata()) == len(results.pareto(least="pressure_drop_plus", greatest="effectiveness"))
    assert sweep(chosen, solids=False).reused == len(chosen)


def test_a_design_without_an_estimate_is_a_row_with_its_reason_and_the_others_go_on(folder: Path) -> None:
    results = sweep([design(surface="P", thickness=0.8), design(thickness=0.8)], solids=False)
    assert [row["met"] for row in results.rows] == [False, True]
    assert "no correlation of heat transfer covers schwarz_p" in results.rows[0]["message"]
    (alone,) = sweep([design(surface="P", thickness=0.8)], solids=False, flow=None, output="alone.csv").rows
    assert alone["met"]
    assert alone["volume_plus"] > 0


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"flow": {"plus": FLOW["plus"]}}, "flow: minus: None is unknown"),
        ({"flow": FLOW | {"arangement": "cross"}}, "flow: 'arangement' is unknown; the keys are plus, minus, arr"),
        ({"flow": FLOW | {"arrangement": "mixed"}}, "flow: arrangement 'mixed' is none of counter, cross, parallel"),
        ({"flow": FLOW | {"wall_density": "steel"}}, "flow: wall_density 'steel' must be a positive number"),
        ({"flow": {"plus": {"fluid": "water"}, "minus": FLOW["minus"]}}, "flow: plus: give the temperature of water"),
    ],
)
def test_a_flow_is_read_before_any_work(folder: Path, given: dict[str, Any], said: str) -> None:
    with pytest.raises(tpmscad.InvalidRequest, match=said):
        sweep([design(thickness=0.8)], solids=False, **given)


def test_only_exchangers_have_figures_without_solids(folder: Path) -> None:
    with pytest.raises(tpmscad.InvalidRequest, match="row 1: only exchangers have figures without solids"):
        tpmscad.sweep([{"surface": "P", "cell": 4, "thickness": 0.5}], solids=False, progress=False)


def test_the_command_line_takes_a_flow_and_makes_no_solids(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    row = design(thickness=0.8, openings="+=<X,>X;-=<Y,>Y")
    with Path("table.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, row)
        writer.writeheader()
        writer.writerow(row)
    streams = [
        f"[{side}]\n" + "".join(f"{name} = {value}\n" for name, value in FLOW[side].items())
        for side in ("plus", "minus")
    ]
    walls = 'arrangement = "cross"\nwall_conductivity = 15.0\nwall_density = 7900.0\n'
    Path("flow.toml").write_text(walls + "".join(streams))
    assert run("sweep table.csv --flow flow.toml --no-solids -q -o command.csv") == 0
    (made,) = sweep([row], solids=False, output="command.csv").rows
    (alone,) = sweep([row], solids=False, output="alone.csv").rows
    assert made["coarse"] is True
    assert made["effectiveness"] == pytest.approx(alone["effectiveness"], rel=1e-12)
    Path("table.csv").write_text("surface,cell,thickness\ngyroid,8,0.8\n")
    assert run("sweep table.csv --no-solids -q -o none.csv") == 2
    assert "only exchangers have figures without solids: leave out --no-solids" in capsys.readouterr().err


def test_fronts_name_figures(folder: Path) -> None:
    results = sweep([design(thickness=0.8)], solids=False)
    with pytest.raises(tpmscad.InvalidRequest, match="name the figures whose least"):
        results.pareto()
    with pytest.raises(tpmscad.InvalidRequest, match="must say least or greatest"):
        results.plot("mass", "heat", front="min")
