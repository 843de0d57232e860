"""STEP files of kernel solids: a file that does not read back is written another way, and told; or the face is named."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import build123d as bd
import numpy as np
import pytest
from OCP.BRep import BRep_Builder

import tpmscad
from tpmscad.errors import KernelError
from tpmscad.files import checked_write
from tpmscad.files.checked_write import WRITERS, write_checked_solids
from tpmscad.kernel.export.shape_file import name_solids, write_shape
from tpmscad.kernel.measure.invalid_faces import describe_invalid_face
from tpmscad.kernel.measure.shape_report import check_shape
from tpmscad.kernel.step.step_reader import read_step

pytestmark = pytest.mark.kernel


def revolved_arc(center: float, *, whole: bool) -> bd.Part:
    """An arc about (center, 0) through (10, 0), from the axis or from the plane z = 0 to the axis, turned about the z axis."""
    radius = 10 - center
    top = float(np.sqrt(radius**2 - center**2))
    half = np.arctan2(top, -center) / 2
    middle = (center + radius * float(np.cos(half)), radius * float(np.sin(half)))
    arc = bd.ThreePointArc((0, -top), (10, 0), (0, top)) if whole else bd.ThreePointArc((10, 0), middle, (0, top))
    rest = [bd.Line((0, top), (0, -top))] if whole else [bd.Line((0, 0), (10, 0)), bd.Line((0, top), (0, 0))]
    return bd.revolve(bd.Plane.XZ * bd.make_face([arc, *rest]), bd.Axis.Z)


def volume_of_revolution(center: float, *, whole: bool) -> float:
    """The integral of pi r(z)^2 over the height, r = center + sqrt(R^2 - z^2), by Gauss's rule in the angle."""
    radius = 10 - center
    nodes, weights = np.polynomial.legendre.leggauss(40)
    end = np.arctan2(np.sqrt(radius**2 - center**2), -center)
    angle = end * (nodes + 1) / 2
    half = float(np.sum(weights * end / 2 * np.pi * (center + radius * np.cos(angle)) ** 2 * radius * np.cos(angle)))
    return 2 * half if whole else half


@pytest.mark.parametrize("whole", [False, True])
@pytest.mark.parametrize("center", [-4, -0.2, 0.5, 4])
def test_an_arc_turned_about_an_axis_that_its_circle_crosses_reads_back(
    center: float, whole: bool, tmp_path: Path
) -> None:
    write_shape(revolved_arc(center, whole=whole), tmp_path / "part.step")
    for healed in (False, True):
        report = check_shape(read_step(tmp_path / "part.step", healed=healed).shape)
        assert report.ok
        assert report.volume == pytest.approx(volume_of_revolution(center, whole=whole), rel=1e-9)


@pytest.mark.slow
def test_a_dome_whose_arc_is_centred_beyond_the_axis_is_filled_and_written(tmp_path: Path) -> None:
    model = tpmscad.infill(revolved_arc(-4, whole=False), "P", cell=14, thickness=2, tol=0.1)
    assert model.certificate.met
    model.export(tmp_path / "dome.step")
    assert tpmscad.check_step(tmp_path / "dome.step").ok


def fail(*_: object, **__: object) -> None:
    raise KernelError("export_step", "the file is damaged")


@pytest.mark.parametrize("failing", range(1, len(WRITERS.methods)))
def test_a_file_that_does_not_read_back_is_written_another_way_and_told(
    failing: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    methods = tuple(replace(m, run=fail) if i < failing else m for i, m in enumerate(WRITERS.methods))
    monkeypatch.setattr(checked_write, "WRITERS", replace(WRITERS, methods=methods))
    box = bd.fillet(bd.Box(2, 3, 4).edges(), 0.3)
    path = tmp_path / "box.step"
    told = rf"box.step was written {WRITERS.methods[failing].name}, since export_step: the file is damaged"
    with pytest.warns(UserWarning, match=told):
        write_checked_solids(name_solids(box, "box"), path, schema="ap242", name="box", volume=box.volume)
    report = tpmscad.check_step(path)
    assert report.ok
    assert report.shape.volume == pytest.approx(box.volume, rel=1e-7)


def test_if_every_way_fails_the_first_reason_leads_and_nothing_is_left(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    methods = tuple(replace(m, run=fail) for m in WRITERS.methods)
    monkeypatch.setattr(checked_write, "WRITERS", replace(WRITERS, methods=methods))
    with pytest.raises(KernelError, match=r"^export_step: the file is damaged$"):
        write_checked_solids(name_solids(bd.Box(1, 1, 1), "b"), tmp_path / "b.step", schema="ap242", name="b", volume=1)
    assert not [*tmp_path.iterdir()]


def test_arrays_that_cannot_be_written_are_written_as_kernel_solids(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    model = tpmscad.lattice("P", cell=10, thickness=1, tol=0.1)
    monkeypatch.setattr(checked_write, "write_step", fail)
    with pytest.warns(UserWarning, match="was written with names, labels and colours, since .*: the file is damaged"):
        model.export(tmp_path / "cell.step")
    assert tpmscad.check_step(tmp_path / "cell.step").ok


def test_the_face_that_the_kernel_rejects_is_named(tmp_path: Path) -> None:
    good = bd.Box(2, 3, 4)
    assert describe_invalid_face(good.wrapped) == ""
    hole_outside = bd.Face.make_rect(2, 2).wrapped
    BRep_Builder().Add(hole_outside, bd.Wire.make_circle(0.5, bd.Plane((5, 5, 0))).wrapped)
    assert describe_invalid_face(hole_outside).startswith("face 0 (Plane about (")
    assert "InvalidImbricationOfWires" in describe_invalid_face(hole_outside)
