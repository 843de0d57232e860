"""Estimates of a whole exchanger: the balance of its figures, the fluids, and the refusals."""

from __future__ import annotations

import json
import math
from typing import Any

import build123d as bd
import pytest

import tpmscad
from tpmscad.studies._estimate_exchanger import read_stream

pytestmark = pytest.mark.kernel

WATER = {"density": 998.0, "viscosity": 1.0e-3, "conductivity": 0.6, "specific_heat": 4180.0}
HOT = WATER | {"volume_flow": 4e-5, "temperature": 60.0}
COLD = WATER | {"volume_flow": 2e-5, "temperature": 20.0}
SIZE = {"core": (60.0, 40.0, 30.0), "cell": 8.0, "thickness": 0.8}


def estimate(surface: Any = "gyroid", **given: Any) -> Any:
    return tpmscad.estimate_exchanger(surface, **({"plus": HOT, "minus": COLD} | SIZE | given))


def test_the_figures_follow_from_those_of_the_channels() -> None:
    """In cross flow channel + is 60 mm long behind 40 x 30, channel - 40 mm behind 60 x 30."""
    found = estimate(arrangement="cross", wall_conductivity=15.0)
    assert (found.plus.length, found.minus.length) == (60.0, 40.0)
    assert found.plus.velocity == pytest.approx(4e-5 / (found.plus.porosity * 1200e-6))
    area = 4 * found.plus.porosity * 72000 / found.plus.hydraulic_diameter
    assert found.area == pytest.approx(area)
    assert found.compactness == pytest.approx(area / 72000 * 1e3)
    for end, pick in enumerate((min, max)):
        h = [
            pick(row.heat_transfer_coefficient for row in flow.heat_transfers if row.within_range)
            for flow in (found.plus, found.minus)
        ]
        resistance = 1 / h[0] + 1 / h[1] + 0.8e-3 / 15.0
        assert found.conductance[end] == pytest.approx(area * 1e-6 / resistance)
        assert found.ntu[end] == pytest.approx(found.conductance[end] / (998 * 2e-5 * 4180))
        assert found.heat[end] == pytest.approx(found.effectiveness[end] * 998 * 2e-5 * 4180 * 40)
    assert found.conductance[0] < found.conductance[1]
    least, greatest = found.pressure_drops["+"]
    drops = [row.pressure_drop for row in found.plus.pressure_drops if row.within_range]
    assert (least, greatest) == (min(drops), max(drops))
    assert json.loads(json.dumps(found.to_dict(), allow_nan=False))["plus"]["length"] == 60.0
    assert "gyroid exchanger, cross flow: area " in repr(found)


def test_the_arrangements_are_in_order_and_without_temperatures_there_is_no_heat() -> None:
    counter, parallel = (estimate(arrangement=of) for of in ("counter", "parallel"))
    assert counter.conductance == parallel.conductance
    assert counter.effectiveness[0] > parallel.effectiveness[0]
    assert estimate(plus=WATER | {"mass_flow": 998 * 4e-5}).heat is None
    assert estimate(plus=WATER | {"mass_flow": 998 * 4e-5}).plus.volume_flow == pytest.approx(4e-5)


def test_fluids_by_name_have_the_properties_of_tables() -> None:
    """Water at 20 degrees Celsius and 1 bar: 998.2 kg/m3, 1.0016e-3 Pa s, 0.598 W/(m K), 4184 J/(kg K)."""
    pytest.importorskip("CoolProp")
    water = read_stream("plus", {"fluid": "water", "temperature": 20.0, "volume_flow": 1e-5})
    assert water.density == pytest.approx(998.2, rel=1e-4)
    assert water.viscosity == pytest.approx(1.0016e-3, rel=1e-3)
    assert water.conductivity == pytest.approx(0.598, rel=2e-3)
    assert water.specific_heat == pytest.approx(4184.0, rel=1e-3)
    with pytest.raises(tpmscad.InvalidRequest, match="CoolProp has no properties of 'beer' at 20 degrees"):
        read_stream("plus", {"fluid": "beer", "temperature": 20.0, "volume_flow": 1e-5})


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"plus": {"densty": 1.0}}, "plus: 'densty' is unknown"),
        ({"minus": WATER}, "minus: give exactly one of volume_flow"),
        ({"minus": {"density": 1.0, "volume_flow": 1.0}}, "minus: viscosity, conductivity, specific_heat is missing"),
        ({"minus": COLD | {"density": -1.0}}, "density -1 must be positive"),
        ({"plus": {"fluid": "water", "volume_flow": 1e-5}}, "plus: give the temperature of water"),
        ({"core": None}, "needs its core, `cell` and `thickness`"),
        (
            {"plus": HOT | {"volume_flow": 1.0}},
            "no correlation of heat transfer covers gyroid channel . at Reynolds number",
        ),
        ({"surface": "P"}, "there is none of this surface"),
    ],
)
def test_a_refusal_names_the_value_and_the_remedy(given: dict[str, Any], said: str) -> None:
    given = dict(given)
    with pytest.raises(tpmscad.InvalidRequest, match=said):
        estimate(given.pop("surface", "gyroid"), **given)


@pytest.mark.slow
def test_domains_with_openings_flow_from_one_to_the_other() -> None:
    """Closings count in the volume of the channels, and so in the velocity; the porosity is that of the endless sheet."""
    openings = {"+": "<X,>X", "-": "<Y,>Y"}
    domains = tpmscad.fluid_domains(bd.Box(32, 24, 16), "gyroid", cell=8, thickness=0.8, tol=0.1, openings=openings)
    found = domains.estimate_exchanger(plus=HOT, minus=COLD, arrangement="cross")
    assert (found.plus.length, found.minus.length) == pytest.approx((32.0, 24.0))
    sheet = estimate(core=(32.0, 24.0, 16.0), arrangement="cross")
    assert found.plus.porosity == pytest.approx(sheet.plus.porosity)
    assert found.plus.hydraulic_diameter == pytest.approx(sheet.plus.hydraulic_diameter)
    assert found.plus.velocity == pytest.approx(4e-5 * 32e-3 / (domains.plus.volume * 1e-9))
    assert 0.7 * sheet.area < found.area < sheet.area
    flow = domains.estimate_flow(side="+", volume_flow=4e-5, density=998.0, viscosity=1e-3)
    assert flow.pressure_drops[2].pressure_drop == found.plus.pressure_drops[2].pressure_drop
    assert math.isclose(flow.length, 32.0)
