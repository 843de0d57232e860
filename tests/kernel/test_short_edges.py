"""Short edges and narrow faces are merged: the solid stays closed and valid, and tells which faces it has kept."""

from __future__ import annotations

import build123d as bd
import numpy as np
import pytest
from OCP.BOPAlgo import BOPAlgo_Builder

from tpmscad.kernel.export.short_edges import merge_short_edges
from tpmscad.kernel.measure.shape_report import check_shape
from tpmscad.kernel.occt.exploration import faces_of, vertices_of

pytestmark = pytest.mark.kernel

LOW, HIGH = np.zeros(3), np.array([4.0, 3.0, 2.0])
GAP = 1e-3


def extrude(*corners: tuple[float, float]) -> bd.Solid:
    return bd.extrude(bd.make_face(bd.Polyline(*corners, close=True)), HIGH[2]).solid().wrapped


def cut_corner(gap: float) -> bd.Solid:
    """A box with a narrow face along one edge."""
    return extrude((0, 0), (4, 0), (4, 3 - gap), (4 - gap, 3), (0, 3))


def glue(*shapes: object) -> list[object]:
    """The solids, with what they have in common as one face of both."""
    builder = BOPAlgo_Builder()
    for shape in shapes:
        builder.AddArgument(shape)
    builder.Perform()
    return [each.wrapped for each in bd.Compound(builder.Shape()).solids()]


def count_shared(shapes: list[object]) -> int:
    first, second = ({hash(face) for face in faces_of(shape)} for shape in shapes)
    return len(first & second)


def test_a_narrow_face_goes_with_one_of_its_edges_and_its_vertices_go_to_the_edge_of_the_box() -> None:
    solid = cut_corner(GAP)
    found = merge_short_edges([solid], LOW, HIGH, 2 * GAP)
    (merged,) = found.solids
    assert found.merged == 3, "two ends, and a side of the face"
    assert found.moved == pytest.approx(GAP, rel=1e-6)
    report = check_shape(merged)
    assert report.ok, str(report)
    assert report.volume == pytest.approx(24.0, rel=1e-3)
    corners = vertices_of(merged)
    assert len(corners) == 8
    assert np.abs(corners - (4, 3, 0)).max(axis=1).min() < 1e-12
    narrow = [i for i, face in enumerate(faces_of(solid)) if bd.Face(face).area < 1e-2]
    assert found.faces == [[i for i in range(7) if i not in narrow]]
    for number, face in zip(found.faces[0], faces_of(merged), strict=True):
        assert bd.Face(face).area == pytest.approx(bd.Face(faces_of(solid)[number]).area, rel=GAP)
    assert check_shape(solid).volume == pytest.approx(24.0 - GAP**2, abs=1e-9), "the solid itself is left alone"


def test_edges_that_are_longer_are_kept() -> None:
    solid = cut_corner(GAP)
    found = merge_short_edges([solid], LOW, HIGH, 0.5 * GAP)
    assert (found.merged, found.moved, found.faces) == (0, 0.0, [[*range(7)]])
    assert found.solids[0].IsSame(solid)


def test_a_step_becomes_flat_but_its_long_edges_stay() -> None:
    solid = extrude((0, 0), (4, 0), (4, 3), (2, 3), (2, 3 - GAP), (0, 3 - GAP))
    found = merge_short_edges([solid], LOW, HIGH, 2 * GAP)
    assert len(found.faces[0]) == 7
    assert check_shape(found.solids[0]).ok
    assert check_shape(found.solids[0]).volume == pytest.approx(24.0, rel=1e-3)


def test_a_hole_that_is_as_small_keeps_three_sides() -> None:
    plate = bd.Pos(2, 1.5, 1) * bd.Box(4, 3, 2) - bd.Pos(2, 1.5, 1) * bd.Box(GAP, GAP, 2)
    found = merge_short_edges([plate.solid().wrapped], LOW, HIGH, 2 * GAP)
    assert len(found.faces[0]) == 9
    report = check_shape(found.solids[0])
    assert report.ok, str(report)


def test_solids_that_share_a_face_share_what_is_left_of_it() -> None:
    left = extrude((0, 0), (2, 0), (2, 3 - GAP), (2 - GAP, 3), (0, 3))
    right = extrude((2, 0), (4, 0), (4, 3), (2 - GAP, 3), (2, 3 - GAP))
    solids = glue(left, right)
    assert count_shared(solids) == 2
    found = merge_short_edges(solids, LOW, HIGH, 2 * GAP)
    assert count_shared(found.solids) == 1
    assert all(check_shape(each).ok for each in found.solids)
    assert sum(check_shape(each).volume for each in found.solids) == pytest.approx(24.0, abs=5 * GAP)
