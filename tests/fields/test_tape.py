"""Laws of tapes: the compiled evaluation agrees with NumPy's, on points and on grids of any length, for every kind of field."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.field_tape import HIGH, LOW, compare, make_kinds
from tpmscad import fields
from tpmscad.errors import InvalidRequest
from tpmscad.fields.field_tape import JointTape
from tpmscad.fields.linear_extension import extend_linearly
from tpmscad.fields.tape_nodes import Node, select

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
    jets = list(JointTape((first, second)).jets_on_grid(*axes))
    assert counted.counts == [4 * 5 * 33]
    for field, (values, gradients) in zip((first, second), jets, strict=True):
        expected, slopes = field.value_and_gradient_on_grid(*axes)
        assert np.array_equal(values, expected)
        assert np.array_equal(gradients, slopes)
