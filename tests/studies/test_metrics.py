"""Metrics of solids with known answers; a gyroid's wall and pore beside their closed forms."""

from __future__ import annotations

import json
import pickle
from pathlib import Path
from typing import Any

import build123d as bd
import numpy as np
import pytest

import tpmscad
from tests.cli.test_cli import run
from tpmscad.errors import InvalidRequest
from tpmscad.kernel.measure import shape_sampling
from tpmscad.kernel.occt.exploration import faces_of
from tpmscad.results.placed_model import place_model
from tpmscad.studies import _measure
from tpmscad.studies._measure import Metrics, measure

pytestmark = pytest.mark.kernel

WIDTH = 0.005
"""Relative: what the default spacing leaves."""


def tube(radius: float, bore: float, length: float) -> bd.Part:
    return bd.Cylinder(radius, length) - bd.Cylinder(bore, length)


def width_of(found: object) -> float | None:
    return None if found is None else found.width  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("shape", "wall", "pore"),
    [
        (bd.Box(10, 20, 2), 2.0, None),
        (bd.Rot(20, 30, 40) * bd.Box(7, 9, 1.5), 1.5, None),
        (bd.Sphere(5), 10.0, None),
        (tube(10, 8, 30), 2.0, 16.0),
        (bd.Box(20, 20, 20) - bd.Cylinder(3, 20), 7.0, 6.0),
        (bd.Box(10, 10, 10) - bd.Pos(0, 0, 5) * bd.Box(3, 10, 10), 3.5, 3.0),
        (bd.fillet(bd.Box(10, 20, 2).edges(), 0.9), 2.0, None),
    ],
    ids=["plate", "tilted plate", "ball", "tube", "bore", "slot", "rounded plate"],
)
def test_walls_and_pores_of_simple_solids(shape: bd.Shape, wall: float, pore: float | None) -> None:
    found = measure(shape)
    assert found.smallest_wall is not None
    assert found.smallest_wall.width == pytest.approx(wall, rel=WIDTH)
    assert width_of(found.smallest_pore) == (pore if pore is None else pytest.approx(pore, rel=WIDTH))


def test_hydraulic_diameter_of_a_bore_is_its_diameter() -> None:
    found = measure(bd.Box(20, 20, 20) - bd.Cylinder(3, 20))
    assert found.hydraulic_diameter == pytest.approx(6.0, rel=1e-9)
    assert found.wetted_area == pytest.approx(2 * np.pi * 3 * 20, rel=1e-9)
    assert found.volume_fraction == pytest.approx(1 - np.pi * 9 / 400, rel=1e-9)
    assert found.surface_per_volume == pytest.approx(found.wetted_area / 8000, rel=1e-12)


def test_a_channel_is_measured_as_the_fluid_itself() -> None:
    """A round channel between two faces of a box: its own diameter, which the void around it does not have."""
    channel = bd.Cylinder(3, 20)
    found = measure(channel, within=((-10, -10, -10), (10, 10, 10)), is_fluid=True)
    assert found.hydraulic_diameter == pytest.approx(6.0, rel=1e-9)
    assert found.smallest_wall is None
    assert width_of(found.smallest_pore) == pytest.approx(6.0, rel=WIDTH)
    other = measure(channel, within=((-10, -10, -10), (10, 10, 10)))
    assert other.hydraulic_diameter == pytest.approx(4 * (8000 - np.pi * 180) / (2 * np.pi * 60), rel=1e-9)


def test_the_text_gives_units_and_says_smallest() -> None:
    found = measure(bd.Box(20, 20, 20) - bd.Cylinder(3, 20))
    text = repr(found)
    assert text == str(found)
    for words in ("mm3", "mm2", "hydraulic diameter  6 mm", "smallest wall  ", "smallest pore  "):
        assert words in text


def test_within_a_body_only_what_is_inside_it_is_void_and_wetted() -> None:
    found = measure(tube(10, 8, 30), within=bd.Cylinder(10, 30))
    assert found.volume_fraction == pytest.approx(0.36, rel=1e-9)
    assert found.hydraulic_diameter == pytest.approx(16.0, rel=1e-9)


@pytest.fixture
def no_widths(monkeypatch: pytest.MonkeyPatch) -> None:
    """Envelopes are measured without the search for the least widths, which takes most of the time."""
    monkeypatch.setattr(_measure, "measure_least_widths", lambda shape, report: (None, None))


@pytest.mark.slow
@pytest.mark.usefixtures("no_widths")
def test_what_a_model_was_made_in_is_its_envelope() -> None:
    body = bd.Cylinder(4.5, 6)
    model = tpmscad.infill(body, "P", cell=8, thickness=1, tol=0.1)
    found, told = measure(model), measure(model, within=body)
    assert found.envelope == "the body"
    assert found.volume_fraction == pytest.approx(model.volume / body.volume, rel=1e-9)
    assert (found.wetted_area, found.hydraulic_diameter) == (told.wetted_area, told.hydraulic_diameter)
    assert f"{found.volume_fraction:.6g} of {body.volume:.6g} mm3, the body" in str(found)
    again = pickle.loads(pickle.dumps(model))
    assert measure(again).to_dict() == found.to_dict()
    foreign = measure(model.wrapped)
    assert foreign.envelope == "the smallest box around the solid"
    assert foreign.envelope_volume == pytest.approx(np.prod(np.ptp(model.bounding_box, axis=0)), rel=1e-6)


@pytest.mark.slow
@pytest.mark.usefixtures("no_widths")
def test_the_envelope_of_a_lattice_is_the_box_of_its_cells_and_goes_where_it_is_put() -> None:
    model = tpmscad.lattice("P", cell=(4, 5, 6), cells=(2, 1, 1), thickness=0.6, tol=0.1)
    found = measure(model)
    assert found.envelope_volume == pytest.approx(8 * 5 * 6, rel=1e-12)
    placed = place_model(model, (bd.Location((3, 2, 1), (10, 20, 30)) * model.solid).wrapped)
    assert measure(placed).wetted_area == pytest.approx(found.wetted_area, rel=1e-9)


def test_within_a_larger_box_every_face_is_wetted() -> None:
    found = measure(bd.Box(2, 2, 2), within=((-2, -2, -2), (2, 2, 2)))
    assert (found.envelope_volume, found.wetted_area) == pytest.approx((64.0, 24.0), rel=1e-9)


@pytest.fixture(scope="module")
def gyroid() -> tpmscad.Model:
    return tpmscad.lattice("gyroid", cell=10, thickness=1, tol=0.02)


@pytest.fixture(scope="module")
def measured(gyroid: tpmscad.Model) -> Metrics:
    return measure(gyroid)


@pytest.mark.slow
def test_the_wall_of_a_sheet_is_its_thickness(gyroid: tpmscad.Model, measured: Metrics) -> None:
    assert width_of(measured.smallest_wall) == pytest.approx(1.0, rel=WIDTH)
    assert measured.pieces == len(gyroid.certificate.pieces)
    assert measured.volume_fraction == pytest.approx(gyroid.certificate.volume / 1000, rel=1e-6)


def test_the_command_line_prints_and_reports_the_metrics_of_a_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    part = tpmscad.lattice("P", cell=10, thickness=1)
    part.export_step(tmp_path / "part.step")
    assert run(f"check {tmp_path / 'part.step'} --metrics --report {tmp_path / 'out.json'}") == 0
    written = json.loads((tmp_path / "out.json").read_text())["metrics"]
    assert set(written) == set(Metrics.__dataclass_fields__)
    expected = measure(part)
    assert written["wetted_area"] == pytest.approx(expected.wetted_area, rel=1e-9)
    for name in ("smallest_wall", "smallest_pore"):
        assert written[name]["width"] == pytest.approx(width_of(getattr(expected, name)), rel=1e-6)
    assert written["smallest_wall"]["width"] == pytest.approx(1.0, rel=WIDTH)
    assert "hydraulic" in capsys.readouterr().out


@pytest.mark.slow
def test_the_pore_of_a_gyroid_lies_between_flat_points(measured: Metrics) -> None:
    """Its channels are narrowest at their nodes (1/8, 1/8, 1/8): from flat point to flat point along 111, a quarter diagonal."""
    assert width_of(measured.smallest_pore) == pytest.approx(10.0 * 3**0.5 / 4 - 1.0, rel=WIDTH)


def test_solids_that_touch_are_not_measured() -> None:
    with pytest.raises(InvalidRequest, match="touch"):
        measure(bd.Compound([bd.Box(2, 2, 2).solid(), (bd.Pos(2, 0, 0) * bd.Box(2, 2, 2)).solid()]))


def test_samples_lie_on_trimmed_faces_and_nowhere_else() -> None:
    plate = bd.Box(10, 10, 2) - bd.Cylinder(3, 2)
    found = shape_sampling.sample_faces(faces_of(plate), 0.1)
    x, y, z = found.points.T
    top = np.isclose(z, 1.0) & np.isclose(found.normals[:, 2], 1.0)
    assert np.hypot(x[top], y[top]).min() >= 3.0 - 0.01
    assert top.sum() * 0.01 == pytest.approx(100 - 9 * np.pi, rel=0.01)
    bore = np.isclose(np.hypot(x, y), 3.0)
    assert (np.einsum("ij,ij->i", found.points[bore], found.normals[bore]) < 0).all()


def test_a_face_too_narrow_for_any_sample_counts_as_wetted(monkeypatch: pytest.MonkeyPatch) -> None:
    box, sample_faces = bd.Box(3, 4, 5), shape_sampling.sample_faces

    def leave_one_out(faces: list[Any], spacing: float) -> shape_sampling.FaceSamples:
        found = sample_faces(faces, spacing)
        kept = found.face != 2
        return shape_sampling.FaceSamples(found.points[kept], found.normals[kept], found.face[kept])

    assert measure(box).wetted_area == 0.0
    monkeypatch.setattr(_measure, "sample_faces", leave_one_out)
    assert measure(box).wetted_area == pytest.approx(bd.Face(faces_of(box)[2]).area, rel=1e-9)
