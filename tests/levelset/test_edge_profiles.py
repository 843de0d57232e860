"""Laws of rounded extremes: smooth, unchanged beyond their width, and volume-neutral."""

from __future__ import annotations

import numpy as np
import pytest

from tpmscad import fields
from tpmscad.levelset.edge_rounding import ProfileMinMaxField, make_volume_neutral_profile

POINTS = np.random.default_rng(4).normal(size=(4000, 3)) * [0.5, 0.3, 0.2]
FIRST, SECOND = fields.coordinate("x") + 0.3 * fields.coordinate("z"), fields.coordinate("y") - 0.1
WIDTH = 0.3


def test_the_edge_moves_in_what_is_beside_it_out_and_the_area_of_a_cut_across_stays() -> None:
    d = np.linspace(0.0, 1.2, 120_001) * WIDTH
    points = np.stack([0.5 * d, np.zeros_like(d), -0.5 * d], axis=1)
    line = fields.coordinate("x"), fields.coordinate("z")
    added = ProfileMinMaxField(*line, 1, WIDTH, make_volume_neutral_profile())(points) - 0.5 * d
    assert added[0] == pytest.approx(make_volume_neutral_profile().height * WIDTH, rel=1e-9)
    assert added.min() == pytest.approx(-make_volume_neutral_profile().depth * WIDTH, rel=1e-6)
    assert np.trapezoid(added, d) == pytest.approx(0.0, abs=1e-6 * WIDTH * added[0])
    assert np.abs(added[d >= WIDTH]).max() == 0.0
    # a cubic that only cuts the edge off is bent by 1 / 6 of 1 / its height
    bend = np.diff(added, 2) / (d[1] - d[0]) ** 2
    assert bend.max() * added[0] < 0.6 / 6


@pytest.mark.parametrize("sign", [1, -1])
def test_the_rounding_is_twice_continuously_differentiable_and_its_gradient_exact(sign: int) -> None:
    field = ProfileMinMaxField(FIRST, SECOND, sign, WIDTH, make_volume_neutral_profile())
    h = 1e-6
    slope = np.stack([(field(POINTS + h * e) - field(POINTS - h * e)) / (2 * h) for e in np.eye(3)], axis=-1)
    value, gradient = field.value_and_gradient(POINTS)
    assert np.allclose(gradient, slope, atol=1e-8)
    assert np.array_equal(value, field(POINTS))
    # along a line across the edge second differences have no steps beyond what their slope makes
    t = np.linspace(-1.0, 1.0, 20_001)
    across = field(np.stack([t, -t, 0 * t], axis=1))
    bend = np.diff(across, 2) / (t[1] - t[0]) ** 2
    assert np.abs(np.diff(bend)).max() < 1e-2 * np.abs(bend).max()


def test_beyond_the_width_the_values_are_those_of_the_extreme_to_the_last_bit() -> None:
    sharp, field = (
        fields.intersection(FIRST, SECOND),
        ProfileMinMaxField(FIRST, SECOND, 1, WIDTH, make_volume_neutral_profile()),
    )
    far = np.abs(FIRST(POINTS) - SECOND(POINTS)) >= WIDTH
    assert 100 < np.count_nonzero(far) < 3900
    assert np.array_equal(field(POINTS)[far], sharp(POINTS)[far])
    assert np.array_equal(field.gradient(POINTS)[far], sharp.gradient(POINTS)[far])


def test_the_lesser_of_two_is_minus_the_greater_of_their_negatives() -> None:
    low = ProfileMinMaxField(FIRST, SECOND, -1, WIDTH, make_volume_neutral_profile())
    high = ProfileMinMaxField(-FIRST, -SECOND, 1, WIDTH, make_volume_neutral_profile())
    assert np.allclose(low(POINTS), -high(POINTS), rtol=0, atol=1e-15)
