"""Outside the blending region the blended field is the input field, bit for bit."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from benchmarks.baseline_weights import BASELINE_METHODS, blend_by_baseline
from tpmscad import fields
from tpmscad.blending import CylinderRadius, LinearCoordinate, LineWeightSpec, SphereRadius, VolumeWeightSpec, blend

K = 2 * np.pi * 4


def schwarz(points):
    return np.cos(K * points[..., 0]) + np.cos(K * points[..., 1]) + np.cos(K * points[..., 2]) + 0.6


def gyroid(points):
    x, y, z = (K * points[..., axis] for axis in range(3))
    return np.sin(x) * np.cos(y) + np.sin(y) * np.cos(z) + np.sin(z) * np.cos(x) + 0.5


def layer(coordinate, low, high):
    return lambda points: np.maximum(low - coordinate(points), coordinate(points) - high)


X, OBLIQUE, ROUND, BALL = (
    LinearCoordinate(),
    LinearCoordinate((2.0, 1.0, 0.5)),
    CylinderRadius((0.1, 0.0, 0.0)),
    SphereRadius((0.0, 0.0, 0.1)),
)
CASES = {
    "line along x": (X, 0.5, (0.3, 0.7), LineWeightSpec(X)),
    "line along x, paper's count": (X, 0.5, (0.3, 0.7), LineWeightSpec(X, count=30)),
    "line across a slanted layer": (OBLIQUE, 0.5, (0.35, 0.65), LineWeightSpec(OBLIQUE)),
    "cylinder": (ROUND, 0.35, (0.2, 0.5), LineWeightSpec(ROUND, degree=2)),
    "sphere": (BALL, 0.5, (0.4, 0.7), LineWeightSpec(BALL, count=60)),
    "volume": (BALL, 0.5, (0.4, 0.7), VolumeWeightSpec((14, 13, 12), (3, 2, 3))),
    "automatic": (X, 0.5, (0.3, 0.7), "auto"),
}
DOMAIN = ((0.0, 0.0, 0.0), (1.0, 0.4, 0.5))


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_outside_the_blending_region_the_blend_is_its_inputs_bit_for_bit(case):
    coordinate, middle, (low, high), weight = CASES[case]
    regions = [layer(coordinate, -9.0, middle), layer(coordinate, middle, 9.0)]
    blending = layer(coordinate, low, high)
    result = blend([schwarz, gyroid], regions, [blending], weight=weight, resolution=(36, 18, 22), domain=DOMAIN)

    points = np.random.default_rng(7).uniform(*DOMAIN, (100_000, 3))
    inside, values, w = blending(points) <= 0, result.field(points), result.weight(points)
    first, second = ~inside & (regions[0](points) <= 0), ~inside & (regions[0](points) > 0)
    assert first.sum() > 1000
    assert second.sum() > 1000
    assert inside.sum() > 1000
    assert np.array_equal(values[first], schwarz(points)[first])
    assert np.array_equal(values[second], gyroid(points)[second])
    assert np.all(w[first] == 0.0)
    assert np.all(w[second] == 1.0)
    assert w.min() >= 0.0
    assert w.max() <= 1.0
    assert np.any((w[inside] > 0.1) & (w[inside] < 0.9))


def test_a_structure_is_evaluated_only_where_the_blend_depends_on_it():
    """Of three structures in a row the first counts up to its own blending region, and where the third region is blended."""
    called = []

    def first(points):
        called.append(np.atleast_2d(points))
        return schwarz(points)

    bounds, bands = (-9.0, 0.35, 0.65, 9.0), [layer(X, 0.25, 0.45), layer(X, 0.55, 0.75)]
    regions = [layer(X, low, high) for low, high in zip(bounds[:-1], bounds[1:], strict=True)]
    found = blend([first, gyroid, schwarz], regions, bands, resolution=(44, 18, 22), domain=DOMAIN)
    points = np.random.default_rng(7).uniform(*DOMAIN, (5000, 3))
    called.clear()
    found.field.value_and_gradient(points)
    x, step = np.concatenate(called)[:, 0], 5e-3  # the gradient of a function takes differences
    for low, high in ((0.45, 0.65), (0.75, 1.0)):
        assert not ((x > low + step) & (x < high - step)).any()
    for low, high in ((0.0, 0.45), (0.65, 0.75)):
        assert ((x > low) & (x < high)).sum() > 1000


@pytest.mark.slow
@pytest.mark.parametrize("method", [*BASELINE_METHODS, "paper"])
def test_so_are_the_blends_of_the_other_methods_and_of_the_baselines(method):
    regions, blending = [layer(X, -9.0, 0.5), layer(X, 0.5, 9.0)], layer(X, 0.3, 0.7)
    run = partial(blend, method=method) if method == "paper" else partial(blend_by_baseline, method=method)
    result = run([schwarz, gyroid], regions, [blending], resolution=(36, 18, 22), domain=DOMAIN)
    points = np.random.default_rng(7).uniform(*DOMAIN, (100_000, 3))
    expected = np.where(points[:, 0] < 0.5, schwarz(points), gyroid(points))
    outside = blending(points) > 0
    assert np.array_equal(result.field(points)[outside], expected[outside])
    assert np.array_equal(result.weight(points)[outside], (points[:, 0] > 0.5)[outside].astype(float))


def test_so_is_a_blend_that_keeps_the_fraction_and_one_of_three_structures():
    bounds = (-9.0, 0.35, 0.65, 9.0)
    regions = [layer(X, low, high) for low, high in zip(bounds[:-1], bounds[1:], strict=True)]
    bands = [layer(X, 0.25, 0.45), layer(X, 0.55, 0.75)]

    def third(points):
        return schwarz(points) - 0.4

    fields = [schwarz, gyroid, third]
    result = blend(fields, regions, bands, resolution=(44, 18, 22), domain=DOMAIN, keep_fraction=True)
    points = np.random.default_rng(7).uniform(*DOMAIN, (100_000, 3))
    for field, region in zip(fields, regions, strict=True):
        own = (region(points) <= 0) & (bands[0](points) > 0) & (bands[1](points) > 0)
        assert own.sum() > 1000
        assert np.array_equal(result.field(points)[own], field(points)[own])


@pytest.mark.parametrize("kept", [False, True])
def test_beyond_the_box_that_was_blended_the_field_goes_on_without_a_jump(kept):
    box = fields.box((0, 0, 0), (1, 0.4, 0.5))
    regions, blending = [box & layer_of(-9.0, 0.5), box & layer_of(0.5, 9.0)], box & layer_of(0.3, 0.7)
    result = blend([schwarz, gyroid], regions, [blending], resolution=(36, 18, 22), keep_fraction=kept)
    points = np.random.default_rng(3).uniform((0.3, -0.05, -0.05), (0.7, 0.45, 0.55), (4000, 3))
    beyond = (points != np.clip(points, *DOMAIN)).any(axis=1)
    assert 0.2 < beyond.mean() < 0.8

    nearest = np.clip(points, *DOMAIN)
    assert np.array_equal(result.weight(points), result.weight(nearest))
    along = points[:, 0].argsort()
    steps = np.abs(np.diff(result.weight(np.array([0.0, -0.02, 0.55]) + points[along] * [1, 0, 0])))
    assert steps.max() < 0.02

    gradient = result.field.gradient(points)
    step = 1e-6
    for axis in np.eye(3):
        slope = (result.field(points + step * axis) - result.field(points - step * axis)) / (2 * step)
        assert np.allclose(gradient @ axis, slope, atol=1e-4 * np.abs(gradient).max())


def layer_of(low, high):
    return fields.box((low, -9, -9), (high, 9, 9))
