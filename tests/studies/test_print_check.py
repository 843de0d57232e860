"""The check before printing finds the faults that were built in, with the values of closed formulas, and invents none."""

from __future__ import annotations

import json
import re
from pathlib import Path

import build123d as bd
import numpy as np
import pytest

import tpmscad
from tests.cli.test_cli import run
from tpmscad.studies._check_print import PrintReport, check_print

pytestmark = pytest.mark.kernel

WALL, GAP, OVERHANG = 0.5, 0.5, 45.0


def check(shape: bd.Shape, **changed: object) -> PrintReport:
    limits = {"min_wall": WALL, "min_gap": GAP, "max_overhang": OVERHANG, **changed}
    return check_print(shape, **limits)


def faults(report: PrintReport) -> set[str]:
    return {fault.check for fault in report.faults}


def fin() -> bd.Part:
    """A block with a fin of 0.4 mm on top."""
    return bd.Pos(0, 0, 3) * bd.Box(6, 6, 6) + bd.Pos(1, 0, 7) * bd.Box(0.4, 5, 2)


def test_a_sound_part_has_no_fault() -> None:
    report = check(bd.Pos(0, 0, 3) * (bd.Box(8, 6, 6) - bd.Cylinder(2, 6)))
    assert report.met
    assert report["wall"].value == pytest.approx(1.0)
    assert report["gap"].value == pytest.approx(4.0)
    assert report["overhang"].value == 0.0
    assert report["cavities"].value == 0
    assert report.plate_area == pytest.approx(48 - 4 * np.pi)


def test_a_thin_fin_is_found_where_it_is() -> None:
    report = check(fin())
    assert faults(report) == {"wall"}
    assert report["wall"].value == pytest.approx(0.4, abs=1e-9)
    x, y, z = report["wall"].place or ()
    assert x == pytest.approx(1.0)
    assert abs(y) <= 2.5
    assert 6.0 <= z <= 8.0


def test_the_text_of_a_wall_and_a_gap_names_value_bound_and_both_places() -> None:
    report = check(bd.Pos(0, 0, 3) * bd.Box(6, 6, 6) - bd.Pos(1, 0, 5) * bd.Box(0.3, 6, 4))
    for finding in (report.smallest_wall, report.smallest_gap):
        assert finding.places is not None
        ends = np.array([[float(x) for x in at.split(", ")] for at in re.findall(r"\(([^)]*)\)", str(finding))])
        np.testing.assert_allclose(ends, finding.places, atol=1e-3)
        assert np.linalg.norm(ends[1] - ends[0]) == pytest.approx(finding.value, abs=2e-3)
        assert f"{finding.value:.4g} mm from (" in str(finding)
        assert f"proven: none below {finding.bound:.4g}" in str(finding)
        assert str(finding) in str(report)


def test_a_narrow_slot_is_found_where_it_is() -> None:
    report = check(bd.Pos(0, 0, 3) * bd.Box(6, 6, 6) - bd.Pos(1, 0, 5) * bd.Box(0.3, 6, 4))
    assert faults(report) == {"gap"}
    assert report["gap"].value == pytest.approx(0.3, abs=1e-9)
    assert (report["gap"].place or ())[0] == pytest.approx(1.0)
    assert report["wall"].value == pytest.approx(1.85)


def test_the_gap_between_edges_of_two_solids_is_found() -> None:
    pair = bd.Compound([bd.Box(4, 4, 4), bd.Pos(4.1, 4.2, 0) * bd.Box(4, 4, 4)])
    report = check(pair)
    assert faults(report) == {"gap"}
    assert report["gap"].value == pytest.approx(np.hypot(0.1, 0.2))


def test_the_waist_of_a_turned_part_is_refined_to_its_least_width() -> None:
    """Samples lie beside the waist, where it is wider."""
    report = check(bd.Cylinder(1, 4) - bd.Torus(2.17, 2))
    assert report["wall"].value == pytest.approx(0.34, abs=1e-8)
    np.testing.assert_allclose(report["wall"].place or (), 0.0, atol=1e-6)


def test_a_ceiling_has_its_area_and_ninety_degrees() -> None:
    table = bd.Pos(0, 0, 3) * bd.Box(2, 2, 6) + bd.Pos(0, 0, 7) * bd.Box(8, 2, 2)
    report = check(table)
    assert faults(report) == {"overhang"}
    assert report["overhang"].value == pytest.approx(90.0)
    assert report["overhang"].area == pytest.approx(12.0)
    assert (report["overhang"].place or ())[2] == pytest.approx(6.0)
    upside_down = check(table, build_direction="-z")
    assert upside_down.met
    assert upside_down.plate_area == pytest.approx(16.0)


@pytest.mark.parametrize("limit", [30.0, 60.0])
def test_the_overhang_of_a_ball_is_a_spherical_cap(limit: float) -> None:
    report = check(bd.Sphere(3), max_overhang=limit, min_wall=2.0, min_gap=2.0)
    assert report["overhang"].area == pytest.approx(18 * np.pi * (1 - np.sin(np.radians(limit))), rel=1e-4)
    assert report["overhang"].value == pytest.approx(90.0, abs=1e-4)


def test_a_cone_within_its_angle_stands_on_its_tip_without_overhang() -> None:
    cone = bd.Rot(180, 0, 0) * bd.Cone(3, 0.5, 6)
    angle = np.degrees(np.arctan2(2.5, 6))
    assert check(cone, max_overhang=angle + 0.01).met
    report = check(cone, max_overhang=angle - 0.01)
    assert faults(report) == {"overhang"}
    assert report["overhang"].value == pytest.approx(angle)
    assert report["overhang"].area == pytest.approx(np.pi * 3.5 * np.hypot(6, 2.5), rel=1e-6)


def test_a_face_at_the_limit_itself_keeps_it() -> None:
    assert check(bd.Cone(1, 4, 3), max_overhang=45.0).met


def test_powder_is_trapped_in_a_hollow_ball_but_not_with_a_drain() -> None:
    hollow = bd.Sphere(4) - bd.Sphere(3)
    report = check(hollow, max_overhang=None, min_wall=0.9)
    assert faults(report) == {"cavities"}
    assert report["cavities"].value == 1
    assert report["cavities"].volume == pytest.approx(36 * np.pi)
    assert np.linalg.norm(report["cavities"].place or ()) < 3.0
    assert check(hollow - bd.Pos(0, 0, 3) * bd.Cylinder(0.5, 4), max_overhang=None, min_gap=0.9, min_wall=0.9).met


def test_a_loose_ball_in_a_cavity_takes_up_its_volume() -> None:
    rattle = bd.Compound([bd.Sphere(4) - bd.Sphere(3), bd.Sphere(2) - bd.Sphere(1)])
    report = check(rattle, max_overhang=None, min_wall=0.9, min_gap=0.9)
    assert report["cavities"].value == 2
    assert report["cavities"].volume == pytest.approx(4 / 3 * np.pi * (27 - 8 + 1))


def test_what_cannot_be_checked_is_refused() -> None:
    with pytest.raises(tpmscad.InvalidRequest, match="solids that touch"):
        check(bd.Compound([bd.Box(2, 2, 2), bd.Pos(2, 0, 0) * bd.Box(2, 2, 2)]))
    with pytest.raises(tpmscad.InvalidRequest, match="90 degrees"):
        check(bd.Box(1, 1, 1), max_overhang=100)
    with pytest.raises(tpmscad.InvalidRequest, match="names no axis"):
        check(bd.Box(1, 1, 1), build_direction="up")


def test_the_command_judges_a_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    part, report = tmp_path / "part.step", tmp_path / "report.json"
    bd.export_step(fin(), part)
    assert run(f"check {part} --print --min-wall 0.3 --min-gap 0.3 --max-overhang 45") == 0
    assert "smallest wall   0.4 mm" in capsys.readouterr().out
    assert run(f"check {part} --print --min-wall 0.5 --report {report}") == 1
    assert "FAULT smallest wall" in capsys.readouterr().err
    found = json.loads(report.read_text())["print"]
    assert not found["met"]
    assert found["findings"][0]["value"] == pytest.approx(0.4)
    assert run(f"check {part} --print --max-overhang 45 --build-direction 1,0,0") == 1
    assert run(f"check {part} --min-wall 0.3") == 2
