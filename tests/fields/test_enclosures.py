"""Laws of enclosures: sampled values and gradients lie within, for every operation of a tape, and widths vanish with the box."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.field_tape import HIGH, LOW, make_kinds
from tests.fields.test_tape import TracedFormula, draw_knots
from tpmscad import fields
from tpmscad._typing import Array
from tpmscad.fields.kinds.linear_extension import extend_linearly
from tpmscad.fields.tape import tape_nodes
from tpmscad.fields.tape.affine_forms import Form
from tpmscad.fields.tape.tape_enclosures import JetEnclosures, TapeEnclosures
from tpmscad.fields.tape.tape_interpreter import OPERATIONS
from tpmscad.fields.tape.tape_nodes import ELEMENTARY_FUNCTIONS, Node

KINDS = make_kinds()
Formula = Callable[[Node, Node, Node], Node]


def make_boxes(seed: int, size: float, count: int = 60) -> tuple[Array, Array]:
    rng = np.random.default_rng(seed)
    center, half = rng.uniform(LOW, HIGH, (count, 3)), 0.5 * size * rng.uniform(0.1, 1.0, (count, 3))
    return center - half, center + half


def sample_boxes(lo: Array, hi: Array, per_box: int = 30) -> Array:
    """Points (n, m, 3) of boxes, two corners included."""
    part = np.random.default_rng(1).random((len(lo), per_box, 3))
    part[:, 0], part[:, 1] = 0.0, 1.0
    return np.clip(lo[:, None] + part * (hi - lo)[:, None], lo[:, None], hi[:, None])


def assert_within(form: Form, values: Array, points: Array, lo: Array, hi: Array) -> None:
    """Finite values (n, m) lie in the range of the form, and no further from its affine function than its remainder."""
    finite = np.isfinite(values)
    terms = np.moveaxis(form.slope, 0, 1)[:, None] * (points - (0.5 * lo + 0.5 * hi)[:, None])
    affine = form.center[:, None] + terms.sum(axis=-1)
    own = 4 * np.finfo(float).eps * (np.abs(form.center)[:, None] + np.abs(terms).sum(axis=-1))  # of this computation
    assert ((values >= form.low[:, None]) & (values <= form.high[:, None]) | ~finite).all()
    assert ((np.abs(values - affine) <= form.remainder[:, None] + own) | ~finite).all()


def assert_encloses(field: fields.Field, lo: Array, hi: Array, defined: fields.Field | None = None) -> JetEnclosures:
    """Values and gradients lie within, but where the second field is not finite."""
    found, points = TapeEnclosures(field.tape).enclose(lo, hi, True), sample_boxes(lo, hi)
    values, gradients = field.value_and_gradient(points)
    if defined is not None:
        values[~np.isfinite(defined(points))] = np.nan
        gradients[~np.isfinite(defined(points))] = np.nan
    assert_within(found.value, values, points, lo, hi)
    for axis in range(3):
        assert_within(found.gradient[axis], gradients[..., axis], points, lo, hi)
    return found


@pytest.mark.parametrize("name", KINDS)
def test_values_and_gradients_lie_within_and_widths_vanish_with_the_box(name: str) -> None:
    widths = []
    for size in (1.0, 1e-2, 1e-4, 1e-7):
        found = assert_encloses(KINDS[name], *make_boxes(5, size))
        low, high = found.gradient_ranges
        widths.append([np.median(found.value.high - found.value.low), np.median((high - low).max(axis=0))])
    assert (np.array(widths[2]) < 0.1 * np.array(widths[1]) + 1e-9).all()
    assert (np.array(widths[3]) < 1e-4).all()


@pytest.mark.parametrize("name", ["gyroid", "cell sizes", "sphere", "formula", "rotated", "B-spline unit"])
def test_remainders_are_of_second_order(name: str) -> None:
    lo, hi = make_boxes(6, 1.0)
    center, half = 0.5 * (lo + hi), 0.5 * (hi - lo)
    enclosures = TapeEnclosures(KINDS[name].tape)
    first, second = (enclosures.enclose(center - s * half, center + s * half, False).value for s in (1e-2, 5e-3))
    assert np.median(second.remainder / (first.remainder + 1e-12)) < 0.27


def _unary(node: Node, number: int) -> Node:
    names = sorted(ELEMENTARY_FUNCTIONS)
    if number < len(names):
        return tape_nodes.apply_function(names[number], node)
    knots, coefficients = np.array([-1.0, 0.2, 0.9, 3.0]), np.array([[1.0, -2, 0.5], [0.3, 1, -1], [-1.0, 0.1, 2]])
    others: list[Callable[[Node], Node]] = [
        tape_nodes.sine,
        tape_nodes.cosine,
        tape_nodes.absolute,
        tape_nodes.root,
        lambda n: tape_nodes.power(n, 3.0),
        lambda n: tape_nodes.power(n, -2.0),
        lambda n: tape_nodes.power(n, 2.5),
        lambda n: tape_nodes.power(n, 5.0),
        lambda n: tape_nodes.clamp(n, -0.4, 0.6),
        lambda n: 1.7 * n - 0.3,
        lambda n: tape_nodes.piecewise_polynomial(knots, coefficients, n),
    ]
    return others[number - len(names)](node)


def _binary(a: Node, b: Node, number: int) -> Node:
    return (a + b, a - b, a * b, a / b, tape_nodes.choose_extreme(+1, a, b), tape_nodes.angle(a, b), a * a)[number]


@st.composite
def formulas(draw: st.DrawFn) -> tuple[Formula, Formula]:
    """Random formulas of up to twelve operations of every kind but splines in space, and the sum of all their results."""
    steps = [
        (
            draw(st.booleans()),
            draw(st.integers(0, 19)),
            draw(st.integers(0, 6)),
            draw(st.integers(0, 99)),
            draw(st.integers(0, 99)),
        )
        for _ in range(draw(st.integers(1, 12)))
    ]

    def list_results(x: Node, y: Node, z: Node) -> list[Node]:
        known = [x, y, z]
        for is_unary, one, two, first, second in steps:
            a, b = known[-1 - first % len(known)], known[-1 - second % len(known)]
            known.append(_unary(a, one) if is_unary else _binary(a, b, two))
        return known

    return lambda *xyz: list_results(*xyz)[-1], lambda *xyz: tape_nodes.sum_nodes(list_results(*xyz))


@settings(deadline=None, max_examples=150)
@given(formulas(), st.integers(0, 1000), st.sampled_from([3.0, 0.3, 1e-3]))
def test_random_formulas_lie_within(formula: tuple[Formula, Formula], seed: int, size: float) -> None:
    with np.errstate(all="ignore"):
        assert_encloses(TracedFormula(formula[0]), *make_boxes(seed, size, 20), TracedFormula(formula[1]))


@pytest.mark.parametrize("degrees", [(3, 3, 3), (1, 2, 4), (5, 0, 2)])
@pytest.mark.parametrize("size", [1.0, 0.05, 1e-3])
def test_splines_of_any_degrees_and_knots_lie_within(degrees: tuple[int, int, int], size: float) -> None:
    rng, counts = np.random.default_rng(7), (9, 11, 12)
    knots = draw_knots(rng, degrees, counts)
    coefficients = rng.standard_normal(counts)
    field = TracedFormula(lambda *nodes: tape_nodes.tensor_spline(knots, degrees, coefficients, nodes))
    lo = np.random.default_rng(2).uniform(0, 1 - size, (80, 3))
    found = assert_encloses(field, lo, lo + size * 0.999)
    assert found.may_jump.all() == (0 in degrees)
    low, high = coefficients.min(), coefficients.max()
    assert (found.value.low >= low - 1e-9).all()
    assert (found.value.high <= high + 1e-9).all()


@pytest.mark.parametrize("size", [4.0, 0.3, 1e-3])
def test_periodic_splines_lie_within_across_their_period(size: float) -> None:
    # steps as wide as a B-spline, on which the values are the coefficients
    steps = np.random.default_rng(3).standard_normal((2, 3, 2))
    coefficients = np.asarray(np.kron(steps, np.ones((5, 5, 5))), float)
    field = TracedFormula(lambda *nodes: tape_nodes.periodic_spline(coefficients, (2.0, 3.0, 1.5), nodes))
    assert_encloses(field, *make_boxes(8, size, 80))


def test_every_operation_of_a_tape_has_an_enclosure() -> None:
    splines = {"tensor", "periodic_spline", "piecewise"}
    moves = {"load", "output", "guard", "constant", "check", "chain", "greater", "at_least", "select"}
    names = {
        "scale",
        "shift",
        "add",
        "subtract",
        "multiply",
        "divide",
        "absolute",
        "root",
        "sine_cosine",
        "power",
        "angle",
    }
    assert set(OPERATIONS) == splines | moves | names | ELEMENTARY_FUNCTIONS


def test_values_that_may_jump_are_told_and_extremes_do_not() -> None:
    def jump(x: Node, y: Node, z: Node) -> Node:
        return tape_nodes.select(x > 0.5, y, z)

    lo, hi = np.array([[0.0, 0, 0], [0.4, 0, 0], [0.6, 0, 0]]), np.array([[0.3, 1, 1], [0.6, 1, 1], [0.9, 1, 1]])
    assert TapeEnclosures(TracedFormula(jump).tape).enclose(lo, hi, False).may_jump.tolist() == [False, True, False]
    both = fields.sphere((-1, 0, 0), 1) & fields.halfspace((0, 0, 0), "x")
    assert not TapeEnclosures(both.tape).enclose(lo, hi, False).may_jump.any()
    turn = fields.expression("atan2(y - 0.5, x - 0.5)")
    assert TapeEnclosures(turn.tape).enclose(lo, hi, False).may_jump.tolist() == [True, True, False]


def test_a_linear_extension_is_that_of_its_field_in_boxes_up_to_its_faces() -> None:
    inner, lo, hi = fields.tpms("gyroid", 2.0), np.array([[0.0, 0.0, 0.25]]), np.array([[0.1, 0.2, 0.5]])
    outer = extend_linearly(inner, lo[0], hi[0])
    one, other = (TapeEnclosures(f.tape).enclose(lo, hi, True) for f in (inner, outer))
    assert not other.may_jump.any()
    np.testing.assert_allclose(other.value.high - other.value.low, one.value.high - one.value.low, rtol=1e-9)
    np.testing.assert_allclose(other.gradient_ranges, one.gradient_ranges, rtol=1e-9, atol=1e-12)


def test_what_no_tape_holds_may_have_any_value() -> None:
    found = TapeEnclosures(fields.from_function(lambda x, y, z: x * y).tape).enclose(
        np.zeros((2, 3)), np.ones((2, 3)), True
    )
    assert np.isneginf(found.value.low).all()
    assert np.isposinf(found.gradient[1].high).all()
    assert found.may_jump.all()
