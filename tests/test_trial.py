"""The standing trial: a few requests with a fixed seed, and its judges, which have to notice what is wrong."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import build123d as bd
import numpy as np
import pytest

import tpmscad
from benchmarks.trial_judges import NodalFunction, Region, judge_solid, judge_step_text, judge_stl, signed_distance
from benchmarks.trial_statements import judge_fraction, judge_labels, judge_size, judge_walls, triangulate
from tpmscad import catalogue, fields

pytestmark = pytest.mark.kernel

ROOT = Path(__file__).resolve().parents[1]
BALL = Region(lambda p: np.linalg.norm(p, axis=-1) < 1, np.full(3, -1.1), np.full(3, 1.1))
PAIR = Region(lambda p: np.abs(np.abs(p[..., 0]) - 0.7) < 0.2, np.full(3, -1.1), np.full(3, 1.1))


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "count"), [("malformed", 2), ("recipe", 2)])
def test_random_requests_are_met_or_refused(kind: str, count: int) -> None:
    """In a process of its own: the trial forks, and the kernel's threads of this one would not be there after it."""
    options = ["--seed", "1", "--count", str(count), "--kind", kind]
    command = [sys.executable, "-m", "benchmarks.trial", *options]
    answer = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert answer.returncode == 0, answer.stdout + answer.stderr
    assert sum(map(int, answer.stdout.splitlines()[-1].split()[1:])) == count


def test_the_formulas_read_by_the_trial_are_those_of_the_catalogue() -> None:
    points = np.random.default_rng(0).random((40, 3)) * 9
    for name, record in catalogue.CATALOGUE.items():
        ours = NodalFunction(record.formula, (4, 5, 6), (0.1, 0.2, 0.3))
        np.testing.assert_allclose(ours(points), fields.tpms(name, (4, 5, 6), (0.1, 0.2, 0.3))(points), atol=1e-12)
        values, gradients = ours.jet(points)
        np.testing.assert_allclose(values, ours(points), atol=1e-12)
        slopes = [(ours(points + h) - ours(points - h)) / 2e-5 for h in 1e-5 * np.eye(3)]
        np.testing.assert_allclose(gradients, np.stack(slopes, axis=-1), atol=1e-8)


def test_its_distance_is_that_of_a_plane_and_a_ball() -> None:
    points = np.random.default_rng(0).normal(size=(50, 3))
    points *= (np.random.default_rng(1).uniform(0.7, 1.3, 50) / np.linalg.norm(points, axis=1))[:, None]
    for f in (lambda p: (p**2).sum(-1) - 1, lambda p: np.exp((p**2).sum(-1)) - np.e):
        found = signed_distance(f, points, 0.4, 2.0)
        np.testing.assert_allclose(found, np.linalg.norm(points, axis=1) - 1, atol=1e-6)


def test_a_wrong_volume_and_a_wrong_number_of_pieces_are_noticed() -> None:
    volume, area = 4 / 3 * np.pi, 4 * np.pi
    assert judge_solid(BALL, volume, area, 1, ()) == []
    assert judge_solid(BALL, 0.97 * volume, area, 1, (0.03 * volume,)) == []
    assert "volume" in judge_solid(BALL, 0.97 * volume, area, 1, ())[0]
    assert "pieces" in judge_solid(BALL, volume, area, 2, ())[0]
    assert judge_solid(PAIR, 0.8 * 2.2**2, 4 * 2.2**2, 2, ()) == []
    assert "pieces" in judge_solid(PAIR, 0.8 * 2.2**2, 4 * 2.2**2, 1, ())[0]


def test_an_open_mesh_and_an_edge_used_once_are_noticed(tmp_path: Path) -> None:
    path = tmp_path / "box.stl"
    bd.export_stl(bd.Box(1, 2, 3), path)
    assert judge_stl(path, 6.0, 1e-6, 22.0) == []
    assert "the mesh bounds" in judge_stl(path, 6.1, 1e-6, 22.0)[0]
    data = bytearray(path.read_bytes())
    data[84 + 12 : 84 + 24] = data[84 + 24 : 84 + 36]
    path.write_bytes(bytes(data))
    assert "the mesh is open" in judge_stl(path, 6.0, 10.0, 22.0)
    step = tmp_path / "box.step"
    bd.export_step(bd.Box(1, 2, 3), step)
    assert judge_step_text(step, 1, 6) == []
    assert judge_step_text(step, 2, 5) == [
        "the file has 1 solids, the certificate 2",
        "the file has 6 faces, the certificate 5",
    ]
    one, rest = step.read_text().split("ORIENTED_EDGE", 1)
    step.write_text(
        one
        + "ORIENTED_EDGE"
        + rest.replace(",.T.)", ",.X.)", 1).replace(",.F.)", ",.T.)", 1).replace(",.X.)", ",.F.)", 1)
    )
    assert judge_step_text(step, 1, 6) == ["an edge of the file is not used once in each direction"]


def test_wrong_statements_of_a_solid_are_noticed(tmp_path: Path) -> None:
    """Each judge of what is stated is given something wrong: a size, a wall, a fraction, a label."""
    body = bd.Box(8, 8, 8)
    model = tpmscad.infill(body, "P", cell=8, thickness=0.8, tol=0.05)
    path = tmp_path / "made.step"
    model.export(path)
    vertices, triangles = triangulate(model.wrapped, 0.02)
    assert judge_size(model, path, vertices, 0.02) == []
    assert "outside its box" in judge_size(model, path, vertices * 1.1, 0.02)[0]
    assert "larger than the solid" in judge_size(model, path, vertices * 0.9, 0.02)[0]
    report = model.check_print()
    assert judge_walls(report, vertices, triangles, 0.02, 0.8) == []
    wall = report.smallest_wall
    assert "sampled is one of" in judge_walls(replaced(report, wall, bound=1.2), vertices, triangles, 0.02, 0.8)[0]
    assert "asked for were" in judge_walls(report, vertices, triangles, 0.02, 0.5)[0]
    assert judge_fraction(model, 512.0) == []
    assert "the envelope" in judge_fraction(model, 500.0)[0]
    low, high = np.full(3, -4.0), np.full(3, 4.0)
    assert judge_labels(model, low, high, body) == []
    assert "off that face of the body" in judge_labels(model, low, high, bd.Pos(1, 2, 3) * body)[0]
    lattice = tpmscad.lattice("P", cell=8, thickness=0.8, tol=0.1)
    assert judge_labels(lattice, np.zeros(3), np.full(3, 8.0), None) == []
    assert "lies off" in judge_labels(lattice, np.zeros(3), np.full(3, 8.1), None)[0]


def replaced(report: object, wall: object, **changes: float) -> object:
    """A print report with another smallest wall."""
    return SimpleNamespace(smallest_wall=replace(wall, **changes))  # type: ignore[type-var]
