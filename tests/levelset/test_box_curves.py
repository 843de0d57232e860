"""Laws of the fitted curves in faces of the box: overshoot and crossings are measured."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.shapes.ball_level_sets import TOL, ball_fit
from tpmscad.levelset.fit.box_curves import find_crossing_curves, measure_overshoot, sample_box_curves
from tpmscad.levelset.level_set_fit import LevelSetFit, classify_failures


def fit_of_ball() -> LevelSetFit:
    return ball_fit()[0]


def test_box_curves_of_a_fit_that_passes_stay_in_the_box_and_cross_nothing() -> None:
    made = fit_of_ball()
    assert (made.network.plane >= 0).sum() > 4
    assert measure_overshoot(made.network, sample_box_curves(made.network, made.fit), made.tree).max() <= 0
    assert not find_crossing_curves(made.network, sample_box_curves(made.network, made.fit)).any()


@pytest.mark.parametrize("reach", [0.9, 1.1])
def test_two_curves_that_cross_are_found_and_their_patches_are_folded(reach: float) -> None:
    made = fit_of_ball()
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
    folded = classify_failures(net, spoilt, made.quality, made.tree, TOL).folded
    assert folded[(net.curve == on_box[other]).any(axis=1)].all() == (reach > 1)
