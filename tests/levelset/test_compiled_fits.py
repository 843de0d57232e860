"""Compiled parts of the fit against slow oracles: foot points, proposals of polygons, linear conditions."""

import numpy as np
from scipy.optimize import minimize

from tpmscad.levelset.fit.foot_points import foot_point_distances
from tpmscad.levelset.fit.least_squares import HardRows
from tpmscad.levelset.fit.network_curves import _hold_end_poles
from tpmscad.levelset.quadmesh.regular_polygons import MIN_WEIGHTED_SINE, average_target_positions, fit_regular_polygons
from tpmscad.splines.basis import bernstein_basis


def wavy_patches(rng: np.random.Generator, count: int, p: int, q: int) -> np.ndarray:
    """Poles of nearly flat patches over the unit square."""
    poles = np.zeros((count, p + 1, q + 1, 3))
    poles[..., 0], poles[..., 1] = np.linspace(0, 1, p + 1)[:, None], np.linspace(0, 1, q + 1)
    return poles + 0.05 * rng.normal(size=poles.shape)


def test_foot_points_are_the_nearest_points_of_their_patches():
    rng = np.random.default_rng(1)
    poles = wavy_patches(rng, 3, 3, 4)
    patch = np.array([0, 2, 1, 1, 2])
    points = rng.uniform([-0.2, -0.2, -0.1], [1.2, 1.2, 0.1], (5, 3))
    u, v = np.clip(points[:, :2].T, 0.0, 1.0)
    found = foot_point_distances(poles, patch, points, u, v)
    for each, point, *start, distance in zip(patch, points, u, v, found, strict=True):

        def far(at: np.ndarray, net: np.ndarray = poles[each], point: np.ndarray = point) -> float:
            b, c = bernstein_basis(3, at[:1])[0], bernstein_basis(4, at[1:])[0]
            return float(np.linalg.norm(np.einsum("i,j,ijx->x", b, c, net) - point))

        nearest = minimize(far, start, bounds=((0, 1), (0, 1)), method="L-BFGS-B", options={"ftol": 1e-14}).fun
        assert abs(distance - nearest) < 1e-5


def test_vertices_are_drawn_to_the_weighted_regular_polygons_round_them():
    rng = np.random.default_rng(2)
    vertices = rng.normal(size=(7, 3))
    normals = rng.normal(size=(7, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    polygons = [np.array([[0, 1, 2, 3], [3, 2, 4, 5]]), np.array([[0, 3, 5]])]
    target, shortest = average_target_positions(vertices, normals, polygons)
    total, weights = np.zeros((7, 3)), np.zeros(7)
    for corners in (row for group in polygons for row in group):
        side = np.roll(vertices[corners], -1, axis=0) - vertices[corners]
        turn = np.cross(np.roll(side, 1, axis=0), side)
        size = np.linalg.norm(side, axis=1)
        sines = np.einsum("ki,ki->k", turn, normals[corners]) / (size * np.roll(size, 1))
        weight = 1 / np.clip(sines.min(), MIN_WEIGHTED_SINE, 1) ** 2
        regular = fit_regular_polygons(vertices[corners].T[:, None])[:, 0].T
        np.testing.assert_allclose(np.linalg.norm(np.roll(regular, 1, axis=0) - regular, axis=1).std(), 0, atol=1e-12)
        total[corners] += weight * regular
        weights[corners] += weight
    np.testing.assert_allclose(target[:6], total[:6] / weights[:6, None], atol=1e-12)
    assert not target[6].any()
    assert np.isinf(shortest[6])
    assert np.isclose(shortest[1], min(np.linalg.norm(vertices[1] - vertices[k]) for k in (0, 2)))


def test_minima_under_redundant_conditions_satisfy_them_and_have_no_slope_along_them():
    rng = np.random.default_rng(3)
    rows = np.zeros((3, 7, 12))
    rows[:, :5, 2:9] = rng.normal(size=(3, 5, 7))
    rows[:, 5] = rows[:, 0] - 2 * rows[:, 1]
    rows[:, 6] = rows[:, 3]
    rows[2, 4] = rows[2, 2]  # one problem has a rank of its own
    factor = rng.normal(size=(3, 12, 12))
    matrix, rhs = factor @ np.swapaxes(factor, 1, 2) + np.eye(12), rng.normal(size=(3, 12))
    target = (rows @ rng.normal(size=(3, 12, 1)))[..., 0]
    found = HardRows.factorise(rows).minimise(matrix, rhs, target)
    np.testing.assert_allclose((rows @ found[..., None])[..., 0], target, atol=1e-12)
    for i in range(3):
        free = np.eye(12) - np.linalg.pinv(rows[i]) @ rows[i]
        np.testing.assert_allclose(free @ (matrix[i] @ found[i] - rhs[i]), 0, atol=1e-11)


def test_conditions_that_contain_no_unknown_leave_the_least_squares_solution() -> None:
    matrix = np.diag([1.0, 2.0, 4.0])[None]
    rhs = np.array([[1.0, 1.0, 1.0]])
    found = HardRows.factorise(np.zeros((1, 5, 3))).minimise(matrix, rhs, np.zeros((1, 5)))
    np.testing.assert_allclose(found, [[1.0, 0.5, 0.25]], rtol=1e-15)


def test_ends_of_curves_are_held_as_by_factorised_conditions():
    rng = np.random.default_rng(5)
    normals = rng.normal(size=(6, 2, 3))
    normals[1, 0], normals[2], normals[3, 1] = 0.0, 0.0, (0.0, 0.0, -1.0)
    normals[4, 0, 2] = 0.0
    for count in (2, 4):
        rows = np.zeros((6, 2, count, 3))
        rows[:, 0, 0], rows[:, 1, -1] = normals.swapaxes(0, 1)
        root = rng.normal(size=(6, 3 * count, 3 * count))
        matrix, rhs = root @ np.swapaxes(root, 1, 2) + np.eye(3 * count), rng.normal(size=(6, 3 * count))
        target = rng.normal(size=(6, 2)) * normals.any(axis=2)
        expected = HardRows.factorise(rows.reshape(6, 2, -1)).minimise(matrix, rhs, target)
        np.testing.assert_allclose(_hold_end_poles(normals, count).minimise(matrix, rhs, target), expected, atol=1e-9)
