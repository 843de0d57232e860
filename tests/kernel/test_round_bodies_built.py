"""Solids with faces on quadrics: built, written, read back; compared with the quadrature of the boundary representation."""

from __future__ import annotations

import re

import numpy as np
import pytest

pytestmark = pytest.mark.kernel

from OCP.BRep import BRep_Tool
from OCP.BRepAdaptor import BRepAdaptor_Curve, BRepAdaptor_Curve2d, BRepAdaptor_Surface
from OCP.BRepCheck import BRepCheck_Analyzer
from OCP.GeomAbs import GeomAbs_BSplineCurve, GeomAbs_BSplineSurface
from scipy.spatial.transform import Rotation

from tests.shapes.kernel_shapes import plane_box
from tests.shapes.round_shapes import Arc, To, cone, cylinder, flask, frustum, pierced_block, revolved, sphere, torus
from tpmscad.brep.boundary_representation import join_breps, reverse_faces, scale_brep
from tpmscad.brep.solid_properties import measure_solid
from tpmscad.errors import KernelError
from tpmscad.kernel.build.solids import build_solids
from tpmscad.kernel.measure.shape_report import check_shape
from tpmscad.kernel.occt.exploration import edges_of
from tpmscad.kernel.step.brep_writer import write_step
from tpmscad.kernel.step.step_reader import read_step

TURN = Rotation.from_rotvec([0.3, -1.1, 0.7]).as_matrix()
PLACES = {
    "at rest": {},
    "turned": {"rotation": TURN, "translation": (0.4, -7.0, 2.5)},
    "mirrored": {"rotation": np.diag([1.0, -1.0, 1.0]) @ TURN, "translation": (1.0, 2.0, 3.0)},
}


def waist(**place):
    """An hourglass of tori: its profile's arcs lie at negative angles and are run clockwise."""
    return revolved((0, -1.5), [To(2, -1.5), Arc(2, 0, -np.pi), To(0, 1.5)], **place)


SHAPES = {
    "cylinder": lambda **p: cylinder(2, 5, **p),
    "closing frustum": lambda **p: frustum(3, 1, 2, **p),
    "opening frustum": lambda **p: frustum(1, 3, 2, **p),
    "full cone": lambda **p: cone(2, 3, **p),
    "sphere": lambda **p: sphere(2, **p),
    "torus": lambda **p: torus(3, 1, **p),
    "waist": waist,
    "flask": flask,
    "grown flask": lambda **p: scale_brep(flask(**p), 2.5),
    "pierced block": lambda **p: pierced_block(),
}
PLACED = [(s, p) for s in SHAPES for p in PLACES if p == "at rest" or s != "pierced block"]
ENTITIES = {
    "cylinder": "CYLINDRICAL_SURFACE",
    "full cone": "CONICAL_SURFACE",
    "sphere": "SPHERICAL_SURFACE",
    "torus": "TOROIDAL_SURFACE",
    "pierced block": "ELLIPSE",
}


@pytest.mark.parametrize(("shape", "place"), PLACED)
def test_a_round_solid_is_valid_closed_and_outward_at_the_least_tolerance(shape: str, place: str) -> None:
    brep = SHAPES[shape](**PLACES[place])
    report, expected = check_shape(build_solids(brep).shape), measure_solid(brep)
    assert report.ok
    assert report.volume == pytest.approx(expected.volume, rel=1e-11)
    assert report.area == pytest.approx(expected.area, rel=1e-11)
    np.testing.assert_allclose(report.centroid, expected.centroid, atol=1e-10)
    assert report.faces == len(brep.faces)
    assert report.max_tolerance == 1e-7


@pytest.mark.parametrize(("shape", "place"), PLACED)
def test_edges_on_quadrics_take_the_parameter_of_their_parameter_curves(shape: str, place: str) -> None:
    for face in build_solids(SHAPES[shape](**PLACES[place])).faces:
        assert BRepCheck_Analyzer(face).IsValid()
        surface = BRepAdaptor_Surface(face)
        assert surface.GetType() != GeomAbs_BSplineSurface
        for edge in edges_of(face):
            if not BRep_Tool.Degenerated_s(edge):
                along, flat = BRepAdaptor_Curve(edge), BRepAdaptor_Curve2d(edge, face)
                assert along.GetType() != GeomAbs_BSplineCurve
                for t in np.linspace(along.FirstParameter(), along.LastParameter(), 5).tolist():
                    assert surface.Value(*flat.Value(t).Coord()).Distance(along.Value(t)) < 1e-11


def test_loops_at_a_pole_get_a_degenerated_edge_and_others_none() -> None:
    def count(brep) -> int:
        return sum(BRep_Tool.Degenerated_s(e) for f in build_solids(brep).faces for e in edges_of(f))

    assert [count(s) for s in (sphere(2), cone(2, 3), flask(), frustum(3, 1, 2), torus(3, 1))] == [4, 2, 4, 0, 0]


@pytest.mark.parametrize("healed", [True, False])
@pytest.mark.parametrize(("shape", "place"), PLACED)
def test_a_step_file_of_round_faces_reads_back_the_same(shape: str, place: str, healed: bool, tmp_path) -> None:
    brep, path = SHAPES[shape](**PLACES[place]), tmp_path / "round.step"
    write_step(brep, build_solids(brep).nesting, path)
    report, expected = check_shape(read_step(path, healed=healed)), measure_solid(brep)
    assert report.ok
    assert report.faces == len(brep.faces)
    assert report.volume == pytest.approx(expected.volume, rel=1e-11)
    assert report.area == pytest.approx(expected.area, rel=1e-11)
    assert report.max_tolerance == 1e-7


@pytest.mark.parametrize("shape", ENTITIES)
def test_a_step_file_holds_the_quadric_itself(shape: str, tmp_path) -> None:
    brep = SHAPES[shape]()
    write_step(brep, build_solids(brep).nesting, tmp_path / "round.step")
    text = (tmp_path / "round.step").read_text()
    assert re.search(rf"={ENTITIES[shape]}\(''", text)
    assert "B_SPLINE" not in text


def test_a_ball_in_a_ball_is_its_void_and_two_apart_are_two_solids() -> None:
    def split(*parts) -> list[int]:
        return [len(piece) for piece in build_solids(join_breps(parts)).nesting.shells_of_solid]

    thin = reverse_faces(sphere(1.999))
    assert split(sphere(2), thin) == [2]
    assert split(sphere(2), sphere(1, translation=(4.0, 0.0, 0.0))) == [1, 1]
    assert split(plane_box((9.0, 9.0, 9.0)), reverse_faces(torus(3, 1, translation=(4.5, 4.5, 4.5)))) == [2]
    # In the torus' box, and its ball, but in its hole.
    with pytest.raises(KernelError, match="inside out"):
        build_solids(join_breps([torus(3, 1), reverse_faces(sphere(0.5))]))
