"""Pairs of near balls are those of a comparison of all with all, whatever their sizes, and are counted before they are made."""

from __future__ import annotations

import numpy as np
import pytest

from tpmscad.brep.near_balls import find_near_balls
from tpmscad.errors import OutOfMemory

RNG = np.random.default_rng(11)
CENTERS = RNG.uniform(0, 10, (300, 3))
RADII = np.append(10.0 ** RNG.uniform(-6, 0.3, 299), 0.0)


@pytest.mark.parametrize("reach", [0.0, 0.4])
def test_they_are_those_of_all_with_all(reach: float) -> None:
    apart = np.linalg.norm(CENTERS[:, None] - CENTERS, axis=2)
    near = apart <= RADII[:, None] + RADII + reach
    found = np.stack(find_near_balls(CENTERS, RADII, reach, "balls", ""), axis=1)
    assert sorted(found.tolist()) == np.argwhere(np.triu(near, 1)).tolist()
    some, rest = slice(0, 120), slice(120, None)
    between = find_near_balls(CENTERS[some], RADII[some], reach, "balls", "", (CENTERS[rest], RADII[rest]))
    assert sorted(np.stack(between, axis=1).tolist()) == np.argwhere(near[some, rest]).tolist()
    assert not len(find_near_balls(CENTERS[:0], RADII[:0], reach, "balls", "")[0])


def test_more_than_fit_are_refused_before_they_are_made(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tpmscad.memory_limit.physical_memory", lambda: 10_000)
    with pytest.raises(OutOfMemory, match=r"pairs of struts; use fewer"):
        find_near_balls(CENTERS, RADII, 0.4, "struts", "use fewer")
    assert len(find_near_balls(CENTERS, 1e-3 * RADII, 0.0, "struts", "use fewer")[0]) < 100
