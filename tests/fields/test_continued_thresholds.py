"""Graded thresholds beyond the spans of their fractions: the same within, continued beyond, and asked in a body only."""

from __future__ import annotations

import numpy as np
import pytest

from tpmscad import fields
from tpmscad.errors import OutsideSpan
from tpmscad.fields.kinds.volume_fraction_thresholds import continue_thresholds


def test_a_continued_threshold_is_the_same_within_its_span_and_straight_beyond() -> None:
    phi = fields.tpms("gyroid", 4)
    threshold = fields.graded_threshold(phi, fields.expression("0.3 + 0.02*x"), span=(0.2, 0.5))
    rod = fields.rod(phi, threshold)
    continued = continue_thresholds(rod)
    inside = np.random.default_rng(1).uniform((-4.9, -5, -5), (9.9, 5, 5), (500, 3))
    np.testing.assert_array_equal(continued(inside), rod(inside))
    with pytest.raises(OutsideSpan):
        rod([[12.0, 0.0, 0.0]])
    line = np.array([[x, 1.0, 2.0] for x in (10.0, 14.0, 18.0, 22.0)])
    steps = np.diff(continue_thresholds(threshold)(line))
    np.testing.assert_allclose(steps, steps[0], rtol=1e-9)
    assert continue_thresholds(phi) is phi
