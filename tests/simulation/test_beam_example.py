"""The example of topology optimisation with two lattices: exact derivatives, and a design that beats those of one lattice."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytestmark = pytest.mark.slow

FOLDER = Path(__file__).parents[2] / "examples"


@pytest.fixture
def beam(monkeypatch: pytest.MonkeyPatch) -> Any:
    """The example as a module."""
    monkeypatch.syspath_prepend(str(FOLDER))
    pytest.importorskip("matplotlib").use("Agg")
    return importlib.import_module("beam_plate")


def test_the_derivatives_of_the_compliance_are_those_of_differences(beam: Any) -> None:
    splines, plate, rng = beam.fit_stiffness(beam.read_units()), beam.Plate(20.0, 10.0, 5.0), np.random.default_rng(1)
    density, share, way = rng.uniform(0.35, 0.65, (3, *plate.shape))
    _, by_density, by_share = beam.evaluate(plate, splines, density, share, 3.0)

    def compliance(density: np.ndarray, share: np.ndarray) -> float:
        return float(beam.evaluate(plate, splines, density, share, 3.0)[0])

    step = 1e-5 * way
    for slope, above, below in (
        (by_density, compliance(density + step, share), compliance(density - step, share)),
        (by_share, compliance(density, share + step), compliance(density, share - step)),
    ):
        assert (above - below) / 2e-5 == pytest.approx((slope * way).sum(), rel=1e-6)


def test_an_isotropic_plate_of_full_density_bends_as_a_timoshenko_beam(beam: Any) -> None:
    young, nu, length, height = 1.0, 0.3, 60.0, 10.0
    plate = beam.Plate(length, height, 2.5)
    constants = np.array([young / (1 - nu**2), nu * young / (1 - nu**2), young / (2 + 2 * nu)])
    compliance, _ = plate.solve(np.broadcast_to(constants, (*plate.shape, 3)))
    shear = young / (2 + 2 * nu)
    timoshenko = length**3 / (3 * young * height**3 / 12) + 1.2 * length / (shear * height)
    assert compliance == pytest.approx(timoshenko, rel=0.005)


def test_two_lattices_are_stiffer_than_either_alone(beam: Any, tmp_path: Path) -> None:
    found = beam.main(tmp_path / "beam.png", sizes=(5.0,), iterations=8)["designs"]
    best = found.pop("both, each place one of them")
    assert best < 0.95 * min(found.values())
    assert (tmp_path / "beam.png").stat().st_size > 10_000
