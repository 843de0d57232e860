"""Fields from functions of a user."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

from tpmscad import fields
from tpmscad.errors import InvalidRequest

POINTS = np.random.default_rng(2).uniform(0.5, 5, (300, 3))
X, Y, Z = POINTS.T


class Wavy:
    """A callable with a gradient, as other rooms make them."""

    def __call__(self, points: np.ndarray) -> np.ndarray:
        return np.sin(points[..., 0]) + points[..., 1] * points[..., 2]

    def gradient(self, points: np.ndarray) -> np.ndarray:
        return np.stack([np.cos(points[..., 0]), points[..., 2], points[..., 1]], axis=-1)


@pytest.mark.parametrize(
    "f",
    [
        lambda p: np.sin(p[:, 0]) + p[:, 1] * p[:, 2],
        lambda p: np.sin(p[..., 0]) + p[..., 1] * p[..., 2],
        lambda points, c=1.0: np.sin(points[:, 0]) + c * points[:, 1] * points[:, 2],
        lambda x, y, z: np.sin(x) + y * z,
        lambda x, y, z, c=1.0: np.sin(x) + c * y * z,
        lambda *p: np.sin(p[0]) + p[1] * p[2],
        lambda *p: np.sin(p[0][:, 0]) + p[0][:, 1] * p[0][:, 2],
        lambda x=0.0, y=0.0, z=0.0: np.sin(x) + y * z,
        np.vectorize(lambda x, y, z: math.sin(x) + y * z),
        Wavy(),
    ],
)
def test_functions_of_points_and_of_coordinates_are_told_apart(f: object) -> None:
    field = fields.from_function(f)
    np.testing.assert_array_equal(field(POINTS), np.sin(X) + Y * Z)
    exact = np.stack([np.cos(X), Z, Y], axis=-1)
    np.testing.assert_allclose(field.gradient(POINTS), exact, rtol=0, atol=1e-11)


@pytest.mark.parametrize(
    ("f", "gradient"),
    [
        (lambda p: p[:, 0] ** 2 * p[:, 1], lambda p: np.stack([2 * p[:, 0] * p[:, 1], p[:, 0] ** 2, 0 * p[:, 2]], -1)),
        (lambda x, y, z: x**2 * y, lambda x, y, z: (2 * x * y, x**2, 0.0)),
        (lambda x, y, z: x**2 * y, lambda x, y, z: np.array([2 * x * y, x**2, 0 * z])),
    ],
)
def test_gradients_given_are_used(f: object, gradient: object) -> None:
    field = fields.from_function(f, gradient)
    np.testing.assert_array_equal(field.gradient(POINTS), np.stack([2 * X * Y, X**2, 0 * Z], axis=-1))


def norm(p: np.ndarray) -> np.ndarray:
    return np.linalg.norm(p, axis=1)


NOISE = np.random.default_rng(8).normal(size=10_000)


@pytest.mark.parametrize(
    ("f", "gradient"),
    [
        (norm, lambda p: p / norm(p)[:, None]),
        (norm, lambda p: 1.1 * p / norm(p)[:, None]),
        (lambda p: np.abs(p).max(axis=1), lambda p: (np.abs(p) == np.abs(p).max(axis=1)[:, None]) * np.sign(p)),
        (lambda p: norm(p) + 1e-3 * NOISE[(1e6 * p[:, 0]).astype(int) % 10_000], lambda p: p / norm(p)[:, None]),
        (lambda p: np.floor(4 * p[:, 0]), lambda p: np.tile([4.0, 0, 0], (len(p), 1))),
        (lambda p: 0 * p[:, 0], lambda p: 0 * p),
    ],
    ids=["exact", "nearly", "kinked", "noisy", "stepped", "flat"],
)
def test_gradients_that_may_be_right_are_used(f: Any, gradient: Any) -> None:
    field, points = fields.from_function(f, gradient=gradient), np.random.default_rng(1).normal(size=(1000, 3))
    for _ in range(4):
        np.testing.assert_array_equal(field.gradient(points), gradient(points))


@pytest.mark.parametrize(
    ("gradient", "message"),
    [
        (lambda p: -p / norm(p)[:, None], "the gradient of the function norm is wrong at .* Turn its sign"),
        (lambda p: 2 * p, "Correct it"),
        (lambda p: p[:, ::-1] / norm(p)[:, None], "Correct it, or leave it out"),
        (lambda p: 0 * p, "it is \\(0, 0, 0\\), differences over 0.001 give"),
    ],
    ids=["reversed", "of the square", "of swapped axes", "zero"],
)
def test_gradients_of_something_else_are_refused_at_once(gradient: Any, message: str) -> None:
    field = fields.sheet(fields.from_function(norm, gradient=gradient), 0.5, 0.7)
    with pytest.raises(InvalidRequest, match=message):
        field.gradient(np.random.default_rng(1).normal(size=(1000, 3)))


def test_a_jacobian_of_another_map_is_refused() -> None:
    field = fields.warp(fields.tpms("gyroid"), lambda p: p**2, lambda p: -2 * p[:, None] * np.eye(3))
    with pytest.raises(InvalidRequest, match=r"the Jacobian of the map is wrong at 16 of 16 points: .* Turn its sign"):
        field.gradient(np.random.default_rng(1).normal(size=(1000, 3)))


@pytest.mark.parametrize("length", [10.0, 1.0])
def test_differences_are_as_accurate_as_stated(length: float) -> None:
    k = 2 * np.pi / length
    field = fields.from_function(lambda x, y, z: np.sin(k * x) + np.cos(k * y) * np.sin(k * z))
    exact = k * np.stack([np.cos(k * X), -np.sin(k * Y) * np.sin(k * Z), np.cos(k * Y) * np.cos(k * Z)], axis=-1)
    stated = 330 * 1e-12 / length**5 + 2e-16 / 1e-3
    assert np.abs(field.gradient(POINTS) - exact).max() < 10 * stated


def test_a_field_is_itself() -> None:
    gyroid = fields.tpms("gyroid")
    assert fields.from_function(gyroid) is gyroid
    assert fields.as_field(gyroid) is gyroid


def test_functions_go_wherever_fields_go() -> None:
    part = fields.rod(fields.tpms("gyroid", 3.0), lambda p: 0.1 * p[:, 0]) & (lambda x, y, z: x - 2 * y)
    expected = np.maximum(fields.tpms("gyroid", 3.0)(POINTS) - 0.1 * X, X - 2 * Y)
    np.testing.assert_allclose(part(POINTS), expected, atol=1e-15)


def test_an_object_that_knows_grids_is_asked_for_them() -> None:
    class Gridded(Wavy):
        asked = 0

        def on_grid(self, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
            self.asked += 1
            return np.sin(x)[:, None, None] + y[:, None] * z

    foreign, axes = Gridded(), (np.arange(4.0), np.arange(5.0), np.arange(6.0))
    values = fields.rod(foreign, 0.5).on_grid(*axes)
    assert foreign.asked == 1
    np.testing.assert_array_equal(values, Wavy()(np.stack(np.meshgrid(*axes, indexing="ij"), -1)) - 0.5)


def norm_of_all(p: np.ndarray) -> np.ndarray:
    return np.linalg.norm(p)


@pytest.mark.parametrize(
    ("f", "said"),
    [
        (lambda x, y, z: math.sin(x), "can't be called with arrays"),
        (norm_of_all, r"norm_of_all gave shape \(\) for 5 points"),
        (lambda p: p, r"gave shape \(5, 3\)"),
        (lambda p: p[:, 0] / np.abs(p).max(), "depends on the other points of the call"),
        (lambda a, b: a, "2 arguments"),
        (lambda: 1.0, "0 arguments"),
        (lambda p: "solid", "can't be called with arrays"),
        (3.0, "can't be called"),
    ],
)
def test_functions_that_cannot_be_fields_are_refused(f: object, said: str) -> None:
    with pytest.raises(InvalidRequest, match=said):
        fields.from_function(f)


def test_values_that_are_not_finite_are_refused_where_they_arise() -> None:
    field = fields.from_function(lambda p: np.where(p[:, 0] > 100, np.nan, p[:, 1]))
    assert np.isfinite(field(POINTS)).all()
    for call in (field, field.gradient, fields.rod(field, 1)):
        with pytest.raises(InvalidRequest, match=r"not finite at 1 of 2 points, first at \(101, 2, 3\)"):
            call([[1.0, 2, 3], [101, 2, 3]])
    with pytest.raises(InvalidRequest, match="not finite"):
        field.on_grid([0, 200], [1, 2], [3])


def test_functions_of_a_part_of_space_are_tried_there() -> None:
    axes = np.linspace(10, 20, 6), np.linspace(-9, -5, 5), np.linspace(0, 2, 4)
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), -1)
    f = RegularGridInterpolator(axes, grid @ [1.0, 2, 3])
    with pytest.raises(InvalidRequest, match="domain="):
        fields.from_function(f)
    field = fields.from_function(f, domain=((10, -9, 0), (20, -5, 2)))
    assert field([12.3, -6.1, 0.7]) == pytest.approx(12.3 - 12.2 + 2.1)


def test_gradients_of_the_wrong_shape_are_refused() -> None:
    field = fields.from_function(lambda p: p[:, 0], lambda p: p[:, 0])
    with pytest.raises(InvalidRequest, match=r"\(n, 3\)"):
        field.gradient(POINTS)
    with pytest.raises(InvalidRequest, match="step"):
        fields.from_function(lambda p: p[:, 0], step=0)
