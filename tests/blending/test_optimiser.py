"""The parts of the optimiser, compared with independent computations."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from tpmscad import fields, topology
from tpmscad.blending import blend
from tpmscad.blending.composition.blended_field import BlendedField
from tpmscad.blending.composition.defects import count_defects
from tpmscad.blending.composition.sampled_composition import sample_composition
from tpmscad.blending.initial_weights import LineWeightSpec, VolumeWeightSpec, make_initial_weight
from tpmscad.blending.optimise.gradient_descent import descend, evaluate_objective
from tpmscad.blending.weights import constraints as weight_constraints
from tpmscad.blending.weights.constraints import NO_CONSTRAINTS, WeightConstraints, add_consistent_constraints
from tpmscad.blending.weights.coordinates import LinearCoordinate
from tpmscad.fields.analysis.saddles import Saddles, find_saddles, measure_neck_widths
from tpmscad.fields.data.sample_grid import SampleGrid

LEFT, RIGHT = fields.box((0, 0, 0), (0.5, 0.5, 0.5)), fields.box((0.5, 0, 0), (1, 0.5, 0.5))
MIDDLE = fields.box((0.25, 0, 0), (0.75, 0.5, 0.5))
PAIR = fields.rod(fields.tpms("schwarz_p", period=0.25), -0.8), fields.rod(fields.tpms("iwp", period=0.25), -2.2)
FIELD = BlendedField(PAIR, (LEFT, RIGHT), (MIDDLE,), ())
COMPOSITIONS = (
    sample_composition(FIELD, SampleGrid((0, 0, 0), (1, 0.5, 0.5), (37, 21, 19))),
    sample_composition(FIELD, SampleGrid((0, 0, 0), (1, 0.5, 0.5), (74, 42, 38))),
)
LINE = make_initial_weight(LineWeightSpec(LinearCoordinate()), FIELD, COMPOSITIONS, 0)
VOLUME = make_initial_weight(VolumeWeightSpec((20, 9, 8), (3, 2, 3)), FIELD, COMPOSITIONS, 0)


@pytest.mark.parametrize("weight", [LINE, VOLUME], ids=["line", "volume"])
@pytest.mark.parametrize("strict", [True, False])
def test_the_gradient_of_the_objective_is_the_limit_of_difference_quotients(weight, strict):
    affine = COMPOSITIONS[0].affine_form([weight], 0)
    movable = affine.slope != 0

    def value(coefficients):
        return evaluate_objective(affine.values(weight.with_coefficients(coefficients)), movable, strict=strict)

    rng = np.random.default_rng(1)  # equal values at symmetric samples would make the objective's slope ambiguous
    weight = weight.with_coefficients(
        np.where(
            weight.is_free, weight.coefficients + rng.uniform(-0.02, 0.02, weight.is_free.shape), weight.coefficients
        )
    )
    seen = value(weight.coefficients)
    assert seen.n_active > 0
    gradient = affine.gradient(weight, seen.to_dense(COMPOSITIONS[0].grid.shape))
    step = 1e-7
    for _ in range(3):
        direction = np.where(weight.is_free, rng.normal(size=weight.is_free.shape), 0.0)
        quotient = (
            value(weight.coefficients + step * direction).value - value(weight.coefficients - step * direction).value
        ) / (2 * step)
        assert quotient == pytest.approx(float(np.sum(gradient * direction)), rel=1e-4, abs=1e-6)


@pytest.mark.parametrize("strict", [True, False])
def test_the_objective_falls_along_its_gradient_by_samples_in_both_regions_of_the_diagram(strict):
    rng = np.random.default_rng(6)
    values = rng.normal(size=(16, 13, 11)) + 0.4
    movable = rng.random(values.shape) < 0.8
    seen = evaluate_objective(values, movable, strict=strict)
    assert {-1.0, 1.0} == set(seen.derivatives)
    direction, step = rng.normal(size=values.shape), 1e-8
    ends = [evaluate_objective(values + side * step * direction, movable, strict=strict).value for side in (1, -1)]
    assert (ends[0] - ends[1]) / (2 * step) == pytest.approx(
        float(np.sum(seen.to_dense(values.shape) * direction)), rel=1e-5
    )


def test_the_objective_counts_the_pairs_that_persistence_has_inside_the_blending_region():
    affine = COMPOSITIONS[0].affine_form([LINE], 0)
    values, everywhere = affine.values(LINE), np.ones(COMPOSITIONS[0].grid.shape, bool)
    pairs = [topology.compute_persistence(values, dimension).alive_at() for dimension in (0, 2)]
    mortal = [np.isfinite(p.death) for p in pairs]
    expected = sum(np.minimum(p.death[m], -p.birth[m]).sum() for p, m in zip(pairs, mortal, strict=True))
    seen = evaluate_objective(values, everywhere)
    assert seen.value == pytest.approx(expected)
    assert seen.n_active == sum(int(m.sum()) for m in mortal)
    nothing = evaluate_objective(values, ~everywhere)
    assert (nothing.value, nothing.n_active, nothing.n_ignored) == (0.0, 0, seen.n_active)


def test_descent_ends_at_objective_zero_or_reports_the_remaining_pairs():
    done = descend(COMPOSITIONS[0], [LINE], 30, strict=False, convention="strict")
    seen = count_defects(COMPOSITIONS[0].values(done.weights))
    assert (done.objective.value == 0.0) == (done.objective.n_active == 0)
    assert seen.n0 + seen.n2 >= done.objective.n_active + done.objective.n_ignored - 1
    free = LINE.is_free
    assert np.array_equal(done.weights[0].coefficients[~free], LINE.coefficients[~free])


@pytest.mark.parametrize("weight", [LINE, VOLUME], ids=["exact", "iterated"])
def test_nearest_coefficients_are_those_of_a_general_optimiser(weight, monkeypatch):
    monkeypatch.setattr(weight_constraints, "VIOLATION_TOL", 1e-6)
    rng = np.random.default_rng(4)
    points = rng.uniform((0.4, 0.1, 0.1), (0.6, 0.4, 0.4), (4, 3))
    side = np.array([1.0, -1.0, 1.0, -1.0])
    constraints = WeightConstraints(points, weight(points) + side * 0.05, side)
    _, found, left_out = add_consistent_constraints(weight, weight.coefficients, NO_CONSTRAINTS, [constraints])
    assert not left_out
    assert np.array_equal(found[~weight.is_free], weight.coefficients[~weight.is_free])
    rows = weight.design_matrix(points).toarray()
    used = np.flatnonzero(weight.is_free.ravel() & (abs(rows).sum(axis=0) > 0))
    flat = weight.coefficients.ravel()
    oracle = minimize(
        lambda c: 0.5 * np.sum((c - flat[used]) ** 2),
        flat[used],
        jac=lambda c: c - flat[used],
        bounds=[(0, 1)] * len(used),
        constraints={
            "type": "ineq",
            "fun": lambda c: side * (rows[:, used] @ (c - flat[used]) - side * 0.05),
            "jac": lambda c: side[:, None] * rows[:, used],
        },
        method="SLSQP",
        options={"ftol": 1e-14},
    )
    assert np.sum((found.ravel()[used] - flat[used]) ** 2) == pytest.approx(2 * oracle.fun, rel=2e-3)


def test_contradictory_constraints_are_left_out_and_the_others_satisfied():
    here, there = np.array([[0.5, 0.2, 0.2]]), np.array([[0.6, 0.2, 0.2]])
    groups = [
        WeightConstraints(here, np.array([0.7]), np.array([1.0])),
        WeightConstraints(here, np.array([0.3]), np.array([-1.0])),
        WeightConstraints(there, np.array([0.5]), np.array([-1.0])),
    ]
    kept, coefficients, left_out = add_consistent_constraints(
        LINE, LINE.coefficients, WeightConstraints(here[:0], np.zeros(0), np.zeros(0)), groups
    )
    assert left_out == [1]
    assert len(kept) == 2
    weight = LINE.with_coefficients(coefficients)
    assert weight(here)[0] >= 0.7 - 1e-3
    assert weight(there)[0] <= 0.5 + 1e-3


def test_defects_are_counted_with_face_connected_labels():
    rng = np.random.default_rng(2)
    for sigma in (0.0, 0.7, 1.2):
        values = ndimage.gaussian_filter(rng.normal(size=(17, 14, 11)), sigma) if sigma else rng.normal(size=(9, 8, 12))
        seen = count_defects(values)
        assert seen.n0 == ndimage.label(values <= 0)[1] - 1
        void, count = ndimage.label(values > 0)
        border = {int(v) for axis in range(3) for end in (0, -1) for v in np.unique(np.take(void, end, axis))}
        assert seen.n2 == len(set(range(1, count + 1)) - border)
        assert np.array_equal(seen.solid.labels > 0, values <= 0)


def test_a_neck_is_as_wide_as_the_throat_of_a_known_shape():
    radius = 0.11
    throat = fields.from_function(  # a one-sheeted hyperboloid, solid inside: narrowest at the origin, 2 radius wide
        lambda p: p[:, 0] ** 2 + p[:, 1] ** 2 - 0.5 * p[:, 2] ** 2 - radius**2, step=1e-4
    )
    grid = SampleGrid((-0.5, -0.5, -0.5), (0.5, 0.45, 0.55), (14, 15, 16))
    found = find_saddles(throat, grid, np.ones(grid.shape, bool), 0.5)
    assert found.points == pytest.approx(np.zeros((1, 3)), abs=1e-7)
    assert measure_neck_widths(throat, found, grid, 0.3)[0] == pytest.approx([2 * radius], rel=3e-3)


@pytest.mark.parametrize("seed", range(6))
def test_the_least_width_of_an_oval_neck_is_found_in_any_direction(seed: int):
    least, most = 0.11, 0.3
    axes = Rotation.random(rng=np.random.default_rng(seed)).as_matrix()

    def oval(p: np.ndarray) -> np.ndarray:
        x, y, z = (p @ axes).T
        return (x / least) ** 2 + (y / most) ** 2 - 0.5 * (z / least) ** 2 - 1.0

    throat = fields.from_function(oval, step=1e-4)
    grid = SampleGrid((-0.5, -0.5, -0.5), (0.5, 0.45, 0.55), (14, 15, 16))
    saddle = Saddles(np.zeros((1, 3)), np.array([-1.0]))
    width, direction = measure_neck_widths(throat, saddle, grid, 0.3)
    assert width == pytest.approx([2 * least], rel=3e-3)
    assert abs(direction[0] @ axes[:, 0]) == pytest.approx(1.0, abs=1e-3)


@pytest.mark.slow
def test_necks_are_widened_to_the_request_and_topology_stays_right():
    quarter = fields.box((0, 0, 0), (0.5, 0.25, 0.25)), fields.box((0.5, 0, 0), (1, 0.25, 0.25))
    pair = fields.rod(fields.tpms("gyroid", period=1 / 8), -0.4), fields.rod(fields.tpms("iwp", period=1 / 8), -2.0)
    middle, width = fields.box((0.3, 0, 0), (0.7, 0.25, 0.25)), 0.1 / 8
    grid = SampleGrid((0, 0, 0), (1, 0.25, 0.25), (81, 27, 29))

    def narrowest(result):
        where = middle(grid.points()) <= 0
        found = find_saddles(result.field, grid, where, 1.5 * width)
        inside = middle(found.points) <= 0
        solid = result.field(found.points) < 0
        least = np.inf
        for point, is_solid in zip(
            found.points[inside], solid[inside], strict=True
        ):  # by brute force on a fine lattice
            t = np.linspace(-0.6 * width, 0.6 * width, 33)
            ball = np.stack(np.meshgrid(t, t, t, indexing="ij"), -1).reshape(-1, 3)
            near = point + ball
            other = (result.field(near) < 0) != is_solid
            other &= np.all((near >= 0) & (near <= (1, 0.25, 0.25)), axis=1)
            if other.any():
                least = min(least, 2 * float(np.sqrt((ball[other] ** 2).sum(axis=1)).min()))
        return least

    plain = blend(pair, quarter, [middle], resolution=(50, 50, 50))
    wide = blend(pair, quarter, [middle], resolution=(50, 50, 50), minimum_neck=width)
    assert narrowest(plain) < 0.7 * width
    assert narrowest(wide) >= 0.95 * width
    assert wide.converged
    assert wide.necks == ()
