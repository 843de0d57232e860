"""Thresholds for a volume fraction that is a field: what a uniform structure of the local fraction has."""

from __future__ import annotations

import numpy as np
import pytest

from tpmscad import fields
from tpmscad.errors import InvalidRequest

GYROID = fields.tpms("gyroid", 1.0)
FRACTION = fields.ramp("x", (0.0, 5.0), (0.2, 0.5))
AT = np.array([[x, 0.3, 0.7] for x in (-1.0, 1.3, 3.6)])


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["rod", "pore", "sheet"])
def test_the_threshold_at_a_point_is_that_of_a_uniform_structure_of_the_fraction_there(kind: str) -> None:
    graded = fields.graded_threshold(GYROID, FRACTION, (0.2, 0.5), kind)
    pair = graded if isinstance(graded, tuple) else (graded,)
    for point in AT:
        wanted = fields.threshold_for(GYROID, float(FRACTION(point)), kind)
        found = [float(t(point)) for t in pair]
        assert found == pytest.approx(list(np.atleast_1d(wanted)), abs=2e-4)


@pytest.mark.slow
def test_slices_of_a_slowly_graded_rod_have_the_fractions_asked_for() -> None:
    fraction = fields.ramp("x", (0.0, 24.0), (0.2, 0.5))
    rod = fields.rod(GYROID, fields.graded_threshold(GYROID, fraction, (0.2, 0.5)))
    for start in (2, 11, 20):
        x = start + (np.arange(200) + 0.5) / 100
        wanted = fraction(np.column_stack([x, 0 * x, 0 * x])).mean()
        found = fields.volume_fraction(rod, ((start, 0, 0), (start + 2, 1, 1)), samples=48)
        assert found == pytest.approx(wanted, abs=2e-3)


@pytest.mark.slow
def test_the_gradient_is_that_of_the_values() -> None:
    graded, step = fields.graded_threshold(GYROID, FRACTION), 1e-5
    points = np.random.default_rng(0).uniform(0.2, 4.8, (20, 3))
    for axis, e in enumerate(step * np.eye(3)):
        assert graded.gradient(points)[:, axis] == pytest.approx(
            (graded(points + e) - graded(points - e)) / (2 * step), abs=1e-7
        )


@pytest.mark.slow
def test_the_span_of_a_ramp_is_that_of_its_values() -> None:
    falling = fields.ramp("x", (0.0, 5.0), (0.5, 0.2))
    given, found = fields.graded_threshold(GYROID, falling, (0.2, 0.5)), fields.graded_threshold(GYROID, falling)
    assert (found(AT) == given(AT)).all()  # type: ignore[operator]


@pytest.mark.slow
def test_fractions_beyond_the_span_are_refused_not_clipped() -> None:
    graded = fields.graded_threshold(GYROID, FRACTION, (0.25, 0.5))
    with pytest.raises(
        InvalidRequest, match=r"takes the value 0\.2 at \(.*\), outside the span .* fields\.clip\(fraction"
    ):
        graded(AT)
