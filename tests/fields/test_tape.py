"""Laws of tapes: the compiled evaluation agrees with NumPy's, on points and on grids of any length, for every kind of field."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import NdBSpline

from benchmarks.field_tape import HIGH, LOW, compare, make_kinds
from tpmscad import fields
from tpmscad.errors import InvalidRequest
from tpmscad.fields.kinds.linear_extension import extend_linearly
from tpmscad.fields.tape.field_tape import SharedTape
from tpmscad.fields.tape.tape_nodes import Node, select, tensor_spline

KINDS = make_kinds()
VALUE_TOL, GRADIENT_TOL = 1e-14, 1e-12
"""Differences from NumPy, relative to the greatest value and gradient."""


class TracedFormula(fields.Field):
    """A field of a formula of nodes, given as a function."""

    __slots__ = ("formula",)

    def __init__(self, formula: object) -> None:
        self.formula = formula

    def trace(self, x: Node, y: Node, z: Node) -> Node:
        return self.formula(x, y, z)  # type: ignore[operator]


@pytest.mark.parametrize("name", KINDS)
def test_the_tape_has_the_values_and_gradients_of_numpy(name: str) -> None:
    points = np.random.default_rng(3).uniform(LOW - 0.5, HIGH + 0.5, (3000, 3))
    values, gradients = compare(KINDS[name], points)
    assert values <= VALUE_TOL
    # beyond the box the gradient is a difference quotient, which magnifies round-off
    assert gradients <= (GRADIENT_TOL if name != "extended blend" else 10 * GRADIENT_TOL)


@pytest.mark.parametrize("name", KINDS)
def test_long_lines_of_a_grid_have_the_bits_of_their_points(name: str) -> None:
    rng = np.random.default_rng(4)
    axes = [np.sort(rng.uniform(LOW[0] - 0.5, HIGH[0] + 0.5, n)) for n in (3, 5, 300)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    values, gradients = KINDS[name].value_and_gradient_on_grid(*axes)
    expected, slopes = KINDS[name].value_and_gradient(points)
    assert np.array_equal(values, expected)
    assert np.array_equal(gradients, slopes)
    assert np.array_equal(KINDS[name].on_grid(*axes), expected)


@pytest.mark.parametrize("scale", [1.0, 1e3, 1e6, 1e12])
def test_sine_and_cosine_are_right_to_the_last_place_or_so(scale: float) -> None:
    angles = np.concatenate([np.random.default_rng(1).uniform(-scale, scale, 5000), np.arange(-8, 9) * np.pi / 4])
    points = np.stack([angles, 0 * angles, 0 * angles], axis=1)
    wave = fields.expression("sin(x)")
    assert np.abs(wave(points) - np.sin(angles)).max() < 2.3e-16
    assert np.abs(wave.gradient(points)[:, 0] - np.cos(angles)).max() < 2.3e-16


def test_operations_that_no_point_of_a_block_needs_are_not_run() -> None:
    seen = []

    def refuse(value: float, point: tuple[float, float, float]) -> InvalidRequest:
        seen.append((value, point))
        return InvalidRequest("too great")

    def formula(x: Node, y: Node, z: Node) -> Node:
        recorder = x.recorder
        with recorder.where(y > 0.0):
            checked = recorder.require_within(x, -1.0, 1.0, refuse)
        return select(y > 0.0, checked, z)

    field = TracedFormula(formula)
    assert field((5.0, -1.0, 7.0)) == 7.0
    assert np.array_equal(field([[5.0, -1.0, 7.0], [0.5, 1.0, 0.0]]), [7.0, 0.5])
    with pytest.raises(InvalidRequest, match="too great"):
        field([[5.0, -1.0, 7.0], [3.0, 1.0, 2.0]])
    assert seen == [(3.0, (3.0, 1.0, 2.0))]


def test_equal_operations_are_recorded_once() -> None:
    phi = fields.tpms("gyroid", 2.0)
    alone, twice = len(phi.tape.evaluator(True).nodes), len((phi + phi).tape.evaluator(True).nodes)
    assert twice == alone + 4


def test_a_foreign_function_in_turned_coordinates_is_an_input_of_the_tape() -> None:
    foreign = fields.from_function(lambda x, y, z: np.sin(x) * y + z)
    turned = fields.rotate(foreign, "z", 30, (1, 0, 0)) & fields.sphere((0, 0, 0), 2.0)
    own = fields.rotate(fields.expression("sin(x)*y + z"), "z", 30, (1, 0, 0)) & fields.sphere((0, 0, 0), 2.0)
    points = np.random.default_rng(2).uniform(-2, 2, (500, 3))
    assert np.abs(turned(points) - own(points)).max() < 1e-14
    assert np.abs(turned.gradient(points) - own.gradient(points)).max() < 1e-9


def test_a_foreign_function_that_is_used_twice_is_called_once() -> None:
    calls = []

    def foreign(p: np.ndarray) -> np.ndarray:
        calls.append(len(p))
        return p[:, 0] * p[:, 1]

    wall = fields.sheet(fields.from_function(foreign), -0.1, 0.1)
    calls.clear()
    wall(np.ones((50, 3)))
    assert calls == [50]


class CountedField(fields.Field):
    """x y + z outside the tape, with the number of points of every call."""

    __slots__ = ("counts",)

    def __init__(self) -> None:
        self.counts: list[int] = []

    def at(self, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        return self.jet(x, y, z)[0]

    def jet(self, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, ...]:
        value = x * y + z
        self.counts.append(value.size)
        return value, y + 0 * value, x + 0 * value, np.ones_like(value)


def test_a_function_outside_the_tape_is_called_once_for_points_inside_the_box_of_an_extension() -> None:
    counted = CountedField()
    extended = extend_linearly(counted, np.zeros(3), np.ones(3))
    points = np.random.default_rng(6).uniform(0, 1, (500, 3))
    points[:7, 0] += 1.0
    values, gradients = extended.value_and_gradient(points)
    assert counted.counts == [500, 7]  # at the clamped points, and beside those outside for the extension's derivative
    x, y, z = points[7:].T
    np.testing.assert_allclose(values[7:], x * y + z, rtol=1e-15)
    np.testing.assert_allclose(gradients[7:], np.stack([y, x, np.ones_like(x)], axis=1), rtol=1e-15)
    np.testing.assert_allclose(values[:7], points[:7, 0] * points[:7, 1] + points[:7, 2], rtol=1e-9)
    counted.counts.clear()
    extended.on_grid(*np.linspace(0, 1, 60).reshape(3, 20))
    assert counted.counts == [8000]


def test_fields_sampled_together_have_the_values_of_each_and_call_what_they_share_once() -> None:
    counted = CountedField()
    first, second = counted - fields.sphere((0.5, 0.5, 0.5), 0.3), -counted - 0.25
    axes = [np.linspace(0, 1, n) for n in (4, 5, 33)]
    jets = list(SharedTape((first, second)).jets_on_grid(*axes))
    assert counted.counts == [4 * 5 * 33]
    for field, (values, gradients) in zip((first, second), jets, strict=True):
        expected, slopes = field.value_and_gradient_on_grid(*axes)
        assert np.array_equal(values, expected)
        assert np.array_equal(gradients, slopes)


def draw_knots(rng: np.random.Generator, degrees: tuple[int, ...], counts: tuple[int, ...]) -> list[np.ndarray]:
    """Clamped knots on [0, 1] at random places; those of degree 2 and more have a double one."""
    knots = []
    for degree, count in zip(degrees, counts, strict=True):
        inner = np.sort(rng.uniform(0.0, 1.0, count - degree - 1))
        if degree > 1:
            inner[len(inner) // 2] = inner[len(inner) // 2 - 1]
        knots.append(np.concatenate([np.zeros(degree + 1), inner, np.ones(degree + 1)]))
    return knots


@pytest.mark.parametrize("degrees", [(3, 3, 3), (1, 2, 4), (5, 0, 8)])
def test_tensor_product_splines_of_any_degrees_and_knots_are_those_of_scipy(degrees: tuple[int, int, int]) -> None:
    rng, counts = np.random.default_rng(7), (9, 11, 12)
    knots = draw_knots(rng, degrees, counts)
    coefficients = rng.standard_normal(counts)
    field = TracedFormula(lambda *nodes: tensor_spline(knots, degrees, coefficients, nodes))
    points = np.concatenate([rng.uniform(0.0, 1.0, (400, 3)), np.zeros((1, 3)), np.ones((1, 3))])
    spline = NdBSpline(tuple(knots), coefficients, degrees)
    values, gradients = field.value_and_gradient(points)
    np.testing.assert_allclose(values, spline(points), atol=1e-13)
    assert np.array_equal(field(points), values)
    inside = points[:400]
    for axis in range(3):
        slope = spline(inside, nu=[int(k == axis) for k in range(3)])
        np.testing.assert_allclose(gradients[:400, axis], slope, atol=1e-12 * np.abs(slope).max())


@pytest.mark.parametrize("count", [6, 400])
def test_splines_have_the_same_bits_on_lines_of_a_grid_that_are_short_or_long_beside_their_table(count: int) -> None:
    rng = np.random.default_rng(11)
    degrees, counts = (3, 1, 5), (7, 6, count)
    knots = [
        np.concatenate([np.zeros(p), np.linspace(0.0, 1.0, n - p + 1), np.ones(p)])
        for p, n in zip(degrees, counts, strict=True)
    ]
    coefficients = rng.standard_normal(counts)
    field = TracedFormula(lambda *nodes: tensor_spline(knots, degrees, coefficients, nodes))
    axes = [np.sort(rng.uniform(0.0, 1.0, n)) for n in (3, 4, 40)]
    values, gradients = field.value_and_gradient_on_grid(*axes)
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    assert np.array_equal(field(points), values)
    assert np.array_equal(field.on_grid(*axes), values)
    assert np.array_equal(field.gradient(points), gradients)


def test_splines_are_evaluated_at_the_points_of_their_mask_only_whatever_the_others_are() -> None:
    knots = [np.array([0.0, 0.0, 1.0, 1.0])] * 3
    coefficients = np.arange(8.0).reshape(2, 2, 2)

    def formula(x: Node, y: Node, z: Node) -> Node:
        with x.recorder.where(x <= 1.0):
            inner = tensor_spline(knots, (1, 1, 1), coefficients, (x, y, z))
        return select(x <= 1.0, inner, y)

    points = np.random.default_rng(2).uniform(0.0, 1.0, (300, 3))
    points[::3, 0] += 5.0
    expected = np.where(points[:, 0] <= 1.0, points @ [4.0, 2.0, 1.0], points[:, 1])
    values, gradients = TracedFormula(formula).value_and_gradient(points)
    np.testing.assert_allclose(values, expected, atol=1e-14)
    inside = points[:, [0]] <= 1.0
    np.testing.assert_allclose(gradients, np.where(inside, [4.0, 2.0, 1.0], [0.0, 1.0, 0.0]), atol=1e-13)


def test_what_a_region_in_a_region_needs_is_what_both_masks_hold() -> None:
    called = []

    def count(points: np.ndarray) -> np.ndarray:
        called.append(points[:, :2])
        return points[:, 0]

    foreign = fields.as_field(count)

    def formula(x: Node, y: Node, z: Node) -> Node:
        with x.recorder.where(x > 0.0):
            with x.recorder.where(y > 0.0):
                inner = foreign.trace(x, y, z)
            outer = select(y > 0.0, inner, z)
        return select(x > 0.0, outer, z)

    field = TracedFormula(formula)
    points = np.random.default_rng(5).uniform(-1.0, 1.0, (200, 3))
    called.clear()
    values = field(points)
    needed = (points[:, :2] > 0).all(axis=1)
    assert np.array_equal(values, np.where(needed, points[:, 0], points[:, 2]))
    assert np.array_equal(np.concatenate(called), points[needed, :2])


def test_a_foreign_function_may_need_the_result_of_another() -> None:
    inner = fields.as_field(lambda points: 2 * points[..., 0])
    outer = fields.as_field(lambda points: points[..., 0] + points[..., 1] * points[..., 2])
    field = TracedFormula(lambda x, y, z: outer.trace(inner.trace(x, y, z), y, z))
    points = np.random.default_rng(6).uniform(-1.0, 1.0, (50, 3))
    np.testing.assert_allclose(field(points), 2 * points[:, 0] + points[:, 1] * points[:, 2], rtol=1e-14)


def test_an_extension_of_an_extension_is_that_of_the_inner_box() -> None:
    gyroid = fields.tpms("gyroid", 1.0)
    inner = extend_linearly(gyroid, np.zeros(3), np.ones(3))
    both = extend_linearly(inner, np.full(3, -0.25), np.full(3, 1.25))
    smaller = extend_linearly(inner, np.zeros(3), np.full(3, 0.5))
    points = np.random.default_rng(8).uniform(-1.0, 2.0, (500, 3))
    for a, b in zip(both.value_and_gradient(points), inner.value_and_gradient(points), strict=True):
        assert np.array_equal(a, b)
    assert not np.allclose(smaller(points), inner(points))
