"""Solids built from boundary representations: shared topology, outward, exact; compared with their own quadrature."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest

pytestmark = pytest.mark.kernel

from OCP.BRep import BRep_Tool
from OCP.BRepAdaptor import BRepAdaptor_Curve, BRepAdaptor_Curve2d, BRepAdaptor_Surface
from OCP.GeomAbs import GeomAbs_Line
from OCP.TopAbs import TopAbs_EDGE, TopAbs_FACE, TopAbs_SHELL, TopAbs_VERTEX

from tests.shapes.kernel_shapes import CASES, plane_box
from tpmscad.brep.boundary_representation import join_breps, reverse_faces, select_faces
from tpmscad.brep.moments import integral_properties
from tpmscad.errors import KernelError
from tpmscad.kernel.build.solids import build_solids, select_solids
from tpmscad.kernel.measure.shape_report import check_shape
from tpmscad.kernel.occt import convert
from tpmscad.kernel.occt.exploration import count_subshape_uses, edges_of


@pytest.fixture(params=CASES)
def brep(request):
    return CASES[request.param]()


def test_a_solid_is_valid_closed_and_outward_with_the_patches_volume_area_and_centre(brep) -> None:
    built = build_solids(brep)
    report = check_shape(built.shape)
    moments = integral_properties.integrate_faces(brep)
    assert report.ok
    assert report.volume == pytest.approx(integral_properties.volume(moments)[0], rel=1e-12)
    assert report.area == pytest.approx(moments.area.sum(), rel=1e-6)  # a square root: converges with the rule
    np.testing.assert_allclose(report.centroid, integral_properties.centroid(moments), atol=1e-9)
    assert report.faces == len(brep.faces) == len(built.faces)
    assert report.solids == len(built.nesting.shells_of_solid)


def test_each_vertex_and_edge_is_one_kernel_object_at_the_least_tolerance(brep) -> None:
    shape = build_solids(brep).shape
    for kind, count in ((TopAbs_VERTEX, len(brep.vertices)), (TopAbs_EDGE, len(brep.edges))):
        assert len(count_subshape_uses(shape, kind, TopAbs_FACE)) == count
    assert check_shape(shape).max_tolerance == 1e-7


def test_edges_and_parameter_curves_take_the_same_parameter(brep) -> None:
    for face in build_solids(brep).faces:
        surface = BRepAdaptor_Surface(face)
        for edge in edges_of(face):
            along, flat = BRepAdaptor_Curve(edge), BRepAdaptor_Curve2d(edge, face)
            assert BRep_Tool.SameParameter_s(edge)
            for t in np.linspace(along.FirstParameter(), along.LastParameter(), 7).tolist():
                u, v = flat.Value(t).Coord()
                assert surface.Value(u, v).Distance(along.Value(t)) < 1e-12


def test_straight_edges_between_planes_are_lines() -> None:
    shape = build_solids(plane_box()).shape
    edges = [convert.as_edge(edge) for edge, _ in count_subshape_uses(shape, TopAbs_EDGE, TopAbs_FACE)]
    assert {BRepAdaptor_Curve(edge).GetType() for edge in edges} == {GeomAbs_Line}


def test_a_void_belongs_to_the_solid_around_it_even_where_boxes_mislead() -> None:
    built = build_solids(CASES["hollow bar in a notch"]())
    volumes = [[built.nesting.volume[s] for s in piece] for piece in built.nesting.shells_of_solid]
    assert [len(piece) for piece in built.nesting.shells_of_solid] == [2, 1]
    np.testing.assert_allclose(volumes[0], [14.4, -0.008], rtol=1e-12)
    assert [len(count_subshape_uses(s, TopAbs_SHELL, TopAbs_SHELL)) for s in built.solids] == [2, 1]


def test_pieces_come_largest_first() -> None:
    boxes = [plane_box((size,) * 3, translation=(x, 0, 0)) for size, x in ((1, 0), (2, 5), (1, 9))]
    assert build_solids(join_breps(boxes)).nesting.shells_of_solid == ((1,), (0,), (2,))


def test_a_missing_face_is_refused() -> None:
    with pytest.raises(KernelError, match="4 edges do not join two faces"):
        build_solids(select_faces(plane_box(), np.arange(5)))


def test_a_solid_inside_out_is_refused() -> None:
    with pytest.raises(KernelError, match=r"volume -30 .*inside out"):
        build_solids(reverse_faces(plane_box()))


def test_the_result_is_a_build123d_solid_or_compound() -> None:
    from build123d import Compound, Solid

    one, two = build_solids(CASES["drilled dome"]()), build_solids(CASES["two boxes"]())
    assert isinstance(one.solid, Solid)
    assert isinstance(two.solid, Compound)
    assert [s.volume for s in two.solid.solids()] == pytest.approx([45.0, 2.0])


@pytest.mark.parametrize("case", ["drilled dome", "hollow bar in a notch", "two boxes"])
def test_solids_that_were_not_made_yet_are_stored_without_shapes_and_made_alike(case: str) -> None:
    built = build_solids(CASES[case]())
    stored = pickle.dumps(built)
    restored = pickle.loads(stored)
    assert not {"faces", "solids", "shape"} & set(vars(restored))
    assert check_shape(restored.shape) == check_shape(built.shape)
    assert len(pickle.dumps(restored)) == len(stored)


def test_parts_of_solids_are_the_same_whether_faces_were_made_before_or_not() -> None:
    brep = CASES["two boxes"]()
    nested = build_solids(brep)
    made = replace(nested, known_faces=nested.faces)
    for built in (replace(nested, known_faces=None), made):
        part, one = select_solids(brep, built, [0])
        assert len(one.solids) == 1
        assert check_shape(one.shape).volume == pytest.approx(45.0)
        assert len(part.faces) == len(one.faces)
