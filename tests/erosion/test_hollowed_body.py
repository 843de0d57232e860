"""Bodies without voids: the volumes subtract exactly, the boundary closes, and open faces are bounded anew."""

from __future__ import annotations

import build123d as bd
import numpy as np
import pytest

from tpmscad.brep import connectivity
from tpmscad.brep.boundary_representation import Brep, move_brep, select_faces
from tpmscad.brep.solid_properties import measure_solid
from tpmscad.erosion.hollowed_body import divide_by_voids, hollow_body
from tpmscad.kernel.body_import.body_brep import brep_from_shape
from tpmscad.kernel.build.solids import build_solids
from tpmscad.kernel.measure.shape_report import is_valid
from tpmscad.rigid_motion import Motion
from tpmscad.solids.divided_body import select_domain

pytestmark = pytest.mark.kernel

TOP, RIGHT, FRONT, LEFT, BACK = (0, 0, 1), (1, 0, 0), (0, -1, 0), (-1, 0, 0), (0, 1, 0)


def block(low: tuple[float, ...], high: tuple[float, ...]) -> bd.Solid:
    """An axis-parallel box between two corners."""
    size, centre = np.subtract(high, low), 0.5 * np.add(low, high)
    return bd.Pos(*centre) * bd.Box(*size)


def outermost(body: bd.Shape, directions: tuple[tuple[int, int, int], ...]) -> np.ndarray:
    """Whether each face of a box is the outermost one in one of the directions."""
    return np.array([any(f.normal_at().dot(bd.Vector(*d)) > 0.99 for d in directions) for f in body.faces()])


BOX = block((0, 0, 0), (10, 8, 6))


def tag_by_face(shape: bd.Shape) -> Brep:
    return brep_from_shape(shape, [str(i) for i in range(len(shape.faces()))])


@pytest.mark.parametrize(
    ("voids", "directions", "betti", "faces"),
    [
        ([block((1, 1, 1), (9, 7, 5))], (), (1, 0, 1), 12),
        ([block((1, 1, 1), (9, 7, 6))], (TOP,), (1, 0, 0), 11),
        ([block((1, 1, 1), (4, 7, 6)), block((5, 1, 1), (9, 7, 6))], (TOP,), (1, 0, 0), 16),
        ([block((1, 1, 1), (10, 7, 6))], (TOP, RIGHT), (1, 0, 0), 10),
        ([block((9, 1, 5), (10, 3, 6)), block((9, 4, 5), (10, 7, 6))], (TOP, RIGHT), (1, 0, 0), 14),
        ([block((1, 0, 1), (10, 7, 6))], (TOP, RIGHT, FRONT), (1, 0, 0), 9),
        ([block((0, 0, 1), (10, 8, 6))], (TOP, RIGHT, FRONT, LEFT, BACK), (1, 0, 0), 6),
        ([block((0, 1, 1), (10, 7, 5))], (RIGHT, LEFT), (1, 1, 0), 10),
        ([bd.Pos(5, 4, 4) * bd.Cylinder(2, 4)], (TOP,), (1, 0, 0), 9),
    ],
)
def test_volumes_subtract_and_the_boundary_closes(
    voids: list[bd.Shape], directions: tuple[tuple[int, int, int], ...], betti: tuple[int, int, int], faces: int
) -> None:
    read = tag_by_face(BOX)
    is_open = outermost(BOX, directions)[read.faces.tag] if directions else np.zeros(len(read.faces), bool)
    result = hollow_body(read, [brep_from_shape(v) for v in voids], is_open)
    measured = measure_solid(result)
    assert not len(connectivity.find_broken_loops(result))
    assert measured.volume == pytest.approx(BOX.volume - sum(v.volume for v in voids), rel=1e-12)
    assert measured.betti == betti
    assert len(result.faces) == faces
    assert all(map(is_valid, build_solids(result).solids))


def test_a_body_is_divided_into_voids_and_what_is_left_on_common_faces() -> None:
    read, voids = tag_by_face(BOX), [block((1, 1, 1), (4, 7, 6)), block((5, 1, 1), (10, 7, 5))]
    is_open = outermost(BOX, (TOP, RIGHT))[read.faces.tag]
    divided = divide_by_voids(read, [brep_from_shape(void) for void in voids], is_open)
    assert measure_solid(select_faces(divided.shared, divided.left)).volume == pytest.approx(480 - 90 - 120, rel=1e-12)
    for void, own, direction in zip(voids, divided.voids, (TOP, RIGHT), strict=True):
        common = np.intersect1d(own, divided.left)
        assert measure_solid(select_domain(divided.shared, own, common)).volume == pytest.approx(void.volume, rel=1e-12)
        (opening,) = np.setdiff1d(own, common)
        tag = divided.shared.tags[divided.shared.faces.tag[opening]]
        assert tag == str(np.flatnonzero(outermost(BOX, (direction,)))[0])


def test_a_thin_wall_beside_a_long_round_edge_bounds_the_open_face() -> None:
    # chords of an eighth of the circle would lie further inside than the void
    tube, void = bd.Cylinder(200, 10), bd.Pos(0, 0, 0.5) * bd.Rot(0, 0, 5) * bd.Cylinder(199.5, 9)
    read = tag_by_face(tube)
    result = hollow_body(read, [brep_from_shape(void)], outermost(tube, (TOP,))[read.faces.tag])
    measured = measure_solid(result)
    assert measured.volume == pytest.approx(np.pi * (200**2 * 10 - 199.5**2 * 9), rel=1e-10)
    assert measured.betti == (1, 0, 0)
    assert all(map(is_valid, build_solids(result).solids))


def test_a_moved_and_mirrored_body_gives_the_same_solid() -> None:
    read, void = tag_by_face(BOX), brep_from_shape(block((1, 1, 1), (10, 7, 6)))
    is_open = outermost(BOX, (TOP, RIGHT))[read.faces.tag]
    turn = Motion(np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]), np.array([3.0, 1, -2]))
    moved = hollow_body(move_brep(read, turn), [move_brep(void, turn)], is_open)
    assert measure_solid(moved).volume == pytest.approx(10 * 8 * 6 - 9 * 6 * 5, rel=1e-12)
    assert all(map(is_valid, build_solids(moved).solids))
