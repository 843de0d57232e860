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
from benchmarks.trial_images import Grid, Shape, judge_frame_note, judge_place
from benchmarks.trial_judges import NodalFunction, Region, judge_solid, judge_step_text, judge_stl, signed_distance
from benchmarks.trial_skins import SkinRequest, is_solid, judge_skin, number_open_faces
from benchmarks.trial_statements import (
    judge_fraction,
    judge_labels,
    judge_size,
    judge_walls,
    touch_sharp_edges,
    triangulate,
)
from tpmscad import catalogue, fields

pytestmark = pytest.mark.kernel

ROOT = Path(__file__).resolve().parents[1]
BALL = Region(lambda p: np.linalg.norm(p, axis=-1) < 1, np.full(3, -1.1), np.full(3, 1.1))
PAIR = Region(lambda p: np.abs(np.abs(p[..., 0]) - 0.7) < 0.2, np.full(3, -1.1), np.full(3, 1.1))


@pytest.mark.slow
def test_random_requests_are_met_or_refused() -> None:
    """In a process of its own: the trial forks, and the kernel's threads of this one would not be there after it."""
    count = 2
    options = ["--seed", "1", "--count", str(count), "--kind", "recipe"]
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


def test_sharp_edges_of_a_mesh_are_found() -> None:
    vertices, triangles = triangulate(bd.Cylinder(5, 8).wrapped, 0.01)
    corners = vertices[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    found = touch_sharp_edges(corners, normals, 0.01)
    assert found.tolist() == (np.abs(np.abs(corners[..., 2]) - 4) < 1e-9).any(axis=1).tolist()
    vertices, triangles = triangulate(bd.Sphere(5).wrapped, 0.01)
    corners = vertices[triangles]
    assert not touch_sharp_edges(corners, corners.mean(axis=1) / 5, 0.01).any()


def test_the_place_of_the_trials_shape_is_that_of_its_samples() -> None:
    shape = Shape(np.array([1.0, 2, 3]), np.array([4.0, 5, 6]), np.array([0.1, -0.05, 0.03]))
    low, high = np.array([-9.0, -9, 1.5]), np.full(3, 14.0)
    axes = [a + (b - a) * (np.arange(120) + 0.5) / 120 for a, b in zip(low, high, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    inside = points[shape.value(points) < 0]
    volume, centroid, box = shape.place(low, high)
    assert volume == pytest.approx(len(inside) * float(((high - low) / 120).prod()), rel=2e-3)
    np.testing.assert_allclose(centroid, inside.mean(axis=0), atol=5e-3)
    np.testing.assert_allclose(box, [inside.min(axis=0), inside.max(axis=0)], atol=0.25)
    assert box[0, 2] == pytest.approx(low[2], rel=1e-12)


def test_images_put_into_the_wrong_place_are_noticed() -> None:
    """A ball beside the middle of its image: mirrored, half a cell off, in another unit, with another volume."""
    shape = Shape(np.array([11.0, 5.5, 6.0]), np.array([3.0, 3.2, 3.5]), np.array([0.06, 0.05, -0.04]))
    grid = Grid((18, 14, 15), np.ones(3), np.array([1.0, -1, -1]), False)
    stored, affine = grid.stored(shape.value(grid.points()), (1, 2, 0), (True, False, True), 0.1)
    index = np.array([3, 5, 7])
    at = affine @ [*index, 1.0]
    assert stored[tuple(index)] == pytest.approx(shape.value(0.1 * at[:3]))
    field = fields.sampled(shape.value(grid.points()), spacing=1.0, origin=(1, -1, -1))
    model = tpmscad.solidify(field, field.domain, tol=0.05)
    volume, centroid, box = shape.place(*grid.box)
    assert judge_place(model, (volume, centroid, box), 0.0) == []
    assert "volume" in judge_place(model, (1.1 * volume, centroid, box), 0.0)[0]
    for shift in np.vstack([0.5 * np.eye(3), -0.5 * np.eye(3)]):
        faults = judge_place(model, (volume, centroid + shift, box + shift), 0.0, 0.2)
        assert "the centroid is" in faults[0]
        assert "the box is" in faults[1]
    mirrored = np.array([-1, -1, 1])
    assert judge_place(model, (volume, mirrored * centroid, np.sort(mirrored * box, axis=0)), 0.0)


def test_notes_on_another_frame_are_noticed() -> None:
    converted = ("a.nrrd: frame LPS converted to RAS, x and y reversed",)
    assert judge_frame_note(converted, "LPS", None) == []
    assert judge_frame_note(converted, "LAS", None)
    assert judge_frame_note(converted, "LPS", "file")
    assert judge_frame_note(converted, "RAS", None)
    assert judge_frame_note(converted, "", None)
    assert judge_frame_note(("a.nrrd: frame RAS",), "RAS", "RAS") == []
    assert judge_frame_note((), "RAS", "RAS")


def test_open_faces_are_those_that_words_numbers_and_faces_name() -> None:
    body = bd.Box(10, 10, 10) - bd.Pos(2, 0, 3) * bd.Box(10, 20, 10)
    faces = body.faces()
    heights = {i: face.center().Z for i, face in enumerate(faces)}
    top, floor = max(heights, key=heights.__getitem__), next(i for i, z in heights.items() if abs(z + 2) < 1e-9)
    assert number_open_faces(body, ">Z") == number_open_faces(body, faces[top]) == {top}
    assert number_open_faces(body, "+z") == {top, floor}
    assert number_open_faces(body, f"{floor}, >Z") == number_open_faces(body, (floor, top)) == {top, floor}
    assert len(number_open_faces(body, "|Y")) == 2
    assert number_open_faces(body, "#Z") == set(heights) - number_open_faces(body, "|Z")
    assert number_open_faces(body, "<Z") == number_open_faces(body, "-Z")


def test_solid_angles_tell_a_mesh_with_a_cavity() -> None:
    vertices, triangles = triangulate(bd.Box(4, 4, 4).wrapped, 0.1)
    inner = np.vstack([triangles, triangles[:, ::-1] + len(vertices)])
    points = np.array([[0.5, 0.4, 0.3], [1.5, 0.2, 0.1], [2.5, 0, 0]])
    assert is_solid(points, vertices, triangles).tolist() == [True, True, False]
    assert is_solid(points, np.vstack([vertices, 0.5 * vertices]), inner).tolist() == [False, True, False]


def test_skins_and_open_faces_that_were_not_asked_for_are_noticed() -> None:
    body, cell = bd.Box(10, 10, 10), 8.0
    model = tpmscad.infill(body, "P", cell=cell, thickness=0.6, tol=0.05, skin=1, open_faces=">Z")
    f = NodalFunction(catalogue.CATALOGUE["schwarz_p"].formula, (cell,) * 3, (0, 0, 0))
    opened = number_open_faces(body, ">Z")
    asked = SkinRequest(body, opened, 1.0, lambda p: signed_distance(f, p, 0.6, cell), 0.3, 1.2e-2 * cell)
    vertices, triangles = triangulate(model.wrapped, 0.02, angle=0.5)
    assert judge_skin(model, asked, vertices, triangles, 0.02) == []
    for wrong, words in (
        (replace(asked, skin=1.2, half=0.8), ["a skin of 1 is stated", "the skin are void", "the wall are void"]),
        (replace(asked, half=0.05), ["points in the void are solid", "off the wall"]),
        (
            replace(asked, opened=number_open_faces(body, "<Z")),
            ["is open, but", "is closed, but", "the label skin lie"],
        ),
    ):
        faults = judge_skin(model, wrong, vertices, triangles, 0.02)
        assert all(any(word in fault for fault in faults) for word in words), faults
