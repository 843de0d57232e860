"""Many curves at once are what each is alone."""

from __future__ import annotations

import numpy as np

from tpmscad.splines.bspline import BSplineCurve
from tpmscad.splines.curve_batch import evaluate_curves


def curves() -> list[BSplineCurve]:
    """Unequal degrees, numbers of spans, domains and a double inner knot."""
    rng = np.random.default_rng(3)
    result = []
    for degree, spans in ((7, 4), (7, 11), (3, 1), (1, 1), (9, 1), (7, 4), (2, 5)):
        low, high = np.sort(rng.normal(size=2))
        inner = np.linspace(low, high, spans + 1)[1:-1]
        inner = np.sort(np.concatenate([inner, inner[:2]])) if degree == 2 else inner
        knots = np.concatenate([np.repeat(low, degree + 1), inner, np.repeat(high, degree + 1)])
        result.append(BSplineCurve(rng.normal(size=(len(knots) - degree - 1, 2)), knots, degree))
    return result


def test_points_and_derivatives_of_stacked_curves_are_those_of_each_curve() -> None:
    rng = np.random.default_rng(4)
    made = curves()
    index = rng.integers(0, len(made), 5000)  # more than are evaluated at once
    t = np.array([rng.uniform(*made[i].domain) for i in index])
    for i, end in ((0, 0), (1, 1)):
        t[100 * i : 100 * i + 100] = [made[k].domain[end] for k in index[100 * i : 100 * i + 100]]
    t[200:600] = [rng.choice(made[i].knots) for i in index[200:600]]
    for order, found in zip((0, 1, 2), evaluate_curves(made, index, t, (0, 1, 2)), strict=True):
        expected = np.array([made[i](x, order) for i, x in zip(index, t, strict=True)])
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-14 * np.abs(expected).max())


def test_no_points_are_no_points() -> None:
    assert evaluate_curves(curves(), np.zeros(0, np.int64), np.zeros(0))[0].shape[0] == 0
