"""Spheres of files without parameter curves are read as they were written, and faces of one sphere do not cover each other."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("OCP")

import build123d as bd
from OCP.Interface import Interface_Static
from OCP.STEPControl import STEPControl_AsIs, STEPControl_Reader, STEPControl_Writer

from tpmscad.errors import InvalidRequest, NotQuadric
from tpmscad.kernel.body_import import body_brep
from tpmscad.kernel.body_import.body_brep import brep_from_shape
from tpmscad.kernel.body_import.cad_body import read_body
from tpmscad.kernel.measure.mass_properties import face_moments
from tpmscad.kernel.occt.exploration import faces_of, solids_of
from tpmscad.kernel.step import step_reader
from tpmscad.kernel.step.step_reader import read_step, silence_occt

pytestmark = pytest.mark.kernel

RADIUS = 10.0


def write_without_pcurves(shape: bd.Shape, path: Path) -> Path:
    writer = STEPControl_Writer()
    before = Interface_Static.IVal_s("write.surfacecurve.mode")
    Interface_Static.SetIVal_s("write.surfacecurve.mode", 0)
    try:
        with silence_occt():
            writer.Transfer(shape.solids()[0].wrapped, STEPControl_AsIs)
            writer.Write(str(path))
    finally:
        Interface_Static.SetIVal_s("write.surfacecurve.mode", before)
    return path


def read_by_occt(path: Path):
    reader = STEPControl_Reader()
    with silence_occt():
        reader.ReadFile(str(path))
        reader.TransferRoots()
    return solids_of(reader.OneShape())[0]


def bored_quarter() -> bd.Shape:
    """A quarter of a ball with a bore along each of two axes: half of their edges on the sphere lie beyond its seam."""
    quarter = bd.Sphere(RADIUS) & bd.Pos(20, 20, 0) * bd.Box(40, 40, 40)
    for plane in (bd.Plane.YZ, bd.Plane.XZ):
        quarter -= bd.extrude(plane * bd.Circle(0.3 * RADIUS), 4 * RADIUS, both=True)
    return quarter


@pytest.fixture(scope="module")
def quarter_with_leg(tmp_path_factory: pytest.TempPathFactory) -> tuple[bd.Shape, Path]:
    """Such a quarter with a leg that ends in the same sphere, away from the origin, and its file."""
    start = bd.Plane((0.4 * RADIUS, 0.4 * RADIUS, -0.1 * RADIUS), z_dir=(-1, -1, 0.3))
    leg = bd.extrude(start * bd.Circle(0.2 * RADIUS), 2 * RADIUS) & bd.Sphere(RADIUS)
    body = bd.Pos(7, -3, 2) * (bored_quarter() + leg)
    return body, write_without_pcurves(body, tmp_path_factory.mktemp("spheres") / "leg.step")


def volume_of(solid) -> float:
    return float(face_moments(faces_of(solid))[:, 1].sum())


def test_a_file_without_pcurves_is_read_as_it_was_written(quarter_with_leg: tuple[bd.Shape, Path]) -> None:
    body, path = quarter_with_leg
    assert volume_of(read_by_occt(path)) > 2 * body.volume  # else there is nothing to be seen here
    (solid,) = read_step(path, with_clear_seams=True).solids
    assert volume_of(solid) == pytest.approx(body.volume, rel=1e-6)
    assert len(faces_of(solid)) == len(body.faces())
    brep_from_shape(solid)


def test_a_body_with_a_face_that_covers_another_is_refused(quarter_with_leg: tuple[bd.Shape, Path]) -> None:
    body, path = quarter_with_leg
    with pytest.raises(InvalidRequest, match=r"cover each other.*give the path"):
        read_body(read_by_occt(path))
    assert read_body(path).volume == pytest.approx(body.volume, rel=1e-6)


def test_files_with_pcurves_are_translated_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    calls = []
    translate = step_reader._translate
    monkeypatch.setattr(step_reader, "_translate", lambda *given: calls.append(1) or translate(*given))
    bd.export_step(bored_quarter(), tmp_path / "quarter.step")  # writes them
    (solid,) = read_step(tmp_path / "quarter.step", with_clear_seams=True).solids
    assert len(calls) == 1
    assert volume_of(solid) == pytest.approx(bored_quarter().volume, rel=1e-6)


@pytest.mark.parametrize("turn", [0.0, 90.0, 31.0])
def test_bodies_with_two_faces_on_one_sphere_are_read(turn: float, tmp_path: Path) -> None:
    """A ball with a groove round it has two caps, each with an edge across the seam or about a pole."""
    groove = bd.Box(30, 30, 4) - bd.Cylinder(6, 4)
    ball = bd.Rotation(turn, 0.4 * turn, 0) * (bd.Sphere(RADIUS) - bd.Pos(0, 0, 1) * groove)
    path = write_without_pcurves(ball, tmp_path / "ball.step")
    assert read_body(path).volume == pytest.approx(ball.volume, rel=1e-6)
    assert read_body(ball).volume == pytest.approx(ball.volume, rel=1e-9)


def test_a_face_of_another_area_is_named() -> None:
    ball = (bd.Sphere(RADIUS) - bd.Pos(0, 0, 1) * (bd.Box(30, 30, 4) - bd.Cylinder(6, 4))).solids()[0].wrapped
    brep, source = body_brep.brep_and_source_faces(ball)
    faces = faces_of(ball)
    cap, other = (i for i, face in enumerate(faces) if bd.Face(face).geom_type == bd.GeomType.SPHERE)
    swapped = source.copy()
    swapped[source == cap], swapped[source == other] = other, cap
    assert np.ptp(face_moments([faces[cap], faces[other]])[:, 0]) > 1.0
    with pytest.raises(NotQuadric, match=f"face {min(cap, other)} .* has the area"):
        body_brep._check_closed_and_volume(brep, swapped, faces, 20.0, 0.0, 0.0, 0.0)
    body_brep._check_closed_and_volume(brep, source, faces, 20.0, 0.0, 0.0, 0.0)
