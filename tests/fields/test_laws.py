"""Laws that every kind of field obeys."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from tpmscad import fields
from tpmscad.errors import InvalidRequest

RNG = np.random.default_rng(7)
GYROID = fields.tpms("gyroid", (2.5, 3.0, 2.0), (0.1, 0.2, 0.3))
UNIT = fields.bspline_unit(RNG.normal(size=(4, 5, 6)), (2.0, 3.0, 2.5))
BALL = fields.sphere((0.1, 0.2, 0.3), 1.3)
DRAWN = RNG.random((6, 5, 4)) > 0.5


def bend(p: np.ndarray) -> np.ndarray:
    x, y, z = p[:, 0], p[:, 1], p[:, 2]
    return np.stack([x + 0.1 * y**2, y * (1 + 0.2 * np.sin(z)), z], axis=-1)


def bend_jacobian(p: np.ndarray) -> np.ndarray:
    x, y, z = p[:, 0], p[:, 1], p[:, 2]
    rows = np.zeros((len(p), 3, 3))
    rows[:, 0, 0], rows[:, 0, 1], rows[:, 2, 2] = 1 + 0 * x, 0.2 * y, 1
    rows[:, 1, 1], rows[:, 1, 2] = 1 + 0.2 * np.sin(z), 0.2 * y * np.cos(z)
    return rows


KINDS = {
    **{name: fields.tpms(name, (2.5, 3.0, 2.0), (0.1, 0.2, 0.3)) for name in fields.TPMS},
    "bspline_unit": UNIT,
    "one coefficient": fields.bspline_unit(np.ones((1, 2, 3)), 1.0),
    "rod": fields.rod(GYROID, fields.ramp("x", (-1, 2), (-0.5, 0.4))),
    "pore": fields.pore(UNIT, 0.2),
    "sheet": fields.sheet(GYROID, -0.3, fields.ramp(BALL, (-1, 1), (0.1, 0.5), smooth=False)),
    "wall": fields.wall(GYROID, 0.3),
    "graded wall": fields.wall(fields.tpms("octo", 2.5), fields.ramp("x", (-1, 2), (0.1, 0.2))),
    "distance": fields.normal_distance(fields.tpms("schwarz_p", 2.0)),
    "box": fields.box((0, -1, 0.5), (2, 1, 3)),
    "slab": fields.box((0, -np.inf, -np.inf), (2, np.inf, np.inf)),
    "corner": fields.box((-np.inf, -np.inf, -np.inf), (2, 1, np.inf)),
    "halfspace": fields.halfspace((1, 0, 0.5), (1, 2, 3)),
    "sphere": BALL,
    "clip": fields.clip(GYROID, -0.4, 0.9),
    "cylinder": fields.cylinder((0.1, 0.2, 0.3), 0.8, (1, 1, 0.3)),
    "short cylinder": fields.cylinder((0.1, 0.2, 0.3), 0.8, "y", 1.4),
    "struts": fields.struts([[0, 0, 0], [2, 1, 0], [-1, 2, 1], [0, 1, 3]], [[0, 1], [0, 2], [2, 3]], 0.5),
    "struts of two diameters": fields.struts([[0, 0, 0], [2, 1, 0], [-1, 2, 1]], [[0, 1], [0, 2]], [0.5, 0.9]),
    "strut lattice": fields.strut_lattice("re-entrant", (2.0, 1.5, 3.0), 0.3, node_radius=0.25),
    "core": fields.core("re-entrant", 1.5, 0.2, (1, 2, 2)),
    "image": fields.image_region(DRAWN[:, :, 0], (-2, -2), (2.5, 2)),
    "image along x": fields.image_region(DRAWN[:, :, 1], (-2, -2), (2.5, 2), axis="x"),
    "image stack": fields.image_region(DRAWN, (-2, -2, -1), (2.5, 2, 2)),
    "union": GYROID | BALL,
    "intersection": GYROID & BALL,
    "difference": fields.difference(GYROID, BALL, UNIT),
    "smooth union": fields.smooth_union(GYROID, BALL, 0.7),
    "smooth intersection": fields.smooth_intersection(GYROID, BALL, 0.7),
    "smooth difference": fields.smooth_difference(GYROID, BALL, 0.7),
    "arithmetic": 2 * GYROID * fields.linear((1, 0, -2), 3) - GYROID / 4 + 1 - UNIT,
    "constant": fields.constant(0.25),
    "mapped": fields.warp(GYROID, bend, bend_jacobian),
    "mapped without Jacobian": fields.warp(UNIT, bend),
    "cell sizes": fields.cell_sizes(GYROID, x=((-1, 0.5, 2), (2.5, 2.5, 1.5)), z=((-0.7, 1.1), (1.2, 2.4))),
    "rotated": fields.rotate(GYROID | UNIT, (1, 2, 3), 31, (1, 0, 0)),
    "translated": fields.translate(UNIT, (1, 0, 2)),
    "scaled": fields.scale(GYROID, 2.0, (1, 1, 1)),
    "samples": fields.sampled(RNG.normal(size=(5, 6, 7)), (1.0, 0.8, 0.9), (-2, -1.5, -1)),
    "formula": fields.expression("sin(2*x)*exp(y/4) + atan2(y + 9, x^2 + g) / (2 + cos(z))^2 - abs(x*z)", 5.0, g=BALL),
    "periodic formula": fields.expression("sin(x)*cos(2*y) + cos(y)*sin(z) - cos(3*x)/2", 2.5),
    "function of points": fields.from_function(lambda p: np.sin(p[:, 0]) * p[:, 1]),
    "function of coordinates": fields.from_function(lambda x, y, z: np.sin(x) * y + z),
}
POINTS = RNG.uniform(-3, 4, (2000, 3))
AXES = tuple(np.sort(RNG.uniform(-4, 4, n)) for n in (9, 8, 7))
GRID = np.stack(np.meshgrid(*AXES, indexing="ij"), axis=-1)

STEP = 1e-4
ROUND_OFF_SHARE, CREASE_SHARE = 1e-8, 5e-3
"""Of a derivative by differences at STEP; and the part of the points that may lie that near to a crease."""


@pytest.fixture(params=KINDS)
def field(request: pytest.FixtureRequest) -> fields.Field:
    return KINDS[request.param]


@pytest.mark.slow
def test_the_gradient_is_the_derivative_of_the_value(field: fields.Field) -> None:
    quotient = np.stack(
        [
            (8 * (field(POINTS + e) - field(POINTS - e)) - (field(POINTS + 2 * e) - field(POINTS - 2 * e))) / 12
            for e in STEP * np.eye(3)
        ],
        axis=-1,
    )
    wrong = np.abs(quotient / STEP - field.gradient(POINTS)).max(axis=1) > ROUND_OFF_SHARE
    assert wrong.mean() <= CREASE_SHARE


@pytest.mark.slow
def test_a_point_has_the_same_bits_in_any_company(field: fields.Field) -> None:
    values, slopes = field.value_and_gradient(POINTS)
    order = np.random.default_rng(1).permutation(len(POINTS))
    assert (field(POINTS[order]) == values[order]).all()
    assert (field.gradient(POINTS[order]) == slopes[order]).all()
    assert all(field(p) == v for p, v in zip(POINTS[:40], values[:40], strict=True))
    assert all((field.gradient(p) == g).all() for p, g in zip(POINTS[:40], slopes[:40], strict=True))
    strided = np.asfortranarray(np.repeat(POINTS, 2, axis=0))[::2]
    assert (field(strided) == values).all()


def test_a_grid_has_the_bits_of_its_points(field: fields.Field) -> None:
    assert (field.on_grid(*AXES) == field(GRID)).all()
    values, slopes = field.value_and_gradient_on_grid(*AXES)
    assert (values == field(GRID)).all()
    assert (slopes == field.gradient(GRID)).all()


def test_shapes_are_those_of_the_points(field: fields.Field) -> None:
    for shape in ((3,), (0, 3), (1, 3), (2, 4, 3), (2, 1, 0, 3)):
        points = np.zeros(shape) + 0.3
        assert field(points).shape == shape[:-1]
        assert field.gradient(points).shape == shape


def test_stated_periods_leave_the_field_unchanged(field: fields.Field) -> None:
    periods = field.periods()
    if periods is not None:
        np.testing.assert_allclose(field(POINTS + np.array(periods)), field(POINTS), rtol=0, atol=1e-12)


def test_more_points_than_a_slab_change_nothing() -> None:
    many = np.random.default_rng(3).uniform(-9, 9, (70_000, 3))
    assert (GYROID(many)[-5_000:] == GYROID(many[-5_000:])).all()
    x = np.linspace(0, 5, 300)
    assert (GYROID.on_grid(x, x[:150], x[:100])[299] == GYROID.on_grid(x[299:], x[:150], x[:100])[0]).all()


@pytest.mark.parametrize("name", [n for n in KINDS if not n.startswith(("function", "mapped"))])
def test_fields_survive_pickling(name: str) -> None:
    again = pickle.loads(pickle.dumps(KINDS[name]))
    assert (again(POINTS[:50]) == KINDS[name](POINTS[:50])).all()


def test_a_power_is_the_product_and_has_its_periods() -> None:
    points = RNG.uniform(-2, 2, (50, 3))
    np.testing.assert_allclose((GYROID**3)(points), (GYROID * GYROID * GYROID)(points), rtol=1e-13, atol=1e-15)
    np.testing.assert_allclose((GYROID**2).gradient(points), 2 * GYROID(points)[:, None] * GYROID.gradient(points))
    assert (GYROID**7)(points) == pytest.approx(GYROID(points) ** 7)
    assert (GYROID**2).periods() == GYROID.periods()


@pytest.mark.parametrize("exponent", [0.5, -1, 0, "2"])
def test_a_power_that_is_not_defined_everywhere_is_refused(exponent: object) -> None:
    with pytest.raises(InvalidRequest, match="whole powers from 1 on"):
        _ = GYROID**exponent
