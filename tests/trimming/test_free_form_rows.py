"""Rows of free-form surfaces and of normals along edges: derivatives against differences, frames, and forced feet."""

from __future__ import annotations

import numpy as np
import pytest

from tests.trimming.test_derivatives_of_operands import CARRIERS, wavy_patch
from tpmscad._typing import Array
from tpmscad.brep.conics import Circle
from tpmscad.brep.free_form_surface import FreeFormSurface
from tpmscad.rigid_motion import Motion
from tpmscad.splines.bspline import BSplineCurve, BSplineSurface, line_segment
from tpmscad.splines.knots import bezier_knots
from tpmscad.trimming.intersect.arrangement import CurveSegments
from tpmscad.trimming.intersect.curve_surface import intersect_segments
from tpmscad.trimming.operands.edge_normals import ACROSS_SAMPLES, build_edge_normals
from tpmscad.trimming.operands.quadric_table import QuadricTable, build_edge_normal_row, build_implicit_surfaces

STEP = 1e-4
MIRROR = np.diag([1.0, 1.0, -1.0])


def frames(rng: np.random.Generator) -> Motion:
    """A proper motion and a mirror."""
    rotations = [np.linalg.qr(rng.normal(size=(3, 3)))[0] for _ in range(2)]
    rotations = [r * np.sign(np.linalg.det(r)) for r in rotations]
    return Motion(np.stack([rotations[0], rotations[1] @ MIRROR]), rng.normal(size=(2, 3)))


def edge_row(curve: BSplineCurve | Circle, span: tuple[float, float], normals: Array) -> QuadricTable:
    return build_edge_normal_row(build_edge_normals(curve, span, np.linspace(*span, ACROSS_SAMPLES), normals))


def make_rows() -> dict[str, tuple[QuadricTable, Array]]:
    """Tables of one row, each with points (n, 3) at which it is smooth."""
    rng = np.random.default_rng(3)
    surface = FreeFormSurface(wavy_patch())
    feet = surface(*rng.uniform(0.2, 0.8, (2, 12)))
    curve = surface.spline.side(0)
    t = np.linspace(*curve.domain, ACROSS_SAMPLES)
    beside = curve(np.linspace(0.2, 0.8, 12)) + rng.uniform(-0.03, 0.03, (12, 3))
    circle, span = Circle(np.array([0.3, -0.2, 0.1]), np.array([1.0, 0, 0]), np.array([0, 0.6, 0.8]), 1.3), (0.4, 2.9)
    tilted = circle(np.linspace(*span, ACROSS_SAMPLES)) + np.array([0.2, 0.1, 0.7])
    round_points = circle(np.linspace(0.8, 2.4, 12)) + rng.uniform(-0.05, 0.05, (12, 3))
    return {
        "surface": (build_implicit_surfaces([surface]), feet + rng.uniform(-0.02, 0.02, (12, 3))),
        "normals along a spline": (edge_row(curve, curve.domain, surface.gradient(curve(t))), beside),
        "normals along a circle": (edge_row(circle, span, tilted), round_points),
    }


ROWS = make_rows()


@pytest.mark.parametrize("name", ROWS)
def test_gradients_and_hessians_are_those_of_differences(name: str) -> None:
    row, points = ROWS[name]
    value, gradient, hessian = (j[0] for j in row.jet(points[None], 2))
    np.testing.assert_allclose(row.value(points[None])[0], value, atol=1e-15)
    for axis, e in enumerate(STEP * np.eye(3)):
        ahead, behind = (row.jet((points + side * e)[None], 1) for side in (1, -1))
        np.testing.assert_allclose((ahead[0][0] - behind[0][0]) / (2 * STEP), gradient[:, axis], atol=1e-6)
        np.testing.assert_allclose((ahead[1][0] - behind[1][0]) / (2 * STEP), hessian[:, axis], atol=2e-5)


@pytest.mark.parametrize("name", ROWS)
def test_a_row_in_a_frame_has_the_jet_of_the_moved_points(name: str) -> None:
    row, points = ROWS[name]
    motion = frames(np.random.default_rng(4))
    framed = QuadricTable.concatenate([row, row]).in_frames(motion)
    local = motion[:, None].apply_inverse(points)
    value, gradient, hessian = framed.jet(local, 2)
    expected = row.jet(points[None], 2)
    for i, m in enumerate(motion):
        np.testing.assert_allclose(value[i], expected[0][0], atol=1e-13)
        np.testing.assert_allclose(m.apply_to_vectors(gradient[i]), expected[1][0], atol=1e-12)
        np.testing.assert_allclose(m.rotation @ hessian[i] @ m.rotation.T, expected[2][0], atol=1e-9)
    inner = frames(np.random.default_rng(8))
    again = framed.in_frames(inner).value(inner[:, None].apply_inverse(local))
    np.testing.assert_allclose(again, value, atol=1e-12)
    distances = framed.distances(local[1])
    np.testing.assert_allclose(distances[:, 1], expected[0][0], atol=1e-13)


@pytest.mark.parametrize("name", ROWS)
def test_a_reach_leaves_out_far_points_only(name: str) -> None:
    row, near = ROWS[name]
    points = np.concatenate([near, near.mean(axis=0) + np.random.default_rng(7).uniform(-4, 4, (200, 3))])
    # Points next to the surface, or to the edge, are samples of it: the nearest one is no nearer than the true distance.
    apart = np.linalg.norm(points[:, None] - near, axis=2).min(axis=1)
    everywhere = row.distances(points)[:, 0]
    for reach in (0.1, 1.0):
        within = row.distances(points, reach)[:, 0]
        finite = np.isfinite(within)
        np.testing.assert_array_equal(within[finite], everywhere[finite])
        assert finite[apart < reach].all()
        assert not finite.all()
    wanted = np.arange(len(points))[:, None] % 2 == 0
    chosen = row.distances(points, wanted=wanted)[:, 0]
    np.testing.assert_array_equal(chosen, np.where(wanted[:, 0], everywhere, np.inf))


def test_rows_of_all_kinds_are_evaluated_in_one_table() -> None:
    tables = [build_implicit_surfaces(list(CARRIERS.values())), *(row for row, _ in ROWS.values())]
    table = QuadricTable.concatenate(tables)
    assert len(table) == len(CARRIERS) + len(ROWS)
    points = np.random.default_rng(5).uniform(0.4, 1.4, (len(table), 7, 3))
    together = table.jet(points, 2)
    order = np.random.default_rng(6).permutation(len(table))
    again = table.take(order).jet(points[order], 2)
    one_by_one = [t.row(k) for t in tables for k in range(len(t))]
    for i, row in enumerate(one_by_one):
        for k, part in enumerate(row.jet(points[[i]], 2)):
            np.testing.assert_array_equal(together[k][i], part[0])
            np.testing.assert_array_equal(again[k][list(order).index(i)], part[0])


def test_congruent_places_and_no_others_have_equal_keys() -> None:
    row, _ = ROWS["surface"]
    motion = frames(np.random.default_rng(7))
    table = row.take(np.zeros(3, np.int64)).in_frames(Motion.stack([motion[0], motion[0], motion[1]]))
    key = table.congruence_key(2.0)
    np.testing.assert_array_equal(key[0], key[1])
    assert (key[0] != key[2]).any()


def test_the_normals_along_an_edge_are_zeros_and_their_sides_have_both_signs() -> None:
    surface = FreeFormSurface(wavy_patch())
    curve = surface.spline.side(0)
    t = np.linspace(*curve.domain, ACROSS_SAMPLES)
    row = edge_row(curve, curve.domain, surface.gradient(curve(t)))
    at = np.linspace(0.1, 0.9, 11)
    normals, tangents = surface.gradient(curve(at)), curve(at, 1)
    # the foot of a point on the normal is the edge's point below it, since the normal is across the edge
    np.testing.assert_allclose(row.value((curve(at) + 0.05 * normals)[None])[0], 0.0, atol=1e-7)
    across = np.cross(tangents, normals)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    for side in (1, -1):
        found = row.value((curve(at) + side * 0.01 * across)[None])[0]
        np.testing.assert_allclose(found, side * 0.01, rtol=1e-6)


def test_forced_feet_are_marked_and_their_distances_are_true() -> None:
    spline = wavy_patch()
    row = build_implicit_surfaces([FreeFormSurface(spline)])
    inside, corner = spline(0.5, 0.5) + 0.01 * np.array([0, 0, 1.0]), spline(0.0, 0.0)
    outside = corner + 0.3 * (corner - spline(0.5, 0.5))
    points = np.stack([inside, outside])
    np.testing.assert_array_equal(row.marked_jet(points[None], 0)[1], [[False, True]])
    dense = spline.grid(np.linspace(0, 1, 401), np.linspace(0, 1, 401)).reshape(-1, 3)
    expected = [np.linalg.norm(dense - p, axis=1).min() for p in points]
    np.testing.assert_allclose(np.abs(row.distances(points)[:, 0]), expected, atol=1e-4)
    assert abs(row.value(points[None])[0, 1]) < 0.9 * expected[1]


def test_a_root_behind_a_forced_change_of_sign_has_its_own_sign_and_is_the_only_one() -> None:
    # three quarters of a pipe: the line comes in through the gap, where the foot is forced, and goes out through the wall
    angle = np.linspace(0.75, 2.0 * np.pi - 0.75, 9)
    ring = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(9)])
    height = np.array([0.0, 0.0, 2.0])
    poles = np.stack([ring - height, ring + height], axis=1)
    knots = np.concatenate([np.zeros(3), np.linspace(0.0, 1.0, 7), np.ones(3)])
    pipe = FreeFormSurface(BSplineSurface(poles, knots, bezier_knots(1), 3, 1))
    table = build_implicit_surfaces([pipe])
    line = line_segment([9.0, 0.1, 0.2], [-3.0, -0.2, -0.1])
    ends = np.array([0]), np.array([1])
    segment = CurveSegments(np.array([0]), Motion.identity(1), np.array([[0.0, 1.0]]), *ends)
    nowhere, wanted = np.zeros((2, 1), bool), np.ones((1, 1), bool)
    found = intersect_segments([line], segment, table, nowhere, wanted, 2e-7, 5e-9)
    (root,) = found.root_parameter
    assert abs(line(root)[0] + 1.0) < 0.1
    before, after = table.value(line([root - 0.01, root + 0.01])[None])[0]
    assert before * after < 0
    np.testing.assert_array_equal(found.root_sign, [np.sign(before)])
    assert found.initial_sign[0, 0] == -np.sign(before)
