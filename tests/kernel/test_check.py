"""Shapes measured against closed forms: OCC's own primitives, moved, turned over and broken."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

pytestmark = pytest.mark.kernel

from OCP.BRepBuilderAPI import BRepBuilderAPI_NurbsConvert
from OCP.BRepPrimAPI import (
    BRepPrimAPI_MakeCone,
    BRepPrimAPI_MakeCylinder,
    BRepPrimAPI_MakeSphere,
    BRepPrimAPI_MakeTorus,
)
from OCP.gp import gp_Ax1, gp_Dir, gp_Pnt, gp_Trsf, gp_Vec
from OCP.TopLoc import TopLoc_Location

from tests.shapes.kernel_shapes import CASES, drilled_dome, plane_box
from tpmscad.brep.boundary_representation import move_brep
from tpmscad.brep.moments import integral_properties
from tpmscad.kernel.build.solids import build_solids
from tpmscad.kernel.measure.shape_report import StepReport, check_shape
from tpmscad.kernel.occt.construction import make_compound, make_shell, make_solid
from tpmscad.rigid_motion import Motion

PI = np.pi
ROUND = {
    "cylinder": (BRepPrimAPI_MakeCylinder(2.0, 5.0), 20 * PI, 28 * PI),
    "sphere": (BRepPrimAPI_MakeSphere(3.0), 36 * PI, 36 * PI),
    "torus": (BRepPrimAPI_MakeTorus(5.0, 1.5), 2 * PI**2 * 5.0 * 1.5**2, 4 * PI**2 * 7.5),
    "cone": (BRepPrimAPI_MakeCone(3.0, 0.0, 4.0), 12 * PI, 24 * PI),
}


@pytest.mark.parametrize("name", ROUND)
@pytest.mark.parametrize("as_splines", [False, True], ids=["analytic", "rational"])
def test_round_bodies_have_their_volume_and_area(name: str, as_splines: bool) -> None:
    maker, volume, area = ROUND[name]
    shape = BRepBuilderAPI_NurbsConvert(maker.Shape()).Shape() if as_splines else maker.Shape()
    report = check_shape(shape)
    assert report.volume == pytest.approx(volume, rel=1e-6)
    assert report.area == pytest.approx(area, rel=1e-6)
    assert report.closed
    assert report.valid
    assert report.outward


def moved() -> gp_Trsf:
    turn, shift = gp_Trsf(), gp_Trsf()
    turn.SetRotation(gp_Ax1(gp_Pnt(0, 0, 0), gp_Dir(1, 2, 3)), 0.7)
    shift.SetTranslation(gp_Vec(10.0, -4.0, 2.5))
    return shift.Multiplied(turn)


def test_placed_copies_are_counted_each_and_measured_where_they_stand() -> None:
    solid = build_solids(drilled_dome()).shape
    alone = check_shape(solid)
    pair = check_shape(make_compound([solid, solid.Moved(TopLoc_Location(moved()))]))
    assert (pair.solids, pair.faces, pair.edges) == (2, 2 * alone.faces, 2 * alone.edges)
    assert pair.volume == pytest.approx(2 * alone.volume, rel=1e-14)
    there = gp_Pnt(*alone.centroid).Transformed(moved()).Coord()
    np.testing.assert_allclose(pair.centroid, (np.array(alone.centroid) + there) / 2, atol=1e-12)


def test_trimmed_areas_agree_with_those_of_the_boundary_representation() -> None:
    moments = integral_properties.integrate_faces(drilled_dome())
    assert check_shape(build_solids(drilled_dome()).shape).area == pytest.approx(moments.area.sum(), rel=1e-7)


def test_a_solid_turned_inside_out_is_noticed() -> None:
    report = check_shape(build_solids(plane_box()).shape.Reversed())
    assert not report.outward
    assert not report.ok
    assert report.volume == pytest.approx(-30.0)


def test_a_solid_with_a_face_missing_is_noticed() -> None:
    faces = build_solids(plane_box()).faces
    report = check_shape(make_solid([make_shell(faces[:5])]))
    assert not report.closed
    assert not report.ok


def test_a_report_is_plain_values_and_says_what_it_found() -> None:
    report = check_shape(build_solids(CASES["box with a void"]()).shape)
    assert json.loads(json.dumps(report.to_dict()))["volume"] == pytest.approx(29.0)
    assert "1 solids, 2 shells, 12 faces, 24 edges" in str(report)
    assert report.bounds == ((0.0, 0.0, 0.0), (2.0, 3.0, 5.0))
    assert report.volumes == pytest.approx((29.0,))


def test_inner_knots_change_nothing() -> None:
    """The same patch with knots put in it, its poles found by SciPy, has the same moments to round-off."""
    from scipy.interpolate import insert as insert_knot

    whole = CASES["bent cube"]()
    split = []
    for surface in whole.carriers:
        poles, u, v = surface.poles, surface.knots_u, surface.knots_v
        for t in (0.3, 0.7):
            u, poles = _inserted(insert_knot, t, u, poles, surface.degree_u)
        v, turned = _inserted(insert_knot, 0.45, v, np.swapaxes(poles, 0, 1), surface.degree_v)
        split.append(type(surface)(np.swapaxes(turned, 0, 1), u, v, surface.degree_u, surface.degree_v))
    knotted = replace(whole, carriers=tuple(split))
    before, after = (check_shape(_solid(c)) for c in (whole, knotted))
    assert after.volume == pytest.approx(before.volume, rel=1e-13)
    assert after.area == pytest.approx(before.area, rel=1e-9)
    np.testing.assert_allclose(after.centroid, before.centroid, atol=1e-13)


def _solid(brep):
    from tpmscad.kernel.build.solids import build_faces

    return make_solid([make_shell(build_faces(brep))])


def _inserted(insert_knot, t, knots, poles, degree):
    n, m, _ = poles.shape
    padded = np.concatenate([poles.reshape(n, -1), np.zeros((degree + 1, 3 * m))])
    columns = [insert_knot(t, (knots, column, degree)) for column in padded.T]
    return columns[0][0], np.stack([c[1][: n + 1] for c in columns], axis=1).reshape(n + 1, m, 3)


def test_round_faces_are_measured_to_round_off() -> None:
    """Trimmed tori above all, which OCCT's quadrature misses by 3e-8 when it is asked for 1e-9."""
    import build123d as bd

    half_ring = bd.Torus(4, 1) - bd.Pos(0, 0, 2) * bd.Box(12, 12, 4)
    slice_of_ball = bd.Sphere(3) & bd.Pos(0, 0, 1.5) * bd.Box(8, 8, 1)
    for solid, volume, area in (
        (half_ring, 4 * np.pi**2, 8 * np.pi**2 + 16 * np.pi),
        (slice_of_ball, 20 / 3 * np.pi, (6 + 8 + 5) * np.pi),
    ):
        report = check_shape(solid.solid())
        assert report.volume == pytest.approx(volume, rel=1e-13)
        assert report.area == pytest.approx(area, rel=1e-13)
        mirrored = check_shape(bd.mirror(bd.Rot(10, 20, 30) * solid.solid(), bd.Plane.YZ))
        assert mirrored.volume == pytest.approx(volume, rel=1e-12)
        np.testing.assert_allclose(np.linalg.norm(mirrored.centroid), np.linalg.norm(report.centroid), rtol=1e-10)


@pytest.mark.parametrize("off", [0.3, 1e-2, 1e-4])
def test_edges_that_pass_a_pole_are_followed(off: float) -> None:
    """A ball cut beside its axis: along the cut's edge the angle about the axis turns by nearly half a turn at once."""
    import build123d as bd

    piece = (bd.Sphere(3) - bd.Pos(5 + off, 0, 0) * bd.Box(10, 10, 10)).solid()
    height = 3 + off
    assert check_shape(piece).volume == pytest.approx(np.pi * height**2 * (9 - height) / 3, rel=1e-9)


def test_far_from_the_origin_trimmed_faces_have_the_same_volume_and_centroid() -> None:
    place = np.array([10000.0, 3000.0, -500.0])
    far = check_shape(build_solids(move_brep(drilled_dome(), Motion(np.eye(3), place))).shape)
    near = check_shape(build_solids(drilled_dome()).shape)
    assert far.volume == pytest.approx(near.volume, rel=1e-12)
    assert np.array(far.centroid) - place == pytest.approx(near.centroid, abs=1e-9)


def test_corners_are_told_to_the_tolerance() -> None:
    report = check_shape(build_solids(plane_box()).shape)
    report = replace(report, bounds=((-1e-7, 0.0, 3e-8), (2.0000001, 3.0, 5.0)))
    told = StepReport("box.step", report, ("millimetre",), ("box",)).summary()
    assert "from (0, 0, 0) to (2, 3, 5)" in told
