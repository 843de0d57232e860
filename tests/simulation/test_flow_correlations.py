"""Published correlations: against the tables they were fitted to, against each other, and against exact limits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tpmscad import surfaces
from tpmscad.simulation.flow_correlations import (
    GAJETTI_DIAMOND,
    GAJETTI_GYROID,
    HEAT_TRANSFER,
    PRESSURE_DROP,
    SAVOLDI_GYROID,
    SJTU_DIAMOND,
    SJTU_GYROID,
    YAN_GYROID,
    ChannelFlow,
    FlowCorrelation,
    ForchheimerFit,
    FrictionFit,
    darcy_law,
)

ALL = (*PRESSURE_DROP, *HEAT_TRANSFER)
WATER = {"density": 998.0, "viscosity": 1.0e-3, "prandtl": 7.0}


def label(of: FlowCorrelation) -> str:
    return f"{of.name} {'-'.join(of.surfaces)}"


def channel(reynolds: float, porosity: float = 0.4, surface: str = "gyroid", **fluid: float) -> ChannelFlow:
    """A flow of a Reynolds number through one side of a surface of cell 8 mm."""
    offset = surfaces.skeletal_offset_for(surface, "minimal", porosity, "+")
    area = surfaces.cell_measures(surface, "minimal").swept_area(offset)
    flow = ChannelFlow(8e-3, 8e-3 * 4.0 * porosity / area, porosity, 1.0, **(WATER | fluid))
    return replace(flow, velocity=reynolds / flow.reynolds)


def heat(name: str, surface: str = "gyroid") -> FlowCorrelation:
    (found,) = (of for of in HEAT_TRANSFER if of.name == name and of.surfaces == (surface,))
    return found


TABLE_2 = [
    (GAJETTI_GYROID, 0.3, 5.6e-4, 0.81),
    (GAJETTI_GYROID, 0.4, 1.2e-3, 0.53),
    (GAJETTI_GYROID, 0.5, 2.2e-3, 0.31),
    (GAJETTI_GYROID, 0.6, 3.9e-3, 0.20),
    (GAJETTI_DIAMOND, 0.3, 3.5e-4, 0.52),
    (GAJETTI_DIAMOND, 0.4, 7.6e-4, 0.30),
    (GAJETTI_DIAMOND, 0.5, 1.4e-3, 0.20),
    (GAJETTI_DIAMOND, 0.6, 2.4e-3, 0.19),
]


@pytest.mark.parametrize(("fit", "porosity", "permeability", "inertia"), TABLE_2)
def test_a_fit_is_near_the_values_it_was_fitted_to(
    fit: ForchheimerFit, porosity: float, permeability: float, inertia: float
) -> None:
    """Table 2 of Gajetti et al. (2025), two digits: porosity, permeability in cells squared, inertial coefficient."""
    assert fit.a * porosity**fit.n == pytest.approx(permeability, rel=0.07)
    assert fit.b * porosity**fit.m == pytest.approx(inertia, rel=0.17)


@pytest.mark.parametrize(
    ("fit", "published", "ours"), [(GAJETTI_GYROID, 2.2889e-3, 2.252e-3), (GAJETTI_DIAMOND, 1.4397e-3, 1.405e-3)]
)
def test_a_permeability_is_that_of_others(fit: ForchheimerFit, published: float, ours: float) -> None:
    """At porosity 1/2, cells squared: Jung and Torquato (2005), and finite elements of this package (docs/measurements.md)."""
    assert fit.a * 0.5**fit.n == pytest.approx(published, rel=0.01)
    assert fit.a * 0.5**fit.n == pytest.approx(ours, rel=0.02)


@pytest.mark.parametrize("porosity", [0.3, 0.4, 0.5, 0.6, 0.7])
def test_the_hydraulic_diameter_is_the_source_s(porosity: float) -> None:
    """Savoldi et al. (2026), equation 34: the fit of the wetted area of the level set, against that of the minimal surface."""
    theirs = 4.0 * porosity / (-5.723 * porosity**2 + 5.729 * porosity + 1.665)
    assert channel(50.0, porosity).hydraulic_diameter / 8e-3 == pytest.approx(theirs, rel=0.02)


@pytest.mark.parametrize("porosity", [0.3, 0.45, 0.6])
@pytest.mark.parametrize("reynolds", [20.0, 50.0, 100.0])
def test_two_pressure_drops_of_the_gyroid_agree(porosity: float, reynolds: float) -> None:
    flow = channel(reynolds, porosity)
    assert SAVOLDI_GYROID.pressure_gradient(flow) == pytest.approx(GAJETTI_GYROID.pressure_gradient(flow), rel=0.05)


@pytest.mark.parametrize("reynolds", [150.0, 250.0, 440.0])
@pytest.mark.parametrize("prandtl", [3.5, 9.0])
def test_the_computed_and_the_measured_heat_transfer_of_water_agree(reynolds: float, prandtl: float) -> None:
    flow = channel(reynolds, prandtl=prandtl)
    assert heat("Yan et al. 2023").evaluate(flow) == pytest.approx(heat("Yan et al. 2024").evaluate(flow), rel=0.07)


def test_the_heat_transfer_of_two_groups_meets_between_their_ranges() -> None:
    """At Re = 100, where one has Pr = 1 and the other water; its power of Pr carries it there."""
    flow = channel(100.0, prandtl=1.0)
    assert heat("Savoldi et al. 2026").evaluate(flow) == pytest.approx(heat("Yan et al. 2023").evaluate(flow), rel=0.08)


SJTU = [
    (SJTU_GYROID, "gyroid", 4.0, 0.3, 2.2827e-8, 325.39),
    (SJTU_GYROID, "gyroid", 4.0, 0.6, 1.2761e-8, 361.00),
    (SJTU_GYROID, "gyroid", 6.0, 0.4, 4.5572e-8, 192.20),
    (SJTU_GYROID, "gyroid", 7.0, 0.6, 5.1244e-8, 167.34),
    (SJTU_GYROID, "gyroid", 8.0, 0.3, 9.5790e-8, 126.45),
    (SJTU_DIAMOND, "diamond", 4.0, 0.6, 8.3416e-9, 523.07),
    (SJTU_DIAMOND, "diamond", 5.0, 0.5, 1.7209e-8, 346.11),
    (SJTU_DIAMOND, "diamond", 6.0, 0.3, 3.0512e-8, 182.77),
    (SJTU_DIAMOND, "diamond", 7.0, 0.6, 3.4168e-8, 188.03),
    (SJTU_DIAMOND, "diamond", 8.0, 0.4, 4.8295e-8, 112.92),
]
"""Rows of the source's table: cell and wall in mm, K in m2 and c in 1/m of viscosity u / K + density c u^2 with the mean
velocity u in the channel."""


@pytest.mark.parametrize(("fit", "surface", "cell", "wall", "permeability", "inertia"), SJTU)
@pytest.mark.parametrize("reynolds", [94.0, 1000.0, 50600.0])
def test_a_friction_factor_is_near_the_table_it_was_fitted_to(
    fit: FrictionFit, surface: str, cell: float, wall: float, permeability: float, inertia: float, reynolds: float
) -> None:
    porosity = surfaces.skeletal_volume_fraction(surface, "minimal", 0.5 * wall / cell, "+")
    diameter = 4e-3 * cell * porosity / surfaces.cell_measures(surface, "minimal").swept_area(0.5 * wall / cell)
    flow = ChannelFlow(1e-3 * cell, diameter, porosity, 1.0, 998.0, 998.0 * diameter / reynolds, 7.0)
    assert flow.reynolds == pytest.approx(reynolds)
    table = flow.viscosity / permeability + 998.0 * inertia
    assert fit.pressure_gradient(flow) == pytest.approx(table, rel=0.15 if surface == "gyroid" else 0.33)


@pytest.mark.parametrize("reynolds", [150.0, 500.0, 3000.0])
def test_three_sources_agree_on_the_heat_transfer_of_water(reynolds: float) -> None:
    """Measurements of one group and computations of another, in the gyroid."""
    flow = channel(reynolds * (1 - 1e-9), prandtl=6.0)
    assert heat("SJTU-TPMSHX 2026").evaluate(flow) == pytest.approx(heat("Yan et al. 2024").evaluate(flow), rel=0.1)
    diamond = channel(min(reynolds, 380.0), surface="diamond", prandtl=6.0)
    computed = heat("SJTU-TPMSHX 2026", "diamond").evaluate(diamond)
    assert computed == pytest.approx(heat("Yan et al. 2023", "diamond").evaluate(diamond), rel=0.2)


@pytest.mark.parametrize("surface", ["gyroid", "diamond"])
@pytest.mark.parametrize("reynolds", [3000.0, 12000.0])
def test_gases_and_water_transfer_alike(surface: str, reynolds: float) -> None:
    """Air measured, carbon dioxide and water computed, of the same Reynolds number: Nusselt numbers over Pr^(1/3)."""
    fluids = (("", 6.0), ("(air) ", 0.72), ("(carbon dioxide) ", 0.9))
    of_prandtl = [
        heat(f"SJTU-TPMSHX {fluid}2026", surface).evaluate(channel(reynolds, surface=surface, prandtl=prandtl))
        / prandtl ** (1.0 / 3.0)
        for fluid, prandtl in fluids
    ]
    assert max(of_prandtl) < 1.4 * min(of_prandtl)


@pytest.mark.parametrize("reynolds", [150.0, 1000.0, 3000.0])
def test_a_printed_exchanger_loses_more_than_smooth_walls_do(reynolds: float) -> None:
    """Why 2.577 Re^-0.095 is the factor of Fanning: a quarter of it is less than what is computed for smooth walls."""
    flow = channel(reynolds)
    smooth, printed = SJTU_GYROID.friction(flow), YAN_GYROID.friction(flow)
    assert printed / 4 < smooth < printed


def test_values_are_those_calculated_by_hand() -> None:
    flow = ChannelFlow(0.01, 0.005, 0.5, 0.2, 1000.0, 1e-3, 8.0)
    assert flow.reynolds == pytest.approx(1000.0)
    assert flow.superficial_velocity == pytest.approx(0.1)
    assert flow.friction_factor(8000.0) == pytest.approx(2.0)
    # K = 0.04 / 4 x 1e-4 = 1e-6 m2, C = 0.2 x 2 = 0.4: 1e-3 x 0.1 / 1e-6 + 1000 x 0.4 x 0.01 / 1e-3
    assert ForchheimerFit(0.04, 2.0, 0.2, -1.0).pressure_gradient(flow) == pytest.approx(100.0 + 4000.0)
    # 0.471 x 10^1.881 x 2
    assert heat("Yan et al. 2024").evaluate(flow) == pytest.approx(71.62, rel=1e-4)
    # 0.606 x 10^1.767 x 2^0.99 and 0.683 x 10^1.68 x 2^0.99
    assert heat("Yan et al. 2023").evaluate(flow) == pytest.approx(70.38, rel=1e-3)
    assert heat("Yan et al. 2023", "diamond").evaluate(flow) == pytest.approx(64.93, rel=1e-3)
    # K = 0.0157 / 2^2.72 x 1e-4 = 2.3827e-7 m2, C = 0.0784 x 2^2.04 = 0.32242: 419.7 + 6605 Pa/m, f = 1.7562
    assert flow.friction_factor(SAVOLDI_GYROID.pressure_gradient(flow)) == pytest.approx(1.7562, rel=1e-3)
    # St = 0.0267 x 2^-0.19 x 1.7562 = 0.041104, x 8000
    assert heat("Savoldi et al. 2026").evaluate(flow) == pytest.approx(328.8, rel=1e-3)
    assert darcy_law(1e-6).evaluate(flow) == pytest.approx(100.0)
    # 552 x 2^-0.247 / 1000 + 1.16 = 0.4651 + 1.16; 807 x 2^-0.714 / 1000 + 0.486 x 2^0.703 = 0.4920 + 0.7911; 10.308 x 10^-0.285
    assert SJTU_GYROID.friction(flow) == pytest.approx(1.6251, rel=1e-3)
    assert SJTU_DIAMOND.friction(flow) == pytest.approx(1.2831, rel=1e-3)
    assert flow.friction_factor(YAN_GYROID.pressure_gradient(flow)) == pytest.approx(5.3477, rel=1e-3)
    # 0.3941 x 10^1.9305 x 2 and 0.3201 x 10^2.0037 x 2
    assert heat("SJTU-TPMSHX 2026").evaluate(flow) == pytest.approx(67.17, rel=1e-3)
    assert heat("SJTU-TPMSHX 2026", "diamond").evaluate(flow) == pytest.approx(64.56, rel=1e-3)
    # 0.126 x 10^2.3694 x 2 / 2^0.2409 and 0.184809 x 10^2.122263 x 2 x 2^0.281792
    assert heat("SJTU-TPMSHX (air) 2026").evaluate(flow) == pytest.approx(49.93, rel=1e-3)
    assert heat("SJTU-TPMSHX (carbon dioxide) 2026", "diamond").evaluate(flow) == pytest.approx(59.55, rel=1e-3)


@pytest.mark.parametrize(("fit", "surface"), [(GAJETTI_GYROID, "gyroid"), (GAJETTI_DIAMOND, "diamond")])
@pytest.mark.parametrize("porosity", [0.32, 0.45, 0.6])
def test_inertia_adds_at_most_2_percent_where_darcy_s_law_is_used(
    fit: ForchheimerFit, surface: str, porosity: float
) -> None:
    flow = channel(1.0, porosity, surface)
    slow = darcy_law(fit.permeability(flow))
    assert slow.find_excess(flow) == ()
    assert 1.0 < fit.pressure_gradient(flow) / slow.evaluate(flow) < 1.02


@pytest.mark.parametrize("of", ALL, ids=label)
def test_a_correlation_applies_up_to_its_limits_and_says_what_is_beyond(of: FlowCorrelation) -> None:
    low, high = of.reynolds
    prandtl = 1.0 if of.prandtl is None else sum(of.prandtl) / 2
    for inside in (low * (1 + 1e-9), high * (1 - 1e-9)):
        assert of.find_excess(channel(inside, surface=of.surfaces[0], prandtl=prandtl)) == ()
    for outside in (low * 0.99, high * 1.01):
        (said,) = of.find_excess(channel(outside, surface=of.surfaces[0], prandtl=prandtl))
        assert said == f"Reynolds number {outside:.4g} is outside {low:g} to {high:g}"
    if of.porosity is not None:
        flow = replace(channel(high / 2, surface=of.surfaces[0], prandtl=prandtl), porosity=of.porosity[1] + 0.01)
        assert [said.split(" 0.")[0] for said in of.find_excess(flow)] == ["porosity of the channel"]
    if of.prandtl is not None:
        assert any("Prandtl number 150 " in said for said in of.find_excess(channel(high / 2, prandtl=150.0)))


def test_every_correlation_names_its_source_and_no_two_are_the_same() -> None:
    assert len({(label(of), of.formula) for of in ALL}) == len(ALL)
    for of in ALL:
        assert of.doi.startswith("10.") or of.journal.startswith("github.com/")
        assert 2020 <= of.year <= 2026
        assert of.formula
        assert of.basis
        assert of.scatter
        assert set(of.surfaces) <= {"gyroid", "diamond"}


@given(
    scale=st.floats(0.01, 100.0),
    viscosity=st.floats(1e-5, 1.0),
    density=st.floats(0.1, 2000.0),
    fraction=st.floats(0.0, 1.0),
)
@pytest.mark.parametrize("of", ALL, ids=label)
def test_flows_of_one_reynolds_number_are_similar(
    of: FlowCorrelation, scale: float, viscosity: float, density: float, fraction: float
) -> None:
    """Friction factor and Nusselt number depend on Reynolds number, Prandtl number and porosity alone."""
    reynolds = of.reynolds[0] * (of.reynolds[1] / of.reynolds[0]) ** fraction
    one = channel(reynolds, surface=of.surfaces[0])
    other = replace(
        one,
        cell=one.cell * scale,
        hydraulic_diameter=one.hydraulic_diameter * scale,
        density=density,
        viscosity=viscosity,
    )
    other = replace(other, velocity=one.velocity * one.reynolds / other.reynolds)
    values = [
        flow.friction_factor(of.evaluate(flow)) if of in PRESSURE_DROP else of.evaluate(flow) for flow in (one, other)
    ]
    assert values[1] == pytest.approx(values[0], rel=1e-9)


@pytest.mark.parametrize("of", ALL, ids=label)
def test_pressure_gradient_and_heat_transfer_grow_with_the_velocity(of: FlowCorrelation) -> None:
    speeds = np.geomspace(*of.reynolds, 20)
    values = np.array([of.evaluate(channel(reynolds, surface=of.surfaces[0])) for reynolds in speeds])
    slopes = np.diff(np.log(values)) / np.diff(np.log(speeds))
    span = (1.0, 2.0) if of in PRESSURE_DROP else (0.0, 1.0)
    assert ((slopes > span[0]) & (slopes < span[1])).all()


def test_heat_transfer_without_a_prandtl_number_is_refused() -> None:
    with pytest.raises(ValueError, match="Prandtl"):
        heat("Yan et al. 2024").evaluate(replace(channel(200.0), prandtl=None))
