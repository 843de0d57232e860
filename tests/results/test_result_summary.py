"""Summaries of results: coordinates without round-off."""

from __future__ import annotations

import pytest

from tpmscad.results.result_summary import round_corners

pytestmark = pytest.mark.kernel


def test_corners_are_told_without_round_off_and_zero_has_no_sign() -> None:
    box = ((-1.8e-15, -16.0, -0.0), (30.000000000000004, 1.8e-15, 20.0))
    assert str(round_corners(box)) == "((0.0, -16.0, 0.0), (30.0, 0.0, 20.0))"


def test_small_and_large_boxes_keep_nine_digits() -> None:
    for scale in (1e-6, 1.0, 1e6):
        box = ((0.0, 0.0, 0.123456 * scale), (scale, scale, scale))
        assert round_corners(box)[0][2] == box[0][2]
