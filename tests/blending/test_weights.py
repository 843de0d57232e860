"""Laws that hold for weights of every kind."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import NdBSpline
from scipy.sparse.linalg import lsqr
from scipy.spatial import KDTree

from benchmarks.baseline_weights import ProfileWeight, make_cell_weight, make_gaussian_weight
from tpmscad.blending.weights import volume_weight_fit
from tpmscad.blending.weights.coordinates import CylinderRadius, LinearCoordinate, SphereRadius
from tpmscad.blending.weights.line_weight import MIN_FREE_COEFFICIENTS, make_line_weight
from tpmscad.blending.weights.volume_weight_fit import (
    StageMasks,
    assign_target_values,
    choose_knots,
    convert_line_to_volume,
    fit_local_lspia,
    fit_volume_weight,
    refine_knots,
)
from tpmscad.errors import InvalidRequest
from tpmscad.fields.data.sample_grid import SampleGrid

BOX = (0.0, 0.0, 0.0), (1.0, 0.8, 0.6)
GRID = SampleGrid(*BOX, (31, 26, 19))


def stage_masks(grid, bend=0.1, half=0.2):
    x, y, _ = np.moveaxis(grid.points(), -1, 0)
    depth = x - 0.5 - bend * np.sin(4 * y)
    return StageMasks(grid, depth < -half, depth > half, abs(depth) <= half)


def bent_volume(count=(17, 14, 11), degree=(3, 2, 3)):
    return fit_volume_weight(stage_masks(GRID), stage_masks(GRID.double_samples()), count, degree)


def first(points):
    return points[..., 0] - 0.5


def slab(points):
    return abs(points[..., 0] - 0.5) - 0.2


WEIGHTS = {
    "line": make_line_weight(LinearCoordinate((1.0, 0.5, 0.2)), (0.3, 0.9), (0.0, 1.2)),
    "line, falling": make_line_weight(LinearCoordinate(), (0.3, 0.7), (0.0, 1.0), rising=False, degree=2, count=40),
    "cylinder": make_line_weight(CylinderRadius((0.2, 0.1, 0.0)), (0.2, 0.5), (0.0, 1.1), count=50),
    "sphere": make_line_weight(SphereRadius((0.1, 0.2, 0.3)), (0.3, 0.6), (0.0, 1.2), degree=4),
    "volume": bent_volume(),
    "converted line": convert_line_to_volume(
        make_line_weight(LinearCoordinate(), (0.3, 0.7), (0.0, 1.0)),
        stage_masks(GRID, 0.0),
        stage_masks(GRID.double_samples(), 0.0),
    ),
    "sigmoid": ProfileWeight(LinearCoordinate(), 0.3, 0.7),
    "beta growth": ProfileWeight(LinearCoordinate(), 0.3, 0.7, rising=False, profile="beta-growth", middle=0.4),
    "discrete reconstruction": make_cell_weight(first, BOX, 0.23),
    "gaussian": make_gaussian_weight(first, lambda p: -first(p), slab, BOX),
}
SPLINES = [name for name, weight in WEIGHTS.items() if hasattr(weight, "coefficients")]


@pytest.fixture(params=WEIGHTS)
def weight(request):
    return WEIGHTS[request.param]


@pytest.fixture(params=SPLINES)
def spline(request):
    return WEIGHTS[request.param]


def points(count=400, seed=3):
    return np.random.default_rng(seed).uniform(*BOX, (count, 3))


def test_a_weight_lies_between_zero_and_one(weight):
    values = weight(points())
    assert values.min() >= 0.0
    assert values.max() <= 1.0
    assert np.ptp(values) > 0.9


def test_a_weight_on_a_grid_is_the_weight_at_its_points(weight):
    assert np.allclose(weight.on_grid(*GRID.axes), weight(GRID.points()), atol=1e-13)


def test_the_gradient_of_a_weight_is_the_limit_of_difference_quotients(weight):
    where, step = points(200), 1e-6
    quotients = [(weight(where + step * axis) - weight(where - step * axis)) / (2 * step) for axis in np.eye(3)]
    exact = weight.gradient(where)
    close = np.isclose(np.stack(quotients, axis=-1), exact, atol=1e-5 * (1 + abs(exact).max()))
    assert close.mean() > 0.995  # a point within a step of a knot or of a cell's face may see a kink


def test_a_spline_of_three_variables_and_its_slopes_are_those_of_scipy_at_knots_and_ends_too():
    weight = bent_volume()
    low, high = np.array(BOX)
    where = np.concatenate([points(300), [low, high, [low[0], high[1], low[2]], [t[5] for t in weight.knots]]])
    value, slope = weight.value_and_gradient(where.reshape(2, -1, 3))
    spline = NdBSpline(weight.knots, weight.coefficients, weight.degree)
    assert np.allclose(value.ravel(), spline(where), atol=1e-13)
    orders = [spline(where, nu=order) for order in ((1, 0, 0), (0, 1, 0), (0, 0, 1))]
    assert np.allclose(slope.reshape(-1, 3), np.stack(orders, axis=-1), atol=1e-10)


def test_the_design_matrix_is_the_weight_as_a_linear_map_of_its_coefficients(spline):
    where = points(50)
    rows = spline.design_matrix(where)
    assert np.allclose(rows @ spline.coefficients.ravel(), spline(where), atol=1e-12)
    assert np.allclose(np.asarray(rows.sum(axis=1)).ravel(), 1.0)
    assert spline.design_matrix(where[:0]).shape == (0, spline.coefficients.size)


def test_apply_transpose_is_the_transpose_of_evaluation(spline):
    rng = np.random.default_rng(5)
    values = rng.normal(size=GRID.shape) * (rng.random(GRID.shape) < 0.1)
    direction = rng.random(spline.coefficients.shape)
    forward = float(np.sum(values * spline.with_coefficients(direction).on_grid(*GRID.axes)))
    backward = float(np.sum(spline.apply_transpose(*GRID.axes, values) * direction))
    assert forward == pytest.approx(backward, rel=1e-9)


def test_free_coefficients_leave_the_weight_alone_outside_the_blending_region():
    weight, grid = bent_volume(), SampleGrid(*BOX, (60, 60, 7))
    moved = weight.with_coefficients(
        np.where(weight.is_free, np.random.default_rng(0).random(weight.is_free.shape), weight.coefficients)
    )
    outside = ~stage_masks(grid).mixing
    values = moved.on_grid(*grid.axes)
    assert np.allclose(values[outside], stage_masks(grid).second_region[outside], atol=1e-13)


@settings(max_examples=25, deadline=None)
@given(
    st.floats(0.05, 0.65),
    st.floats(0.02, 0.3),
    st.integers(1, 4),
    st.one_of(st.none(), st.integers(6, 60)),
    st.booleans(),
)
def test_a_line_weight_is_zero_before_its_layer_and_one_after_it_and_monotone_between(
    start, width, degree, count, rising
):
    weight = make_line_weight(
        LinearCoordinate(), (start, start + width), (0.0, 1.0), degree=degree, count=count, rising=rising
    )
    t = np.linspace(0, 1, 501)
    values = weight.evaluate(t) if rising else 1.0 - weight.evaluate(t)
    assert np.allclose(values[t < start], 0.0, atol=1e-14)
    assert np.allclose(values[t > start + width], 1.0, atol=1e-14)
    assert np.all(np.diff(values) >= -1e-14)
    assert weight.is_free.sum() >= MIN_FREE_COEFFICIENTS


def test_knots_are_refined_where_a_support_meets_both_regions_or_the_request_is_refused(monkeypatch):
    fine = stage_masks(GRID.double_samples(), half=0.06)
    weight = choose_knots(fine, (7, 6, 5), (3, 3, 3))
    assert weight.coefficients.shape > (7, 6, 5)
    assert weight.is_free.sum() >= MIN_FREE_COEFFICIENTS
    monkeypatch.setattr(volume_weight_fit, "MAX_COEFFICIENTS", 0)
    with pytest.raises(InvalidRequest, match="supports meet both regions"):
        choose_knots(fine, (7, 6, 5), (3, 3, 3))


def test_distance_transforms_give_the_targets_of_trees():
    area = stage_masks(GRID)
    values, used = assign_target_values(area)
    centres = [(axis[:-1] + axis[1:]) / 2 for axis in GRID.axes]
    where = np.stack(np.meshgrid(*centres, indexing="ij"), axis=-1)
    corners = np.lib.stride_tricks.sliding_window_view
    some, every = (join(corners(area.mixing, (2, 2, 2)), axis=(3, 4, 5)) for join in (np.any, np.all))
    bounds = [
        some & ~every & np.any(corners(side, (2, 2, 2)), axis=(3, 4, 5))
        for side in (area.first_region, area.second_region)
    ]
    near, far = (KDTree(where[bound]).query(where[every])[0] for bound in bounds)
    assert np.allclose(values[every], near / (near + far))
    assert np.array_equal(used, every | bounds[0] | bounds[1])


@pytest.mark.slow
def test_local_lspia_converges_to_the_least_squares_fit_of_the_free_coefficients():
    area = stage_masks(GRID)
    start = choose_knots(stage_masks(GRID.double_samples()), (13, 11, 9), (3, 2, 3))
    values, used = assign_target_values(area)
    x, y, z = ((axis[:-1] + axis[1:]) / 2 for axis in GRID.axes)
    where = np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1)[used]
    rows, free = start.design_matrix(where), start.is_free.ravel()
    fixed = rows @ np.where(free, 0.0, start.coefficients.ravel())
    best = lsqr(rows[:, free], values[used] - fixed, atol=1e-12, btol=1e-12)[0]
    least = np.sqrt(np.mean((rows[:, free] @ best + fixed - values[used]) ** 2))
    rms = [
        np.sqrt(np.mean((fit_local_lspia(start, (x, y, z), values, used, steps)(where) - values[used]) ** 2))
        for steps in (1, 20, 400)
    ]
    assert rms[0] > rms[1] > rms[2] >= 0.999 * least
    assert rms[1] < 1.1 * least
    assert rms[2] < 1.005 * least


def test_a_refined_weight_has_the_same_values():
    line, coarse, fine = (
        make_line_weight(LinearCoordinate(), (0.3, 0.7), (0.0, 1.0)),
        stage_masks(GRID, 0.0),
        stage_masks(GRID.double_samples(), 0.0),
    )
    volume = convert_line_to_volume(line, coarse, fine)
    assert np.allclose(volume(points()), line(points()), atol=1e-12)
    bent = bent_volume((9, 8, 7))
    finer = refine_knots(bent, stage_masks(GRID), stage_masks(GRID.double_samples()))
    assert finer.is_free.sum() > 2 * bent.is_free.sum()
    assert np.allclose(finer(points()), bent(points()), atol=1e-12)
    round_line = make_line_weight(SphereRadius((0.5, 0.4, 0.3)), (0.2, 0.4), (0.0, 0.7))
    radius = np.sqrt(np.sum((GRID.points() - np.array([0.5, 0.4, 0.3])) ** 2, axis=-1))
    shells = StageMasks(GRID, radius < 0.2, radius > 0.4, (radius >= 0.2) & (radius <= 0.4))
    near = convert_line_to_volume(round_line, shells, shells)
    assert np.sqrt(np.mean((near(points()) - round_line(points())) ** 2)) < 0.1
