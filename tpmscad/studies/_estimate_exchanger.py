"""`estimate_exchanger`: effectiveness, heat and pressure drops of a whole exchanger with two fluids, by correlations."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

from tpmscad._lazy_import import import_extra
from tpmscad.api.argument_kinds import choice_of
from tpmscad.api.public_calls import validate_call
from tpmscad.api.shared_kinds import ANYTHING, LENGTHS, POSITIVE
from tpmscad.errors import InvalidRequest
from tpmscad.results.domain_results import FluidDomains
from tpmscad.simulation.effectiveness import ARRANGEMENTS, GREATEST, LEAST
from tpmscad.studies._estimate_flow import estimate_channel
from tpmscad.studies.channel_geometry import METRES, ChannelGeometry, describe_channel, measure_channel
from tpmscad.studies.flow_results import SOLVE_FLOW, ExchangerEstimate

KELVIN = 273.15
"""Of 0 degrees Celsius."""

ATMOSPHERE = 101325.0
"""Pressure of a fluid by default, Pa."""

PROPERTIES = {"density": "D", "viscosity": "V", "conductivity": "L", "specific_heat": "C"}
"""The properties of a fluid, in SI units, and their names in CoolProp."""

FLOW_KEYS = ("plus", "minus", "arrangement", "wall_conductivity", "wall_density")
"""What is said of two fluids in a sweep."""

STREAM = ANYTHING.described_as(
    "properties of a fluid and its flow",
    '{"density": 998, "viscosity": 1e-3, "conductivity": 0.6, "specific_heat": 4180, "volume_flow": 1e-5}',
)
FLUID_TEXT = (
    "The fluid in channel {}: `density`, `viscosity`, `conductivity`, `specific_heat` in SI units, or its name as `fluid` with "
    "`temperature` and `pressure`, whence CoolProp computes them (``pip install 'tpmscad[fluids]'``); `volume_flow`, m3/s, or "
    "`mass_flow`, kg/s; and the `temperature` at which it enters, degrees Celsius, if heat is asked for."
)


@dataclass(frozen=True, slots=True)
class FluidStream:
    """A fluid, SI units, and its flow, m3/s; `temperature`, degrees Celsius, is that at the inlet."""

    density: float
    viscosity: float
    conductivity: float
    specific_heat: float
    volume_flow: float
    temperature: float | None = None

    @property
    def capacity_rate(self) -> float:
        """Heat that warms the stream by one kelvin, W/K."""
        return self.volume_flow * self.density * self.specific_heat


def read_stream(argument: str, given: Any) -> FluidStream:
    """The stream of a mapping; InvalidRequest names what is missing, unknown or not positive."""
    known = (*PROPERTIES, "fluid", "temperature", "pressure", "volume_flow", "mass_flow")
    if not isinstance(given, Mapping) or not set(given) <= set(known):
        wrong = given if not isinstance(given, Mapping) else next(name for name in given if name not in known)
        raise InvalidRequest(f"{argument}: {wrong!r} is unknown; give a mapping of some of {', '.join(known)}")
    values = {name: value for name, value in given.items() if value is not None}
    if "fluid" in values:
        values = _look_up(argument, values) | values
    missing = [name for name in PROPERTIES if name not in values]
    if missing:
        raise InvalidRequest(
            f"{argument}: {', '.join(missing)} is missing; give it, or the name of the `fluid` and its temperature"
        )
    if ("volume_flow" in values) == ("mass_flow" in values):
        raise InvalidRequest(f"{argument}: give exactly one of volume_flow, m3/s, and mass_flow, kg/s")
    numbers = {name: float(values[name]) for name in (*PROPERTIES, "volume_flow", "mass_flow") if name in values}
    if wrong_name := next((name for name, value in numbers.items() if not value > 0), None):
        raise InvalidRequest(f"{argument}: {wrong_name} {numbers[wrong_name]:g} must be positive")
    flow = numbers.pop("mass_flow", 0.0) / numbers["density"] or numbers.pop("volume_flow")
    temperature = values.get("temperature")
    return FluidStream(**numbers, volume_flow=flow, temperature=None if temperature is None else float(temperature))


def check_flow(flow: Mapping[str, Any]) -> None:
    """InvalidRequest unless two streams, how they pass each other, and the material of the wall can be read."""
    if unknown := next((name for name in flow if name not in FLOW_KEYS), None):
        raise InvalidRequest(f"flow: {unknown!r} is unknown; the keys are {', '.join(FLOW_KEYS)}")
    for side in FLOW_KEYS[:2]:
        read_stream(f"flow: {side}", flow.get(side))
    if flow.get("arrangement", "counter") not in ARRANGEMENTS:
        raise InvalidRequest(f"flow: arrangement {flow['arrangement']!r} is none of {', '.join(ARRANGEMENTS)}")
    for name in FLOW_KEYS[3:]:
        value = flow.get(name)
        if value is not None and not (isinstance(value, int | float) and value > 0):
            raise InvalidRequest(f"flow: {name} {value!r} must be a positive number")


def _look_up(argument: str, values: Mapping[str, Any]) -> dict[str, float]:
    """The properties of a fluid by its name, at its temperature and pressure."""
    if "temperature" not in values:
        raise InvalidRequest(f"{argument}: give the temperature of {values['fluid']}, degrees Celsius")
    props = import_extra("CoolProp.CoolProp", "fluids by name", "fluids", "CoolProp").PropsSI
    state = ("T", values["temperature"] + KELVIN, "P", values.get("pressure", ATMOSPHERE), values["fluid"])
    try:
        return {name: float(props(symbol, *state)) for name, symbol in PROPERTIES.items()}
    except ValueError as error:
        raise InvalidRequest(
            f"{argument}: CoolProp has no properties of {values['fluid']!r} at {values['temperature']:g} degrees Celsius and "
            f"{state[3]:g} Pa: {error}"
        ) from error


@validate_call(
    'estimate_exchanger("gyroid", core=(60, 30, 30), cell=8, thickness=0.8, arrangement="cross", plus=hot, minus=cold)'
)
def estimate_exchanger(
    channel: Annotated[
        str | FluidDomains,
        ANYTHING.described_as("the name of a surface, or fluid domains", '"gyroid"'),
        "The name of a surface, with `core`, `cell` and `thickness` to define the exchanger; or the result of "
        "`tpmscad.fluid_domains`.",
    ],
    *,
    plus: Annotated[Mapping[str, Any], STREAM, FLUID_TEXT.format("+")],
    minus: Annotated[Mapping[str, Any], STREAM, FLUID_TEXT.format("-")],
    arrangement: Annotated[
        str, choice_of(*ARRANGEMENTS), "How the streams pass each other: against, across, or along each other."
    ] = "counter",
    core: Annotated[
        tuple[float, float, float] | None,
        LENGTHS.described_as(example="(60, 30, 30)"),
        "Edges of the core, mm; with a name. Channel + flows along the first, channel - too, or along the second in cross flow.",
    ] = None,
    cell: Annotated[
        float | None, POSITIVE.described_as(example="8.0"), "Edge length of the cubic cell, mm; with a name."
    ] = None,
    thickness: Annotated[float | None, POSITIVE, "Thickness of the wall, mm; with a name."] = None,
    wall_conductivity: Annotated[
        float | None,
        POSITIVE.described_as("a positive number, W/(m K)", "15.0"),
        "Thermal conductivity of the wall, W/(m K); without it the wall resists nothing.",
    ] = None,
) -> ExchangerEstimate:
    """Estimate what an exchanger transfers between two fluids: conductance, transfer units, effectiveness, heat, pressure drops.

    Where sources disagree, figures are ranges, from the least to the greatest of those within their ranges.

    Returns
    -------
    ExchangerEstimate
        The figures, and the estimates of both channels with their rows and sources.

    Raises
    ------
    InvalidRequest
        If no correlation of heat transfer covers one of the flows, or if arguments are missing or exclude each other.

    Notes
    -----
    1 / UA = 1 / (h A) of both sides + thickness / (conductivity A) of the wall; the effectiveness follows from UA and the
    capacity rates (Kays and London 1984), in cross flow between that of mixed and that of unmixed fluids. The lattice has the
    area and the porosity of the endless sheet; ends of channels, inlets and manifolds are left out, and fluids have constant
    properties.

    Examples
    --------
    >>> water = {"density": 998, "viscosity": 1e-3, "conductivity": 0.6, "specific_heat": 4180}
    >>> hot, cold = water | {"volume_flow": 4e-5, "temperature": 60}, water | {"volume_flow": 4e-5, "temperature": 20}
    >>> size = {"core": (60, 30, 30), "cell": 8, "thickness": 0.8}
    >>> found = tpmscad.estimate_exchanger("gyroid", plus=hot, minus=cold, **size)
    >>> [round(value, 2) for value in found.effectiveness]
    [0.28, 0.29]
    """
    if isinstance(channel, FluidDomains):
        if given := [name for name, value in (("core", core), ("cell", cell), ("thickness", thickness)) if value]:
            raise InvalidRequest(f"fluid domains have their own {', '.join(given)}: leave out what is given twice")
        sides = tuple(measure_channel(channel, side) for side in "+-")
        wall = None if channel.offset is None else channel.offset[1] - channel.offset[0]
        volume = channel.volume
    elif isinstance(channel, str):
        if core is None or cell is None or thickness is None:
            raise InvalidRequest(
                f"an exchanger of {channel} needs its core, `cell` and `thickness`: for instance (60, 30, 30), 8 and 0.8"
            )
        volume, wall = core[0] * core[1] * core[2], thickness
        lengths = core[0], core[1 if arrangement == "cross" else 0]
        sides = tuple(
            describe_channel(channel, cell, (-wall / 2, wall / 2), side, length, volume / length)
            for side, length in zip("+-", lengths, strict=True)
        )
    else:
        raise InvalidRequest(
            f"channel: a {type(channel).__name__} is neither the name of a surface nor a result of tpmscad.fluid_domains"
        )
    streams = read_stream("plus", plus), read_stream("minus", minus)
    return estimate_sides(sides, streams, arrangement, volume, wall, wall_conductivity)


def estimate_sides(
    sides: tuple[ChannelGeometry, ...],
    streams: tuple[FluidStream, FluidStream],
    arrangement: str,
    volume: float,
    wall: float | None,
    wall_conductivity: float | None,
) -> ExchangerEstimate:
    """The estimate of two channels (+, -) of a body of a volume, mm3, between which there is a wall of a thickness, mm."""
    flows, areas, coefficients = [], [], []
    for side, stream in zip(sides, streams, strict=True):
        assert side.volume is not None
        velocity = stream.volume_flow * side.length / side.volume / METRES**2
        found = estimate_channel(
            side,
            stream.density,
            stream.viscosity,
            stream.conductivity,
            stream.specific_heat,
            velocity,
            stream.volume_flow,
        )
        heats = [row.heat_transfer_coefficient for row in found.heat_transfers if row.heat_transfer_coefficient]
        if not heats:
            reasons = "; ".join(row.reason for row in found.heat_transfers) or "there is none of this surface"
            raise InvalidRequest(
                f"no correlation of heat transfer covers {found.name} at Reynolds number {found.reynolds:.4g} ({reasons}): "
                f"change the flow, or {SOLVE_FLOW}"
            )
        flows.append(found)
        areas.append(4.0 * side.volume / side.hydraulic_diameter)
        coefficients.append((min(heats), max(heats)))
    mid_area = 0.5 * sum(areas)
    resistance = 0.0
    if wall_conductivity is not None and wall is not None:
        resistance = wall * METRES / (wall_conductivity * mid_area * METRES**2)
    conductances = [
        1.0 / (resistance + sum(1.0 / (h[end] * area * METRES**2) for h, area in zip(coefficients, areas, strict=True)))
        for end in (0, 1)
    ]
    rates = streams[0].capacity_rate, streams[1].capacity_rate
    ratio, ntu = min(rates) / max(rates), [conductance / min(rates) for conductance in conductances]
    effectiveness = LEAST[arrangement](ntu[0], ratio), GREATEST[arrangement](ntu[1], ratio)
    heat = None
    if streams[0].temperature is not None and streams[1].temperature is not None:
        most = min(rates) * abs(streams[0].temperature - streams[1].temperature)
        heat = effectiveness[0] * most, effectiveness[1] * most
    return ExchangerEstimate(
        sides[0].surface,
        arrangement,
        flows[0],
        flows[1],
        mid_area,
        mid_area / volume / METRES,
        (conductances[0], conductances[1]),
        (ntu[0], ntu[1]),
        effectiveness,
        heat,
    )
