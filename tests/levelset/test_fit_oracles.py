"""Parts of the fit against slow oracles: foot points, proposals of polygons, least squares, linear conditions."""

import numpy as np
from scipy.linalg import lstsq, null_space
from scipy.optimize import minimize

from tpmscad import fields
from tpmscad.levelset.fit.equality_constraints import EqualityConstraints
from tpmscad.levelset.fit.least_squares import PROJECTION_TOL_OF_MAX_STEP, project_curves_to_level_set, unit_vectors
from tpmscad.levelset.fit.network_curves import hold_end_poles
from tpmscad.levelset.fit.network_fit import _normal_products, _rows_of_inner_poles
from tpmscad.levelset.fit.normal_equations import NormalEquations, curve_basis
from tpmscad.levelset.fit.patch_samples import evaluate_points_and_normals, foot_point_distances, measure_samples
from tpmscad.levelset.quadmesh.regular_polygons import MIN_WEIGHTED_SINE, average_target_positions, fit_regular_polygons
from tpmscad.splines.basis import bernstein_basis, evaluate_bezier_patches


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
    found = EqualityConstraints.factorise(rows).minimise(matrix, rhs, target)
    np.testing.assert_allclose((rows @ found[..., None])[..., 0], target, atol=1e-12)
    for i in range(3):
        free = np.eye(12) - np.linalg.pinv(rows[i]) @ rows[i]
        np.testing.assert_allclose(free @ (matrix[i] @ found[i] - rhs[i]), 0, atol=1e-11)


def test_conditions_that_contain_no_unknown_leave_the_least_squares_solution() -> None:
    matrix = np.diag([1.0, 2.0, 4.0])[None]
    rhs = np.array([[1.0, 1.0, 1.0]])
    found = EqualityConstraints.factorise(np.zeros((1, 5, 3))).minimise(matrix, rhs, np.zeros((1, 5)))
    np.testing.assert_allclose(found, [[1.0, 0.5, 0.25]], rtol=1e-15)


def test_ends_of_curves_are_held_along_their_normals_only():
    rng = np.random.default_rng(5)
    normals = rng.normal(size=(6, 2, 3))
    normals[1, 0], normals[2], normals[3, 1] = 0.0, 0.0, (0.0, 0.0, -1.0)
    normals[4, 0, 2] = 0.0
    for count in (2, 4):
        root = rng.normal(size=(6, 3 * count, 3 * count))
        matrix, rhs = root @ np.swapaxes(root, 1, 2) + np.eye(3 * count), rng.normal(size=(6, 3 * count))
        target = rng.normal(size=(6, 2)) * normals.any(axis=2)
        found = hold_end_poles(normals, count).minimise(matrix, rhs, target).reshape(6, count, 3)
        np.testing.assert_allclose(np.einsum("nei,nei->ne", normals, found[:, [0, -1]]), target, atol=1e-11)
        slope = (matrix @ found.reshape(6, -1, 1)).reshape(6, count, 3) - rhs.reshape(6, count, 3)
        slope[:, [0, -1]] = np.cross(slope[:, [0, -1]], normals) + slope[:, [0, -1]] * ~normals.any(axis=2)[..., None]
        np.testing.assert_allclose(slope, 0, atol=1e-10)


def test_poles_are_the_constrained_least_squares_solution_of_their_weighted_rows():
    rng = np.random.default_rng(6)
    for k, l, m, w in ((4, 3, 6, 5), (1, 5, 3, 9), (3, 4, 7, 6)):  # noqa: E741
        bases = [(rng.normal(size=(m, k)), rng.normal(size=(w, l))) for _ in range(2)]
        normal, target = rng.normal(size=(2, 2, 3, m * w, 3))
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        size = 3 * k * l
        hard = np.zeros((3, 6, size))
        hard[:, :4, 2:-3] = rng.normal(size=(3, 4, size - 5))
        hard[:, 4] = hard[:, 0] + 3 * hard[:, 1]
        hard[2, 5] = hard[2, 3]  # the others have a row of zeros there
        wanted = (hard @ rng.normal(size=(3, size, 1)))[..., 0]
        system = NormalEquations(k * l, 3)
        system.add_point_rows(bases[0], normal[0], target[0], 0.3)
        system.add_normal_rows(bases[1], normal[1], target[1], 0.7)
        # differences of more poles than are unknown
        differences, poles = rng.normal(size=(2, k * l + 3)), rng.normal(size=(3, k * l + 3, 3))
        unknown = rng.permutation(k * l + 3)[: k * l]
        system.add_energy(differences.T @ differences, unknown, poles, 0.4)
        found = system.solve_subject_to(EqualityConstraints.factorise(hard), wanted)
        for each in range(3):
            rows = [0.4 * np.kron(differences[:, unknown], np.eye(3))]
            right = [-0.4 * (differences @ poles[each]).ravel()]
            for (u, v), n, t, weights in zip(
                bases, normal[:, each], target[:, each], ((1.0, 0.3), (0.7, 0.0)), strict=True
            ):
                basis = np.kron(u, v)
                for row, axis, point in zip(basis, n, t, strict=True):
                    root = weights[1] * np.eye(3) + (weights[0] - weights[1]) * np.outer(axis, axis)
                    rows.append(np.kron(row, root))
                    right.append(root @ point)
            matrix, rhs = np.concatenate(rows), np.concatenate(right)
            start, null = lstsq(hard[each], wanted[each])[0], null_space(hard[each])
            expected = start + null @ lstsq(matrix @ null, rhs - matrix @ start)[0]
            np.testing.assert_allclose(found[each].ravel(), expected, atol=1e-10)


def test_curves_and_patches_share_the_normal_equations():
    rng = np.random.default_rng(7)
    values = rng.normal(size=(9, 3))
    normal, target = rng.normal(size=(2, 2, 9, 3))
    flat, turned = NormalEquations(3, 2), NormalEquations(3, 2)
    flat.add_point_rows(curve_basis(values), normal, target, 0.5)
    turned.add_point_rows((values, np.ones((1, 1))), normal, target, 0.5)
    np.testing.assert_allclose(flat.matrix, turned.matrix, atol=1e-13)
    np.testing.assert_allclose(flat.rhs, turned.rhs, atol=1e-13)


def test_the_conditions_of_all_sides_of_a_patch_have_the_rank_of_their_rows():
    rng = np.random.default_rng(8)
    p, q = 5, 7
    blocks = []
    for side, degree in enumerate((5, 7, 3, 6)):
        along = np.zeros((4, degree + 1, 3)) + np.array([0.0, 0.0, 1.0])
        along[:, 1:-1, :2] += 0.1 * rng.normal(size=(4, degree - 1, 2))
        blocks.append(_rows_of_inner_poles(p, q, side, _normal_products(p, q, side, along)))
    rows = np.concatenate(blocks, axis=1)
    conditions = EqualityConstraints.factorise(rows)
    for each in range(4):
        singular = np.linalg.svd(rows[each], compute_uv=False)
        rank = np.count_nonzero(singular > 1e-8 * singular[0])
        assert conditions.rank[each] == rank < np.count_nonzero(rows[each].any(axis=1))
        null = conditions.null_space[each, :, : len(conditions.involved) - rank]
        np.testing.assert_allclose(rows[each][:, conditions.involved] @ null, 0, atol=1e-12)
        np.testing.assert_allclose(null.T @ null, np.eye(null.shape[1]), atol=1e-13)


def test_points_and_normals_of_patches_are_those_of_their_partial_derivatives():
    rng = np.random.default_rng(9)
    poles = rng.normal(size=(3, 5, 8, 3))
    (bu, du), (bv, dv) = ([bernstein_basis(p, rng.random(m), k) for k in (0, 1)] for p, m in ((4, 6), (7, 2)))
    points, normals = evaluate_points_and_normals(poles, (bu, du), (bv, dv))
    np.testing.assert_allclose(points, evaluate_bezier_patches(bu, poles, bv), atol=1e-13)
    along_u, along_v = evaluate_bezier_patches(du, poles, bv), evaluate_bezier_patches(bu, poles, dv)
    np.testing.assert_allclose(normals, np.cross(along_u, along_v), atol=1e-11)


def test_measurements_of_samples_are_those_of_plain_sums_and_nan_stays():
    rng = np.random.default_rng(10)
    points, normals, gradient = rng.normal(size=(3, 4, 7, 3))
    value = rng.normal(size=(4, 7))
    value[1, 2], gradient[2, 3], normals[3, 0] = np.nan, 0.0, np.nan
    lo, hi = np.full(3, -0.5), np.array([0.5, 0.6, 0.7])
    found = measure_samples(points, normals, value, gradient, lo, hi)
    size = np.linalg.norm(gradient, axis=2)
    beyond = np.maximum(np.maximum(lo - points, points - hi).max(axis=2), 0.0)
    with np.errstate(over="ignore"):
        distance = np.abs(value) / np.maximum(size, 1e-300) + beyond
        mean_square = (distance**2).mean(axis=1)
    cosine = np.einsum("nmi,nmi->nm", normals, gradient) / np.maximum(np.linalg.norm(normals, axis=2) * size, 1e-300)
    for array, expected in zip(found, (distance.max(axis=1), mean_square, cosine.min(axis=1)), strict=True):
        np.testing.assert_allclose(array, expected, rtol=1e-12)
    assert np.isnan(found[0]).tolist() == [False, True, False, False]
    assert np.isinf(found[1][2])
    assert np.isnan(found[2]).tolist() == [False, False, False, True]


def test_normals_of_a_level_set_lie_in_the_faces_of_the_box_where_coordinates_are_fixed():
    field = fields.tpms("gyroid", 1.7)
    points = np.random.default_rng(11).random((3, 4, 3))
    fixed = np.array([[False, False, False], [True, False, False], [True, True, True]])
    gradient = field.gradient(points) * ~fixed[:, None]
    length = np.maximum(np.linalg.norm(gradient, axis=2, keepdims=True), 1e-300)
    np.testing.assert_allclose(unit_vectors(field.gradient(points), fixed), gradient / length, rtol=1e-14, atol=0)
    free = field.gradient(points)
    expected = free / np.linalg.norm(free, axis=2, keepdims=True)
    np.testing.assert_allclose(unit_vectors(field.gradient(points)), expected, rtol=1e-14)


def test_projections_of_fits_are_off_by_the_square_of_the_last_step_and_have_its_normals():
    radius, max_step = 2.0, 0.3
    ball = fields.sphere((0, 0, 0), radius)
    rng = np.random.default_rng(12)
    way = rng.standard_normal((6, 9, 3))
    way /= np.linalg.norm(way, axis=2, keepdims=True)
    wavy = ball * (fields.expression("2 + sin(x)*cos(2*y)"))
    points = way * rng.uniform(0.95, 1.05, (6, 9, 1)) * radius
    fixed = np.zeros((6, 3), bool)
    fixed[0, 2] = True
    found, normals = project_curves_to_level_set(wavy, points, fixed, np.full(6, max_step))
    step = PROJECTION_TOL_OF_MAX_STEP * max_step
    assert np.abs(np.linalg.norm(found, axis=2) - radius).max() < 5 * step**2
    assert np.array_equal(found[0, :, 2], points[0, :, 2])
    expected = found * ~fixed[:, None]
    expected /= np.linalg.norm(expected, axis=2, keepdims=True)
    assert np.linalg.norm(normals - expected, axis=2).max() < 5 * step
