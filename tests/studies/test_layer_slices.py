"""Slices hold the exact contours: points on the surface, chords within the error, areas that integrate to the volume."""

from __future__ import annotations

import json
import pickle
import zipfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import build123d as bd
import numpy as np
import pytest
from scipy.spatial import cKDTree

import tpmscad
from tests.cli.test_cli import run
from tpmscad.kernel.export.layer_files import Layer
from tpmscad.kernel.measure.shape_extents import shape_bounds
from tpmscad.kernel.occt.geometry_evaluators import PlaneEvaluator, face_evaluator
from tpmscad.kernel.slicing import contours
from tpmscad.kernel.slicing.contours import SlicedFaces
from tpmscad.studies.layer_slices import Slices, slice_shape

pytestmark = pytest.mark.kernel


def polygon_area(contour: np.ndarray) -> float:
    x, y = contour.T
    return float(0.5 * (x * np.roll(y, -1) - y * np.roll(x, -1)).sum())


def cut(shape: bd.Shape, height: float, chord_error: float) -> Slices:
    low, high = shape_bounds(shape)
    return slice_shape(shape, "part", height, chord_error, (low[2], high[2]))


def test_layers_of_a_ball_are_its_circles() -> None:
    found = cut(bd.Sphere(5.0), 0.1, 0.01)
    assert len(found) == 100
    for layer in found:
        radius = np.sqrt(25.0 - layer.middle**2)
        points = np.concatenate(layer.contours)
        np.testing.assert_allclose(np.hypot(*points.T), radius, atol=1e-9)
        assert layer.area == pytest.approx(np.pi * radius**2, rel=1e-5)
        assert layer.perimeter == pytest.approx(2 * np.pi * radius, rel=1e-5)
    assert found.unresolved == 0


def test_volumes_of_few_layers_are_those_of_the_solid() -> None:
    """The midpoint rule on five layers is 1 % off for a ball."""
    ball = cut(bd.Sphere(5.0), 2.0, 0.001)
    assert ball.volume == pytest.approx(500 / 3 * np.pi, rel=1e-6)
    assert ball[0].volume == pytest.approx(np.pi * 4 * (15 - 2) / 3, rel=1e-6)


def test_volumes_are_exact_where_the_area_jumps_within_a_layer() -> None:
    steps = cut(bd.Pos(0, 0, 0.5) * bd.Box(4, 4, 1) + bd.Pos(0, 0, 1.5) * bd.Box(2, 2, 1), 0.3, 0.01)
    np.testing.assert_allclose([layer.volume for layer in steps], [4.8] * 3 + [2.4] + [1.2] * 2 + [0.8], rtol=1e-9)


@pytest.mark.slow
def test_batches_of_levels_cut_by_an_executor_are_those_of_one_process() -> None:
    model = tpmscad.lattice("schwarz_p", cell=4, thickness=0.5, tol=0.05)
    alone = model.slices(0.02, 0.02)
    with ThreadPoolExecutor(2) as executor:
        shared = model.slices(0.02, 0.02, executor)
    assert len(alone) == len(shared) == 200  # two batches, which meet inside of patches
    for a, b in zip(alone, shared, strict=True):
        assert (a.area, a.volume) == (b.area, b.volume)
        assert all(np.array_equal(p, q) for p, q in zip(a.contours, b.contours, strict=True))
        assert len(a.contours) >= 1
    assert alone.volume == pytest.approx(model.volume, rel=1e-5)


class PicklingExecutor(ThreadPoolExecutor):
    """An executor that sends its tasks as processes would."""

    def submit(self, function: Any, /, *arguments: Any, **named: Any) -> Any:
        return super().submit(function, *pickle.loads(pickle.dumps(arguments)), **named)


def test_faces_that_no_other_process_can_evaluate_are_cut_in_this_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """A plane comes first, and could be sent; the kernel alone evaluates a surface of extrusion."""
    monkeypatch.setattr(contours, "FACES_PER_TASK", 1)
    profile = bd.Spline((0, 0), (1, 1.5), (3, 1), (4, 0)) + bd.Line((4, 0), (0, 0))
    part = bd.Pos(0, -3, 0) * bd.Box(1, 1, 2) + bd.extrude(bd.make_face(profile), 2)
    low, high = shape_bounds(part)
    assert isinstance(face_evaluator(part.faces()[0].wrapped), PlaneEvaluator)
    with PicklingExecutor(1) as executor:
        found = slice_shape(part, "part", 0.5, 0.01, (low[2], high[2]), executor)
    assert found.volume == pytest.approx(part.volume, rel=1e-5)


def test_layers_near_the_ridges_of_a_lying_torus_and_hole_are_not_missed() -> None:
    """Between the nodes of a coarse triangulation the ridges rise above all of them."""
    torus = cut(bd.Torus(5, 2), 0.01, 0.05)
    assert {len(layer.contours) for layer in torus} == {2}
    z = np.array([layer.middle for layer in torus])
    np.testing.assert_allclose([layer.area for layer in torus], 20 * np.pi * np.sqrt(4 - z**2), rtol=2e-3, atol=1e-9)
    block = bd.Box(10, 10, 4) - bd.Rot(90, 0, 0) * bd.Cylinder(1, 12)
    width = np.array([(100 - layer.area) / 10 for layer in cut(block, 0.01, 0.05)])
    z = np.linspace(-2, 2, 401)
    z = 0.5 * (z[1:] + z[:-1])
    np.testing.assert_allclose(width, 2 * np.sqrt(np.maximum(1 - z**2, 0)), atol=1e-6)


@pytest.mark.slow
def test_a_gyroid_s_contours_are_on_its_faces_and_add_up_to_its_volume() -> None:
    model = tpmscad.lattice("gyroid", cell=10, thickness=1, tol=0.01)
    found = model.slices(0.04, chord_error=0.004)
    assert found.volume == pytest.approx(model.volume, rel=1e-6)
    assert found[0].bottom == pytest.approx(0.0, abs=1e-9)
    assert found[-1].top == pytest.approx(10.0, abs=1e-9)
    layer = found[117]
    points = np.column_stack([np.concatenate(layer.contours), np.full(sum(map(len, layer.contours)), layer.middle)])
    distance = [float(bd.Vertex(*p).distance(model.solid.shell())) for p in points[::7].tolist()]
    assert max(distance) < 1e-7
    middles = np.concatenate([0.5 * (c + np.roll(c, -1, axis=0)) for c in layer.contours])
    section = bd.section(model.solid, bd.Plane.XY.offset(layer.middle))
    wire = bd.Compound(section.edges())
    assert max(float(bd.Vertex(*p, layer.middle).distance(wire)) for p in middles[::7].tolist()) < 0.004 + 1e-6
    assert sum(face.area for face in section.faces()) == pytest.approx(
        layer.area, rel=1e-4
    )  # the kernel's section is approximate
    assert sum(polygon_area(c) for c in layer.contours) == pytest.approx(layer.area, rel=1e-3)


@pytest.fixture(scope="module")
def tube() -> Slices:
    return cut(bd.Pos(3, 4, 5) * (bd.Cylinder(2, 1.25) - bd.Cylinder(1, 2)), 0.5, 0.001)


def test_the_last_layer_is_as_high_as_what_is_left(tube: Slices) -> None:
    heights = [(layer.bottom, layer.top) for layer in tube]
    np.testing.assert_allclose(heights, [(4.375, 4.875), (4.875, 5.375), (5.375, 5.625)])
    assert tube.volume == pytest.approx(1.25 * 3 * np.pi, rel=1e-6)


def test_a_part_that_the_kernel_finds_a_hair_below_zero_begins_at_zero() -> None:
    found = slice_shape(bd.Pos(0, 0, 0.5) * bd.Box(2, 2, 1), "part", 0.5, 0.01, (-1e-7, 1 + 1e-7))
    assert [(layer.bottom, layer.top) for layer in found] == [(0.0, 0.5), (0.5, 1.0)]
    assert "z = 0 to 1," in repr(found)


def test_holes_run_clockwise(tube: Slices) -> None:
    assert sorted(np.sign(polygon_area(contour)) for contour in tube[1].contours) == [-1, 1]


def test_the_layer_interface_holds_every_contour_closed(tube: Slices, tmp_path: Path) -> None:
    tube.write(tmp_path / "tube.cli")
    lines = (tmp_path / "tube.cli").read_text().splitlines()
    heights = [float(line.split("/")[1]) for line in lines if line.startswith("$$LAYER/")]
    assert heights == [4.875, 5.375, 5.625]
    areas = []
    for line in lines:
        if line.startswith("$$POLYLINE/"):
            _, direction, count, *values = line.split("/")[1].split(",")
            points = np.array(values, float).reshape(int(count), 2)
            assert (points[0] == points[-1]).all()
            areas.append(polygon_area(points[:-1]))
            assert int(direction) == (areas[-1] > 0)
    assert sum(areas) == pytest.approx(3 * 3 * np.pi, rel=1e-3)


def test_a_vector_picture_has_a_group_for_each_layer(tube: Slices, tmp_path: Path) -> None:
    tube.write(tmp_path / "tube.svg")
    groups = ElementTree.parse(tmp_path / "tube.svg").getroot().findall("{http://www.w3.org/2000/svg}g")
    assert [group.get("data-top") for group in groups] == ["4.875000", "5.375000", "5.625000"]
    assert all(group[0].get("d", "").count("Z") == 2 for group in groups)


def test_a_reader_of_3mf_finds_the_stack_of_slices(tube: Slices, tmp_path: Path) -> None:
    lib3mf = pytest.importorskip("lib3mf")
    tube.write(tmp_path / "tube.3mf")
    model = lib3mf.get_wrapper().CreateModel()
    reader = model.QueryReader("3mf")
    reader.SetStrictModeActive(True)
    reader.ReadFromFile(str(tmp_path / "tube.3mf"))
    assert reader.GetWarningCount() == 0
    stacks = model.GetSliceStacks()
    assert stacks.MoveNext()
    stack = stacks.GetCurrentSliceStack()
    assert stack.GetSliceCount() == 3
    for number, layer in enumerate(tube):
        of_file = stack.GetSlice(number)
        assert of_file.GetPolygonCount() == len(layer.contours)
        assert of_file.GetZTop() == pytest.approx(layer.top - 4.375, abs=1e-6)
    with zipfile.ZipFile(tmp_path / "tube.3mf") as archive:
        assert archive.testzip() is None


def test_bad_heights_and_files_are_refused(tube: Slices, tmp_path: Path) -> None:
    with pytest.raises(tpmscad.InvalidRequest, match="heights are in mm"):
        cut(bd.Box(1, 1, 200), 1e-3, 0.01)
    with pytest.raises(tpmscad.InvalidRequest, match=r"\.svg"):
        tube.write(tmp_path / "tube.gcode")


def test_the_command_slices_a_file_and_reports(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    part, layers, report = (tmp_path / name for name in ("part.step", "part.cli", "part.json"))
    bd.export_step(bd.Cylinder(2, 1), part)
    assert run(f"slice {part} --height 0.25 --chord-error 0.001 -o {layers} --report {report}") == 0
    assert "4 layers" in capsys.readouterr().out
    assert json.loads(report.read_text())["volume"] == pytest.approx(4 * np.pi, rel=1e-6)
    assert layers.read_text().count("$$LAYER/") == 4
    assert run(f"slice {part} --height 0 -o {layers}") == 2
    assert run(f"slice {part} --height 0.25 -o {tmp_path / 'part.gcode'}") == 2


def outlines(layer: Layer) -> tuple[np.ndarray, np.ndarray]:
    """The corners of the contours of a layer, and points along their chords."""
    corners = np.concatenate(layer.contours)
    ahead = np.concatenate([np.roll(contour, -1, axis=0) for contour in layer.contours])
    return corners, np.concatenate([corners + t * (ahead - corners) for t in np.linspace(0, 1, 40)])


@pytest.mark.parametrize("height", [0.25, 0.32])
def test_repeated_faces_give_the_contours_of_the_whole_solid(height: float) -> None:
    """With a height of .25, layers are cut at heights of corners of patches; with .32, cells are cut at different heights."""
    model = tpmscad.lattice("gyroid", cell=4, cells=(2, 1, 2), thickness=0.5, tol=0.02)
    bounds = [z for *_, z in model.bounding_box]
    found, whole = model.slices(height, 0.01), slice_shape(model.wrapped, model.name, height, 0.01, bounds)
    assert len(found) == len(whole) == 8 / height
    for a, b in zip(found, whole, strict=True):
        assert len(a.contours) == len(b.contours)
        np.testing.assert_allclose([a.area, a.perimeter], [b.area, b.perimeter], rtol=2e-4)
        for (corners, _), (_, chords) in ((outlines(a), outlines(b)), (outlines(b), outlines(a))):
            assert cKDTree(chords).query(corners)[0].max() < 0.02
    assert found.volume == pytest.approx(whole.volume, rel=1e-5)
    assert found.volume == pytest.approx(model.volume, rel=1e-3)


def test_ends_of_curves_that_no_edge_tells_are_joined_where_they_meet(monkeypatch: pytest.MonkeyPatch) -> None:
    model = tpmscad.lattice("schwarz_p", cell=4, cells=(2, 1, 1), thickness=0.5, tol=0.05)
    expected = model.slices(0.5, 0.02)
    name_ends = SlicedFaces._name_ends

    def lose_some(self: SlicedFaces, curves: Any, copies: Any, which: int, n_levels: int) -> np.ndarray:
        name = name_ends(self, curves, copies, which, n_levels)
        name[np.flatnonzero((copies.level == 3) & ~curves.closed[copies.curve])[3 * which : 3 * which + 5]] = -1 - which
        return name

    monkeypatch.setattr(SlicedFaces, "_name_ends", lose_some)
    found = model.slices(0.5, 0.02)
    for own, other in zip(found, expected, strict=True):
        assert all(np.array_equal(a, b) for a, b in zip(own.contours, other.contours, strict=True))


def test_copies_of_faces_that_do_not_meet_are_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    model = tpmscad.lattice("schwarz_p", cell=4, cells=(2, 1, 1), thickness=0.5, tol=0.05)
    moved = SlicedFaces._translations.fget  # type: ignore[attr-defined]
    monkeypatch.setattr(SlicedFaces, "_translations", property(lambda self: 1.001 * moved(self)))
    with pytest.raises(tpmscad.KernelError, match=r"neighbouring faces end 0\.004 apart"):
        model.slices(0.5, 0.02)


def test_a_solid_that_is_open_is_refused() -> None:
    open_box = bd.Solid(bd.Shell(bd.Box(2, 2, 2).faces()[1:]))
    with pytest.raises(tpmscad.KernelError, match="open along 4 of its edges"):
        slice_shape(open_box, "part", 0.5, 0.01, (-1, 1))
