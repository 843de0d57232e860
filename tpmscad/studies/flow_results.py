"""The result of `estimate_flow`: what each correlation says of a flow, with its source, as rows and as text."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

from tpmscad.result_display import fit_lines, format_html_table
from tpmscad.simulation.flow_correlations import FlowCorrelation

SOLVE_FLOW = "solve the flow: `tpmscad.fluid_domains(...)`, its `mesh(size, order=1)`, and `write_openfoam` of that"
"""The remedy where no correlation holds."""

ROUNDING = 0.005
"""Of a figure of three digits at most: what is named as a limit lies inside it."""


def _round(value: float | None) -> str:
    """Three digits, all that estimates are worth."""
    return "" if value is None else f"{float(f'{value:.3g}'):g}"


@dataclass(frozen=True, slots=True)
class FlowEstimateRow:
    """What one correlation says of a flow.

    Attributes
    ----------
    correlation : FlowCorrelation
        The correlation: `name`, `authors`, `journal`, `year`, `doi`, `formula`, `basis`, `scatter`, and its range.
    outside : tuple of str
        What of the flow is outside the range of the correlation, which then has no values.
    pressure_drop : float or None
        Pa over the flow length; None outside the range, and of correlations of heat transfer.
    friction_factor : float or None
        Darcy friction factor.
    pumping_power : float or None
        Pressure drop times volume flow, W, without the losses of a pump; None if the volume flow is not known.
    nusselt : float or None
        Nusselt number of the hydraulic diameter; None outside the range, and of correlations of the pressure drop.
    heat_transfer_coefficient : float or None
        W/(m2 K), of the wetted area.
    """

    correlation: FlowCorrelation
    outside: tuple[str, ...] = ()
    pressure_drop: float | None = None
    friction_factor: float | None = None
    pumping_power: float | None = None
    nusselt: float | None = None
    heat_transfer_coefficient: float | None = None

    @property
    def within_range(self) -> bool:
        """Whether the flow is inside the range of the correlation."""
        return not self.outside

    @property
    def reason(self) -> str:
        """The source, and why it has no value."""
        return f"{self.correlation.name} ({'; '.join(self.outside)})"

    def to_dict(self) -> dict[str, Any]:
        """The row as plain values, ready for JSON. The source, the range and the values by their names."""
        of = self.correlation
        source = {
            "source": f"{of.authors}, {of.journal} ({of.year})",
            "doi": of.doi or None,
            "formula": of.formula,
            "basis": of.basis,
            "scatter": of.scatter,
            "reynolds_range": of.reynolds,
            "porosity_range": of.porosity,
            "prandtl_range": of.prandtl,
            "within_range": self.within_range,
            "outside": list(self.outside),
        }
        return source | {
            f.name: getattr(self, f.name) for f in fields(self) if f.name not in ("correlation", "outside")
        }

    def __str__(self) -> str:
        of = self.correlation
        if self.outside:
            return f"no value: {self.reason}"
        if self.pressure_drop is not None:
            power = "" if self.pumping_power is None else f", pumping power {_round(self.pumping_power)} W"
            found = f"{_round(self.pressure_drop)} Pa, Darcy friction factor {_round(self.friction_factor)}{power}"
        else:
            found = f"{_round(self.heat_transfer_coefficient)} W/(m2 K), Nusselt number {_round(self.nusselt)}"
        unknown = "; porosities not known" if of.porosity is None and of.surfaces else ""
        return f"{of.name}: {found}; scatter: {of.scatter}{unknown}"


@dataclass(frozen=True, slots=True, repr=False)
class FlowEstimate:
    """Estimates of the flow through a channel, one row for each published correlation.

    Attributes
    ----------
    name : str
        Surface and channel.
    hydraulic_diameter, length : float
        4 x volume / wetted area of the channel, and the flow length, mm.
    porosity : float
        Volume of the channel over that of wall and both channels.
    velocity : float
        Mean velocity in the channel, m/s.
    volume_flow : float or None
        Through the channel, m3/s; None if no cross-section is known.
    reynolds : float
        Reynolds number of hydraulic diameter and velocity.
    prandtl : float or None
        Prandtl number; None if conductivity and specific heat were not given.
    pressure_drops, heat_transfers : tuple of FlowEstimateRow
        The rows, those outside of their ranges included.
    is_core : bool
        Whether porosity and hydraulic diameter are those of the endless sheet, not measured with closings and skins.
    """

    name: str
    hydraulic_diameter: float
    length: float
    porosity: float
    velocity: float
    volume_flow: float | None
    reynolds: float
    prandtl: float | None
    pressure_drops: tuple[FlowEstimateRow, ...]
    heat_transfers: tuple[FlowEstimateRow, ...]
    is_core: bool = True

    @property
    def remedy(self) -> str | None:
        """Up to which velocity there are pressure drops, and what to do beyond, if there is none of this flow."""
        published = [row for row in self.pressure_drops if row.correlation.surfaces]
        if not published or any(row.within_range for row in self.pressure_drops):
            return None
        outside = [row for row in published if len(row.outside) == 1 and "Reynolds" in row.outside[0]]
        fitting = [row.correlation.reynolds for row in outside]
        if not fitting and not self.is_core:
            return (
                "the porosity counts closings and skins, since the wall varies: give the surface by name, cell and thickness, "
                f"or {SOLVE_FLOW}"
            )
        if not fitting:
            return f"change `thickness`, on which the porosity depends, or {SOLVE_FLOW}"
        low, high = min(low for low, _ in fitting), max(high for _, high in fitting)
        limit, margin = (high, 1.0 - ROUNDING) if self.reynolds > high else (low, 1.0 + ROUNDING)
        share = margin * limit / self.reynolds
        flow = "" if self.volume_flow is None else f" or a volume flow of {share * self.volume_flow:.3g} m3/s"
        here = f"Reynolds number {limit:g}, here a velocity of {share * self.velocity:.3g} m/s{flow}"
        if self.reynolds > high:
            return f"there are values up to {here}; beyond, {SOLVE_FLOW}"
        return f"there are values from {here}; below, give `permeability`, of tpmscad.permeability, for Darcy's law up to 1"

    def to_dict(self) -> dict[str, Any]:
        """All figures as plain values, ready for JSON.

        The attributes by their names; rows as `FlowEstimateRow.to_dict` gives them.
        """
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        return {k: [row.to_dict() for row in v] if isinstance(v, tuple) else v for k, v in values.items()}

    def __repr__(self) -> str:
        prandtl = "" if self.prandtl is None else f", Prandtl number {self.prandtl:.4g}"
        flow = "" if self.volume_flow is None else f" ({self.volume_flow:.4g} m3/s)"
        lines = [
            f"{self.name}: porosity {self.porosity:.4f}, hydraulic diameter {self.hydraulic_diameter:.4g} mm, "
            f"length {self.length:.4g} mm",
            f"velocity {self.velocity:.4g} m/s{flow}, Reynolds number {self.reynolds:.4g}{prandtl}",
            *([self.remedy] if self.remedy else []),
        ]
        for title, rows in (
            ("pressure drop", self.pressure_drops),
            ("heat transfer coefficient", self.heat_transfers),
        ):
            inside = [row for row in rows if row.within_range]
            if rows:
                lines += [f"{title}, estimated by correlations:", *(f"  {row}" for row in inside)]
            if len(inside) < len(rows):
                lines.append("  no value: " + "; ".join(row.reason for row in rows if row.outside))
        return fit_lines(lines, ".heat_transfers")

    def _repr_html_(self) -> str:
        head = ("correlation", "pressure drop, Pa", "heat transfer, W/(m2 K)", "scatter", "outside of its range")
        rows = [
            (
                row.correlation.name,
                row.pressure_drop,
                row.heat_transfer_coefficient,
                row.correlation.scatter,
                "; ".join(row.outside),
            )
            for row in (*self.pressure_drops, *self.heat_transfers)
        ]
        return format_html_table(self.name, rows, head)


def _span(values: tuple[float, float]) -> str:
    """Two figures as one, or from the one to the other."""
    low, high = map(_round, values)
    return low if low == high else f"{low} to {high}"


@dataclass(frozen=True, slots=True, repr=False)
class ExchangerEstimate:
    """Estimated performance of an exchanger with two fluids; pairs are the least and the greatest that the sources say.

    Attributes
    ----------
    name, arrangement : str
        Surface, and "counter", "cross" or "parallel".
    plus, minus : FlowEstimate
        The flows through both channels.
    area : float
        Of the wall between the channels, the mean of both sides, mm2.
    compactness : float
        That area over the volume of the exchanger, m2/m3.
    conductance : (float, float)
        UA, W/K.
    ntu : (float, float)
        Numbers of transfer units: conductance over the smaller capacity rate.
    effectiveness : (float, float)
        Heat over that of an endless counter flow.
    heat : (float, float) or None
        W; None if a temperature at an inlet is not known.
    """

    name: str
    arrangement: str
    plus: FlowEstimate
    minus: FlowEstimate
    area: float
    compactness: float
    conductance: tuple[float, float]
    ntu: tuple[float, float]
    effectiveness: tuple[float, float]
    heat: tuple[float, float] | None

    @property
    def pressure_drops(self) -> dict[str, tuple[float, float] | None]:
        """Of "+" and "-", Pa: the least and the greatest that the sources say; None if none covers the flow."""
        found = {}
        for side, flow in (("+", self.plus), ("-", self.minus)):
            drops = [row.pressure_drop for row in flow.pressure_drops if row.pressure_drop is not None]
            found[side] = (min(drops), max(drops)) if drops else None
        return found

    def to_dict(self) -> dict[str, Any]:
        """All figures as plain values, ready for JSON: the attributes by their names, and the pressure drops."""
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        values |= {"plus": self.plus.to_dict(), "minus": self.minus.to_dict()}
        return values | {"pressure_drops": self.pressure_drops}

    def __repr__(self) -> str:
        heat = "" if self.heat is None else f", heat {_span(self.heat)} W"
        lines = [
            f"{self.name} exchanger, {self.arrangement} flow: area {self.area:.4g} mm2, {self.compactness:.4g} m2/m3",
            f"UA {_span(self.conductance)} W/K, NTU {_span(self.ntu)}, effectiveness {_span(self.effectiveness)}{heat}",
        ]
        for side, flow in (("+", self.plus), ("-", self.minus)):
            drops = self.pressure_drops[side]
            said = flow.remedy or "not known" if drops is None else f"{_span(drops)} Pa"
            heats = [row for row in flow.heat_transfers if row.within_range]
            names = ", ".join(
                dict.fromkeys(row.correlation.name for row in (*flow.pressure_drops, *heats) if row.within_range)
            )
            lines.append(
                f"channel {side}: Reynolds number {flow.reynolds:.4g}, pressure drop {said} (sources: {names or 'none'})"
            )
        return fit_lines(lines, ".to_dict()")

    def _repr_html_(self) -> str:
        drops = self.pressure_drops
        figures = {
            "UA, W/K": self.conductance,
            "NTU": self.ntu,
            "effectiveness": self.effectiveness,
            "heat, W": self.heat,
        }
        figures |= {f"pressure drop of channel {side}, Pa": drops[side] for side in drops}
        rows = [(name, "" if pair is None else _span(pair)) for name, pair in figures.items()]
        return format_html_table(f"{self.name} exchanger, {self.arrangement} flow", rows, ("figure", "value"))
