"""`estimate_flow`: pressure drop and heat transfer in a channel, estimated by published correlations."""

from __future__ import annotations

from typing import Annotated

from tpmscad.api.argument_kinds import choice_of
from tpmscad.api.public_calls import validate_call
from tpmscad.api.shared_kinds import ANYTHING, POSITIVE
from tpmscad.errors import InvalidRequest
from tpmscad.results.domain_results import FluidDomains
from tpmscad.simulation.flow_correlations import (
    HEAT_TRANSFER,
    PRESSURE_DROP,
    ChannelFlow,
    FlowCorrelation,
    darcy_law,
)
from tpmscad.studies.channel_geometry import METRES, ChannelGeometry, describe_channel, measure_channel
from tpmscad.studies.flow_results import SOLVE_FLOW, FlowEstimate, FlowEstimateRow


@validate_call(
    'estimate_flow("gyroid", cell=8, thickness=0.8, length=48, velocity=0.02, density=998, viscosity=1e-3, '
    "conductivity=0.6, specific_heat=4180)"
)
def estimate_flow(
    channel: Annotated[
        str | FluidDomains,
        ANYTHING.described_as("the name of a surface, or fluid domains", '"gyroid"'),
        "The name of a surface, of which `cell` and `thickness` say the sheet; or the result of "
        "`tpmscad.fluid_domains`, whose channel is measured.",
    ],
    *,
    density: Annotated[
        float, POSITIVE.described_as("a positive number, kg/m3", "998.0"), "Density of the fluid, kg/m3."
    ],
    viscosity: Annotated[
        float, POSITIVE.described_as("a positive number, Pa s", "0.001"), "Dynamic viscosity of the fluid, Pa s."
    ],
    length: Annotated[
        float | None,
        POSITIVE.described_as(example="40.0"),
        "Flow length, mm; that of fluid domains is by default the distance of the channel's two openings.",
    ] = None,
    cell: Annotated[
        float | None, POSITIVE.described_as(example="8.0"), "Edge length of the cubic cell, mm; with a name."
    ] = None,
    thickness: Annotated[float | None, POSITIVE, "Thickness of the wall, mm; with a name."] = None,
    side: Annotated[
        str, choice_of("-", "+"), "Which of the two channels, by the sign of the surface's nodal value in it."
    ] = "-",
    velocity: Annotated[
        float | None,
        POSITIVE.described_as(example="0.01"),
        "Mean velocity in the channel, m/s: volume flow over porosity times cross-section. Give it or `volume_flow`.",
    ] = None,
    volume_flow: Annotated[
        float | None, POSITIVE.described_as("a positive number, m3/s", "1e-5"), "Volume flow through the channel, m3/s."
    ] = None,
    cross_section: Annotated[
        float | None,
        POSITIVE.described_as("a positive number, mm2", "1024.0"),
        "Cross-section of wall and both channels, mm2; with a name, where `volume_flow` needs it and pumping power "
        "follows from it. That of fluid domains follows from their channel's volume and `length`.",
    ] = None,
    conductivity: Annotated[
        float | None,
        POSITIVE.described_as("a positive number, W/(m K)", "0.6"),
        "Thermal conductivity of the fluid, W/(m K); without it, heat transfer is not estimated.",
    ] = None,
    specific_heat: Annotated[
        float | None,
        POSITIVE.described_as("a positive number, J/(kg K)", "4180.0"),
        "Specific heat of the fluid, J/(kg K); together with `conductivity`.",
    ] = None,
    permeability: Annotated[
        float | None,
        POSITIVE.described_as("a positive number, mm2", "0.05"),
        "Permeability of the channel along the flow, mm2, of `tpmscad.permeability`: adds Darcy's law, which holds "
        "for Reynolds numbers up to 1.",
    ] = None,
) -> FlowEstimate:
    """Estimate pressure drop and heat transfer of the flow through one channel of a sheet, by published correlations.

    Geometry is in mm; the fluid, the flow and the results are in SI units.

    Returns
    -------
    FlowEstimate
        A row for each correlation of the surface, with its source, its scatter, and whether the flow is within its range; outside
        its range there is no value.

    Raises
    ------
    InvalidRequest
        If no correlation covers the surface or the flow, or if arguments are missing or exclude each other.

    Notes
    -----
    Estimates for the middle of an exchanger of smooth walls, not results: inlets, manifolds and the walls of the body are not in
    them, nor is the roughness of printed walls unless a correlation says so, which raises the pressure drop several times.
    Sources: Gajetti et al. (2025) for the pressure drop in gyroid and Diamond, Savoldi et al. (2026) for both in the gyroid,
    SJTU-TPMSHX (2026) for both in both up to a Reynolds number of 50,600, Yan et al. (2023, 2024) for heat transfer, and for the
    pressure drop in a printed gyroid; the rows name them in full. Reynolds numbers are those of the hydraulic diameter and of
    `velocity`.

    Examples
    --------
    >>> water = {"density": 998, "viscosity": 1e-3, "conductivity": 0.6, "specific_heat": 4180}
    >>> found = tpmscad.estimate_flow("gyroid", cell=8, thickness=0.8, length=48, velocity=0.02, **water)
    >>> round(found.reynolds)
    75
    >>> [row.correlation.name for row in found.pressure_drops if row.within_range]
    ['Gajetti et al. 2025', 'Savoldi et al. 2026']
    """
    if (conductivity is None) != (specific_heat is None):
        raise InvalidRequest(
            "the Prandtl number needs `conductivity` and `specific_heat`: give both, or leave both out"
        )
    if isinstance(channel, FluidDomains):
        given = {"cell": cell, "thickness": thickness, "cross_section": cross_section}
        excess = [f"`{name}`" for name, value in given.items() if value is not None]
        if excess:
            raise InvalidRequest(f"fluid domains have their own {', '.join(excess)}: leave out what is given twice")
        geometry = measure_channel(channel, side, length)
    elif isinstance(channel, str):
        if cell is None or thickness is None or length is None:
            raise InvalidRequest(
                f"the flow in {channel} needs `cell`, `thickness` and the length of the channel: for instance 8, 0.8 and 48"
            )
        geometry = describe_channel(channel, cell, (-thickness / 2, thickness / 2), side, length, cross_section)
    else:
        raise InvalidRequest(
            f"channel: a {type(channel).__name__} is neither the name of a surface nor a result of tpmscad.fluid_domains"
        )
    velocity, volume_flow = _resolve_velocity(velocity, volume_flow, geometry)
    found = estimate_channel(
        geometry, density, viscosity, conductivity, specific_heat, velocity, volume_flow, permeability
    )
    _require_a_value(found)
    return found


def estimate_channel(
    geometry: ChannelGeometry,
    density: float,
    viscosity: float,
    conductivity: float | None,
    specific_heat: float | None,
    velocity: float,
    volume_flow: float | None,
    permeability: float | None = None,
) -> FlowEstimate:
    """The estimate of a flow through a channel, whose rows may all be outside of their ranges."""
    prandtl = None
    if conductivity is not None and specific_heat is not None:
        prandtl = viscosity * specific_heat / conductivity
    flow = ChannelFlow(
        geometry.cell * METRES,
        geometry.hydraulic_diameter * METRES,
        geometry.porosity,
        velocity,
        density,
        viscosity,
        prandtl,
    )
    laws = [of for of in PRESSURE_DROP if geometry.surface in of.surfaces]
    if permeability is not None:
        laws.append(darcy_law(permeability * METRES**2))
    drops = tuple(_estimate_pressure_drop(of, flow, geometry.length * METRES, volume_flow) for of in laws)
    heats: tuple[FlowEstimateRow, ...] = ()
    if conductivity is not None:
        heats = tuple(
            _estimate_heat_transfer(of, flow, conductivity) for of in HEAT_TRANSFER if geometry.surface in of.surfaces
        )
    return FlowEstimate(
        geometry.name,
        geometry.hydraulic_diameter,
        geometry.length,
        geometry.porosity,
        velocity,
        volume_flow,
        flow.reynolds,
        prandtl,
        drops,
        heats,
        geometry.is_core,
    )


def _resolve_velocity(
    velocity: float | None, volume_flow: float | None, geometry: ChannelGeometry
) -> tuple[float, float | None]:
    """Mean velocity in the channel, m/s, and its volume flow, m3/s, from the one that is given."""
    section = geometry.cross_section
    area = None if section is None else geometry.porosity * section * METRES**2
    if velocity is not None and volume_flow is None:
        return velocity, None if area is None else velocity * area
    if volume_flow is not None and velocity is None:
        if area is None:
            raise InvalidRequest(
                "`volume_flow` needs `cross_section`, that of wall and both channels in mm2; or give `velocity`"
            )
        return volume_flow / area, volume_flow
    here = "none of them" if velocity is None else "both"
    raise InvalidRequest(f"give exactly one of `velocity`, `volume_flow`; here: {here}")


def _estimate_pressure_drop(
    of: FlowCorrelation, flow: ChannelFlow, length: float, volume_flow: float | None
) -> FlowEstimateRow:
    """The row of a correlation of the pressure gradient; `length` in m."""
    if outside := of.find_excess(flow):
        return FlowEstimateRow(of, outside)
    gradient = of.evaluate(flow)
    drop = gradient * length
    return FlowEstimateRow(
        of,
        pressure_drop=drop,
        friction_factor=flow.friction_factor(gradient),
        pumping_power=None if volume_flow is None else drop * volume_flow,
    )


def _estimate_heat_transfer(of: FlowCorrelation, flow: ChannelFlow, conductivity: float) -> FlowEstimateRow:
    """The row of a correlation of the Nusselt number."""
    if outside := of.find_excess(flow):
        return FlowEstimateRow(of, outside)
    nusselt = of.evaluate(flow)
    return FlowEstimateRow(
        of, nusselt=nusselt, heat_transfer_coefficient=nusselt * conductivity / flow.hydraulic_diameter
    )


def _require_a_value(found: FlowEstimate) -> None:
    """InvalidRequest if no correlation applies; the message names each with its limit, and the remedy."""
    drops, heats, surface = found.pressure_drops, found.heat_transfers, found.name.partition(" ")[0]
    if any(row.within_range for row in (*drops, *heats)):
        return
    if not drops and not heats:
        known = " and ".join(sorted({name for of in PRESSURE_DROP for name in of.surfaces}))
        raise InvalidRequest(
            f"there is no correlation of the {surface}, only of {known}: give `permeability`, of tpmscad.permeability, for "
            f"Darcy's law at Reynolds numbers up to 1, or {SOLVE_FLOW}"
        )
    reasons = "; ".join(
        f"{quantity}, {row.correlation.name}: {' and '.join(row.outside)}"
        for quantity, rows in (("pressure drop", drops), ("heat transfer", heats))
        for row in rows
    )
    raise InvalidRequest(f"no correlation of the {surface} covers this flow ({reasons}): {found.remedy or SOLVE_FLOW}")
