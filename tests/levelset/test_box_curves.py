"""Laws of the fitted curves in faces of the box: overshoot and crossings are measured."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from tests.shapes.ball_level_sets import TOL, ball_fit
from tpmscad.levelset.fit.box_curves import (
    find_crossing_curves,
    mark_crossing_polylines,
    measure_overshoot,
    sample_box_curves,
)
from tpmscad.levelset.level_set_fit import classify_failures


def test_box_curves_of_a_fit_that_passes_stay_in_the_box_and_cross_nothing() -> None:
    made = ball_fit()
    assert (made.network.plane >= 0).sum() > 4
    assert measure_overshoot(made.network, sample_box_curves(made.network, made.fit), made.tree).max() <= 0
    assert not find_crossing_curves(made.network, sample_box_curves(made.network, made.fit)).any()


@pytest.mark.parametrize("reach", [0.9, 1.1])
def test_two_curves_that_cross_are_found_and_their_patches_are_folded(reach: float) -> None:
    made = ball_fit()
    net, fit = made.network, made.fit
    on_box = np.flatnonzero(net.plane >= 0)
    middle = np.array([0.5 * (fit.curves[c][0] + fit.curves[c][-1]) for c in on_box])
    one = 0
    other = int(np.linalg.norm(middle - middle[one], axis=1).argmax())
    curves = list(fit.curves)
    bent = curves[on_box[one]].copy()
    weight = 0.5 ** (len(bent) - 1) * 2  # what the first and last pole leave to those between, at the middle
    bent[1:-1] = middle[one] + reach * (middle[other] - middle[one]) / (1 - weight)
    curves[on_box[one]] = bent
    spoilt = replace(fit, curves=curves)
    found = find_crossing_curves(net, sample_box_curves(net, spoilt))
    assert found[on_box[[one, other]]].all() == (reach > 1)
    folded = classify_failures(replace(made, fit=spoilt), made.tree, TOL).folded
    assert folded[(net.curve == on_box[other]).any(axis=1)].all() == (reach > 1)


def test_crossing_curves_are_those_whose_polylines_cross_in_some_pair() -> None:
    rng = np.random.default_rng(9)
    count = 60
    start = rng.uniform(0.0, 1.0, (count, 2))
    points = np.cumsum(np.concatenate([start[:, None], rng.normal(0, 0.012, (count, 32, 2))], axis=1), axis=1)
    ends = np.stack([np.arange(count), np.arange(count) + count], axis=1)
    ends[1, 0] = ends[0, 1]  # two that share an end
    points[1] += points[0, -1] - points[1, 0]
    found = mark_crossing_polylines(points, ends)
    expected = np.zeros(count, bool)
    for i, j in combinations(range(count), 2):
        if set(ends[i]) & set(ends[j]):
            continue
        a, b, c, d = points[i][:-1, None], points[i][1:, None], points[j][None, :-1], points[j][None, 1:]
        one, other = b - a, d - c
        side = [cross(one, c - a) * cross(one, d - a) < 0, cross(other, a - c) * cross(other, b - c) < 0]
        expected[[i, j]] |= (side[0] & side[1]).any()
    assert 5 < expected.sum() < count - 5
    assert np.array_equal(found, expected)


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
