"""Cylinders, cones and tori whose seam crosses a face: they are read and written with the seam beside the face."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytestmark = pytest.mark.kernel

import build123d as bd
from OCP.BRepTools import BRepTools
from OCP.Geom import Geom_CylindricalSurface
from OCP.GeomAPI import GeomAPI_ProjectPointOnSurf
from OCP.gp import gp_Ax3, gp_Cone, gp_Cylinder, gp_Dir, gp_Pnt, gp_Torus

from tpmscad.brep.carriers import CylindricalSurface
from tpmscad.kernel.export.shape_file import write_shape
from tpmscad.kernel.measure.shape_report import check_shape, check_step
from tpmscad.kernel.occt.seams import turn_seam_aside
from tpmscad.kernel.recognise.face_carriers import recognise_carrier


def split_ring() -> bd.Part:
    """A cylinder of 300 degrees about its seam, with four radial holes."""
    arc = bd.CenterArc((0, 0), 10, -150, 300)
    part = bd.extrude(bd.make_face([arc, bd.Line(arc @ 1, arc @ 0)]), 10)
    for angle in (0, 40, -60, 120):
        part -= bd.Rot(0, 0, angle) * bd.Pos(8, 0, 5) * bd.Rot(0, 90, 0) * bd.Cylinder(2, 10)
    return part


def across_seam(part: bd.Part) -> list[bd.Face]:
    cylinders = part.faces().filter_by(bd.GeomType.CYLINDER)
    return [face for face in cylinders if BRepTools.UVBounds_s(face.wrapped)[1] > 2 * np.pi + 1]


def test_a_face_across_the_seam_is_valid_in_a_file_without_healing(tmp_path: Path) -> None:
    part = split_ring()
    assert len(across_seam(part)) == 1
    write_shape(part, tmp_path / "ring.step")
    again = check_step(tmp_path / "ring.step", healed=False)
    assert again.ok
    assert again.shape.volume == pytest.approx(check_shape(part.wrapped).volume, rel=1e-9)


@pytest.mark.parametrize("right_handed", [True, False])
def test_a_turned_surface_is_the_same_with_its_seam_opposite_the_face(right_handed: bool) -> None:
    frame = gp_Ax3(gp_Pnt(1, 2, 3), gp_Dir(1, 2, 2), gp_Dir(2, 1, -2))
    if not right_handed:
        frame.YReverse()
    cylinder = Geom_CylindricalSurface(frame, 2.0)
    low, high = 5.0, 8.0
    turned = turn_seam_aside(cylinder, low, high)
    for u, expected in ((low, np.pi - 1.5), (0.5 * (low + high), np.pi), (high, np.pi + 1.5)):
        foot = GeomAPI_ProjectPointOnSurf(cylinder.Value(u, 1.5), turned)
        assert foot.LowerDistance() < 1e-14
        assert foot.LowerDistanceParameters() == pytest.approx((expected, 1.5))


@pytest.mark.parametrize(
    ("low", "high", "turns"),
    [(0.0, 6.2, False), (-1e-9, 3.0, False), (1.0, 2 * np.pi, False), (0.5, 0.5 + 2 * np.pi, False), (-1.0, 1.0, True)],
)
def test_only_a_seam_within_a_face_that_does_not_go_all_round_is_turned(low: float, high: float, turns: bool) -> None:
    frame = gp_Ax3(gp_Pnt(0, 0, 0), gp_Dir(0, 0, 1), gp_Dir(1, 0, 0))
    for value in (gp_Cylinder(frame, 2.0), gp_Cone(frame, 0.3, 2.0), gp_Torus(frame, 3.0, 1.0)):
        x_axis = turn_seam_aside(value, low, high).Position().XDirection().Coord()
        assert x_axis == pytest.approx((-1, 0, 0) if turns else (1, 0, 0))


def test_a_carrier_has_its_seam_beside_its_face() -> None:
    part = split_ring()
    (face,) = across_seam(part)
    carrier = recognise_carrier(face.wrapped, 20.0)
    assert isinstance(carrier, CylindricalSurface)
    border = np.array([tuple(edge.position_at(t)) for edge in face.edges() for t in np.linspace(0, 1, 9)])
    u = carrier.parameters(border)[:, 0] % (2 * np.pi)
    assert (u.min(), u.max()) == pytest.approx(np.deg2rad([30, 330]))
