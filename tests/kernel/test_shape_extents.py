"""The true extent of kernel shapes: closed forms of turned bodies, and the extent of the same solid in arrays."""

import build123d as bd
import numpy as np
import pytest

from tests.trimming.conftest import covered
from tests.trimming.network_operands import trim
from tpmscad.brep.extents import true_bounds
from tpmscad.kernel.body_import.body_brep import brep_from_shape
from tpmscad.kernel.build.solids import build_solids
from tpmscad.kernel.measure.shape_extents import shape_bounds
from tpmscad.kernel.measure.shape_report import check_shape
from tpmscad.kernel.occt.bounding_boxes import enclosing_box
from tpmscad.trimming.operands.polyhedra import box

pytestmark = pytest.mark.kernel

DIAGONAL = 35 / np.sqrt(2) + 7
"""Extent of a slot 42 long and 7 wide that is turned by 45 degrees: its two centres and two radii."""

TURN = bd.Location((1, 2, 3), (25, 40, 65))


def axis_of(location):
    """Direction of the z axis after a placement."""
    return np.array(tuple((location * bd.Location((0, 0, 1))).position)) - np.array(tuple(location.position))


def half_extent(kind, a):
    sine = np.sqrt(np.maximum(0.0, 1.0 - a * a))
    return {"torus": 3.0 * sine + 1.0, "cylinder": 2.5 * np.abs(a) + 1.5 * sine, "sphere": np.full(3, 2.0)}[kind]


BODIES = {"torus": lambda: bd.Torus(3, 1), "cylinder": lambda: bd.Cylinder(1.5, 5), "sphere": lambda: bd.Sphere(2)}


@pytest.mark.parametrize("kind", BODIES)
def test_turned_bodies_have_the_extents_of_closed_forms_in_arrays_and_in_the_kernel(kind):
    shape = TURN * BODIES[kind]()
    half = half_extent(kind, axis_of(TURN))
    centre = np.array(tuple(TURN.position))
    np.testing.assert_allclose(true_bounds(brep_from_shape(shape.wrapped)), [centre - half, centre + half], atol=1e-6)
    np.testing.assert_allclose(shape_bounds(shape), [centre - half, centre + half], atol=1e-6)


def test_what_is_cut_off_a_sphere_or_a_torus_does_not_count():
    cap = bd.Pos(1, 2, 3) * bd.Rot(0, 90, 0) * (bd.Sphere(5) & bd.Pos(0, 0, 4) * bd.Box(20, 20, 2))
    np.testing.assert_allclose(shape_bounds(cap), [[4, -2, -1], [6, 6, 7]], atol=1e-6)
    inner = bd.Torus(10, 3) - bd.Cylinder(10, 20)
    outer = bd.Torus(10, 3) & bd.Cylinder(10, 20)
    np.testing.assert_allclose(shape_bounds(inner), [[-13, -13, -3], [13, 13, 3]], atol=1e-6)
    np.testing.assert_allclose(shape_bounds(outer), [[-10, -10, -3], [10, 10, 3]], atol=1e-6)


def test_a_report_states_the_true_size_of_a_part_with_rounded_rims_wherever_it_stands():
    slot = bd.extrude(bd.SlotOverall(42, 7), 3)
    slot = bd.fillet(slot.faces().sort_by(bd.Axis.Z)[-1].edges(), 1)
    for turn, size in (((0, 0, 0), (42, 7, 3)), ((0, 0, 90), (7, 42, 3)), ((0, 0, 45), (DIAGONAL, DIAGONAL, 3))):
        placed = slot.solid().moved(bd.Location((5, 6, 7), turn))
        np.testing.assert_allclose(np.ptp(check_shape(placed).bounds, axis=0), size, atol=1e-6)


def test_the_kernels_solid_of_a_cut_lattice_has_the_extent_of_its_arrays():
    lattice = covered("gyroid", (1, 1, 1), (0.02, 0.03, 0.05), (None, 0.05))
    brep = trim(lattice, box([1.3, 2.1, 1.7], [6.2, 6.9, 7.1])).brep
    shape = build_solids(brep).shape
    np.testing.assert_allclose(shape_bounds(shape), true_bounds(brep), atol=1e-6)


def test_the_box_of_a_torus_that_intersects_itself_turns_with_it() -> None:
    torus = bd.Pos(1, 2, 3) * bd.Rotation(90, 0, 0) * bd.Solid.make_torus(3, 5)
    low, high = enclosing_box(torus.wrapped)
    assert (low <= np.array([-7.0, -3.0, -5.0]) + 1e-6).all()
    assert (high >= np.array([9.0, 7.0, 11.0]) - 1e-6).all()
