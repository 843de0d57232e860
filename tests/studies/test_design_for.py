"""Designs for a property: the search on laws that are known, and one lattice that is computed."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import tpmscad
from tpmscad.errors import InvalidRequest
from tpmscad.studies import _design_for

pytestmark = pytest.mark.kernel


@pytest.fixture
def power_law(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """E1 = 2 f^1.7 (1 + f) in place of the computation; the fractions that were asked for."""
    asked: list[float] = []

    def homogenize(surface: str, *, volume_fraction: float, **rest: Any) -> Any:
        asked.append(volume_fraction)
        value = 2.0 * volume_fraction**1.7 * (1.0 + volume_fraction)
        values = {"E1": value}
        return SimpleNamespace(to_dict=lambda: values, conductivity=value * np.eye(3), error=1e-3)

    monkeypatch.setattr(_design_for, "homogenize", homogenize)
    return asked


@pytest.mark.parametrize("fraction", [0.03, 0.2, 0.5])
@pytest.mark.parametrize("name", ["E1", "conductivity"])
def test_a_law_that_is_nearly_a_power_needs_a_few_values(power_law: list[float], name: str, fraction: float) -> None:
    target = 2.0 * fraction**1.7 * (1.0 + fraction)
    found = tpmscad.design_for("gyroid", name, target, cell=4.0)
    assert found.value == pytest.approx(target, rel=2e-3)
    assert found.volume_fraction == pytest.approx(fraction, rel=2e-3)
    assert found.thickness == pytest.approx(
        4.0 * tpmscad.surfaces.thickness_for("gyroid", "minimal", fraction), rel=3e-3
    )
    assert found.evaluations == len(power_law) <= 5
    assert found.error == 1e-3
    assert f"thickness {found.thickness:.5g}" in repr(found)
    assert found.to_dict()["evaluations"] == found.evaluations


def test_a_target_out_of_reach_is_refused_with_the_reach(power_law: list[float]) -> None:
    with pytest.raises(
        InvalidRequest, match=r"E1 5 is out of reach of gyroid with cell 1: .* gave .* to .*ask for one between"
    ):
        tpmscad.design_for("gyroid", "E1", 5.0)
    with pytest.raises(InvalidRequest, match=r"E1 1e-06 is out of reach"):
        tpmscad.design_for("gyroid", "E1", 1e-6)
    with pytest.raises(InvalidRequest, match="permeability of octet struts is not computed"):
        tpmscad.design_for("octet", "permeability", 0.1)


def test_struts_have_a_diameter(power_law: list[float]) -> None:
    found = tpmscad.design_for("octet", "E1", 2.0 * 0.2**1.7 * 1.2, cell=5.0)
    assert found.thickness is None
    assert found.diameter is not None
    made = tpmscad.struts("octet", cell=5.0, diameter=found.diameter, progress=False)
    assert made.volume / 125.0 == pytest.approx(0.2, rel=3e-3)
