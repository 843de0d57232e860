"""Published correlations of the pressure drop and the heat transfer in one channel of a triply periodic minimal surface.

Quantities are in SI units and refer to one of the two channels of a sheet, or to the one channel of a skeletal lattice:

- porosity phi: volume of the channel over that of the whole cell, wall and other channel included;
- hydraulic diameter D = 4 x volume of the channel / its wetted area;
- u: mean velocity in the channel, U = phi u: the superficial velocity, volume flow over the whole cross-section;
- Re = density u D / viscosity, Pr = viscosity x specific heat / conductivity;
- Darcy friction factor f = (pressure gradient) D / (density u^2 / 2), four times that of Fanning;
- Nu = h D / conductivity, with h from the mean heat flux of the wetted area and the difference of wall and bulk temperature.

The pressure gradient by the law of Darcy and Forchheimer is viscosity U / K + density C U^2 / sqrt(K), with the permeability K
and the inertial coefficient C.

Each correlation states its source, what it was fitted to, its range and its scatter; outside its range it has no value. Only
correlations whose coefficients, range and definitions agree in what could be read are here; docs/measurements.md says how each
was checked, and which were left out.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

Range = tuple[float, float]

PRANDTL_OF_WATER: Range = (1.7, 13.6)
"""Liquid water at 1 bar from 100 to 0 degrees Celsius: for correlations of water that state no Prandtl numbers."""

PRANDTL_OF_AIR: Range = (0.68, 0.76)
"""Air at 1 to 10 bar from -100 to 600 degrees Celsius."""

PRANDTL_ONE: Range = (0.95, 1.05)
"""What rounds to 1.0, for a correlation that was computed at Pr = 1: within it, Nu ~ Pr^(1/3) changes by 2 %."""

DARCY_REYNOLDS: Range = (0.0, 1.0)
"""Where inertia is left out: by the correlations below it adds at most 2 % at Re = 1."""


@dataclass(frozen=True, slots=True)
class ChannelFlow:
    """One channel and the flow through it, SI units; `prandtl` is None if the fluid's conductivity is not known."""

    cell: float
    hydraulic_diameter: float
    porosity: float
    velocity: float
    density: float
    viscosity: float
    prandtl: float | None = None

    @property
    def superficial_velocity(self) -> float:
        """Volume flow over the whole cross-section, m/s."""
        return self.porosity * self.velocity

    @property
    def reynolds(self) -> float:
        """Reynolds number of the hydraulic diameter and the mean velocity in the channel."""
        return self.density * self.velocity * self.hydraulic_diameter / self.viscosity

    def friction_factor(self, pressure_gradient: float) -> float:
        """Darcy friction factor of a pressure gradient in Pa/m."""
        return pressure_gradient * self.hydraulic_diameter / (0.5 * self.density * self.velocity**2)


@dataclass(frozen=True, slots=True)
class FlowCorrelation:
    """A correlation with its source.

    Attributes
    ----------
    surfaces : tuple of str
        The surfaces of the catalogue that it is of; none if it is of any.
    authors, journal, year, doi
        The source; `doi` is empty if there is none.
    formula : str
        The correlation, in the symbols of this module.
    basis : str
        What it was fitted to.
    scatter : str
        What is known of the differences between the correlation and its data.
    reynolds, porosity, prandtl : (float, float) or None
        The range; None if the source states none, or the quantity does not matter.
    evaluate : callable
        The pressure gradient in Pa/m, or the Nusselt number, of a `ChannelFlow`.
    """

    surfaces: tuple[str, ...]
    authors: str
    journal: str
    year: int
    doi: str
    formula: str
    basis: str
    scatter: str
    evaluate: Callable[[ChannelFlow], float]
    reynolds: Range
    porosity: Range | None = None
    prandtl: Range | None = None

    @property
    def name(self) -> str:
        """First author and year."""
        first, *others = self.authors.split(", ")
        return f"{first}{' et al.' if others else ''} {self.year}"

    def find_excess(self, flow: ChannelFlow) -> tuple[str, ...]:
        """What of a flow is outside the range, one text for each quantity; nothing if the correlation applies."""
        quantities = (
            ("Reynolds number", flow.reynolds, self.reynolds),
            ("porosity of the channel", flow.porosity, self.porosity),
            ("Prandtl number", flow.prandtl, self.prandtl),
        )
        return tuple(
            f"{quantity} {value:.4g} is outside {span[0]:g} to {span[1]:g}"
            for quantity, value, span in quantities
            if span is not None and value is not None and not span[0] <= value <= span[1]
        )


@dataclass(frozen=True, slots=True)
class ForchheimerFit:
    """K = a phi^n cells^2 and C = b phi^m."""

    a: float
    n: float
    b: float
    m: float

    def permeability(self, flow: ChannelFlow) -> float:
        """Permeability, m2."""
        return self.a * flow.porosity**self.n * flow.cell**2

    def pressure_gradient(self, flow: ChannelFlow) -> float:
        """Pressure gradient by the law of Darcy and Forchheimer, Pa/m."""
        permeability, speed = self.permeability(flow), flow.superficial_velocity
        inertia = self.b * flow.porosity**self.m / math.sqrt(permeability)
        return flow.viscosity * speed / permeability + flow.density * inertia * speed**2


@dataclass(frozen=True, slots=True)
class FrictionFit:
    """Darcy friction factor f = a phi^n / Re + b phi^m Re^p."""

    a: float
    n: float
    b: float
    m: float = 0.0
    p: float = 0.0

    def friction(self, flow: ChannelFlow) -> float:
        """Darcy friction factor."""
        inertia = self.b * flow.porosity**self.m * flow.reynolds**self.p
        return self.a * flow.porosity**self.n / flow.reynolds + inertia

    def pressure_gradient(self, flow: ChannelFlow) -> float:
        """Pressure gradient, Pa/m."""
        return self.friction(flow) * flow.density * flow.velocity**2 / (2.0 * flow.hydraulic_diameter)


def _power_law(
    factor: float, of_reynolds: float, of_prandtl: float, flow: ChannelFlow, of_diameter: float = 0.0
) -> float:
    """Nusselt number c Re^p Pr^q (D / cell)^d."""
    size = (flow.hydraulic_diameter / flow.cell) ** of_diameter
    return factor * flow.reynolds**of_reynolds * _known_prandtl(flow) ** of_prandtl * size


def _reynolds_analogy(factor: float, power: float, fit: ForchheimerFit, flow: ChannelFlow) -> float:
    """Nusselt number St Re Pr with the Stanton number c phi^p f."""
    friction = flow.friction_factor(fit.pressure_gradient(flow))
    return factor * flow.porosity**power * friction * flow.reynolds * _known_prandtl(flow)


def _known_prandtl(flow: ChannelFlow) -> float:
    """The Prandtl number, which heat transfer needs."""
    if flow.prandtl is None:
        raise ValueError("heat transfer needs the Prandtl number")
    return flow.prandtl


def darcy_law(permeability: float) -> FlowCorrelation:
    """Darcy's law with a permeability that was computed, m2."""
    return FlowCorrelation(
        surfaces=(),
        authors="Darcy",
        journal="Les fontaines publiques de la ville de Dijon, Paris",
        year=1856,
        doi="",
        formula="viscosity U / K with the permeability that was given",
        basis="exact for slow viscous flow",
        scatter="the error of the permeability",
        evaluate=lambda flow: flow.viscosity * flow.superficial_velocity / permeability,
        reynolds=DARCY_REYNOLDS,
    )


GAJETTI_GYROID = ForchheimerFit(0.0156, 2.78, 0.0908, -1.81)
GAJETTI_DIAMOND = ForchheimerFit(0.0106, 2.89, 0.0666, -1.69)
SAVOLDI_GYROID = ForchheimerFit(0.0157, 2.72, 0.0784, -2.04)
SJTU_GYROID = FrictionFit(552.0, 0.247, 1.16)
SJTU_DIAMOND = FrictionFit(807.0, 0.714, 0.486, -0.703)
YAN_GYROID = FrictionFit(0.0, 0.0, 4.0 * 2.577, 0.0, -0.095)


def _gajetti(surface: str, fit: ForchheimerFit) -> FlowCorrelation:
    return FlowCorrelation(
        surfaces=(surface,),
        authors="Gajetti, Boccardo, Savoldi, Marocco",
        journal="Int. J. Heat Mass Transf. 252, 127439",
        year=2025,
        doi="10.1016/j.ijheatmasstransfer.2025.127439",
        formula=f"Darcy-Forchheimer, K = {fit.a} phi^{fit.n} cells^2, C = {fit.b} phi^{fit.m}",
        basis="laminar flow of water computed in one periodic cell, skeletal",
        scatter="errors below 10 %",
        evaluate=fit.pressure_gradient,
        reynolds=(0.3, 100.0),
        porosity=(0.3, 0.6),
    )


_SAVOLDI = partial(
    FlowCorrelation,
    surfaces=("gyroid",),
    authors="Savoldi, Cammi, Gajetti, Marocco",
    journal="Int. J. Heat Fluid Flow 121, 110631",
    year=2026,
    doi="10.1016/j.ijheatfluidflow.2026.110631",
    reynolds=(20.0, 100.0),
    porosity=(0.3, 0.7),
)


def _yan_2023(surface: str, factor: float, power: float, highest: float) -> FlowCorrelation:
    return FlowCorrelation(
        surfaces=(surface,),
        authors="Yan, Wang, Li, Deng",
        journal="Appl. Therm. Eng. 230, 120748",
        year=2023,
        doi="10.1016/j.applthermaleng.2023.120748",
        formula=f"Nu = {factor} Re^{power} Pr^0.33",
        basis="laminar flow of water computed in the channels of a sheet",
        scatter="not stated in what was read",
        evaluate=partial(_power_law, factor, power, 0.33),
        reynolds=(40.0, highest),
        prandtl=PRANDTL_OF_WATER,
    )


_SJTU = partial(
    FlowCorrelation,
    authors="SJTU-TPMSHX",
    journal="github.com/alexlu997/SJTU-TPMSHX, df_cfd_coeffs_dev.csv and nu_correlations.py",
    year=2026,
    doi="",
    reynolds=(94.0, 50600.0),
)
_SJTU_PRESSURE = partial(
    _SJTU,
    basis="water computed in sheets of 20 cells of 4 to 8 mm with walls of 0.3 to 0.6 mm, laminar and turbulent, smooth",
)
_SJTU_HEAT = partial(
    _SJTU,
    basis="the same computations",
    scatter="rms 10 %",
    prandtl=PRANDTL_OF_WATER,
)


def _sjtu_gas(
    surface: str, factor: float, power: float, of_diameter: float, porosity: Range, **source: Any
) -> FlowCorrelation:
    return _SJTU(
        surfaces=(surface,),
        formula=f"Nu = {factor} Re^{power} Pr^(1/3) (D / cell)^{of_diameter}",
        evaluate=partial(_power_law, factor, power, 1.0 / 3.0, of_diameter=of_diameter),
        porosity=porosity,
        **source,
    )


_AIR: dict[str, Any] = {
    "authors": "SJTU-TPMSHX (air)",
    "basis": "air measured in printed specimens, the roughness of their walls, 31 um, divided out as a factor of 1.28",
    "scatter": "not stated in what was read",
    "reynolds": (400.0, 16000.0),
    "prandtl": PRANDTL_OF_AIR,
}
_CARBON_DIOXIDE: dict[str, Any] = {
    "authors": "SJTU-TPMSHX (carbon dioxide)",
    "basis": "supercritical carbon dioxide of 8 to 15 MPa computed in sheets of 20 cells of 4 to 8 mm, at Pr from 1.1; measured "
    "at Pr from 0.81 in printed exchangers",
    "reynolds": (2600.0, 128000.0),
    "prandtl": (0.81, 12.8),
}
_YAN_2024 = partial(
    FlowCorrelation,
    surfaces=("gyroid",),
    authors="Yan, Deng, Xiao, Wang, Luo",
    journal="Appl. Therm. Eng. 241, 122402",
    year=2024,
    doi="10.1016/j.applthermaleng.2024.122402",
    basis="110 measurements of water in a printed exchanger, the roughness of its walls included",
    scatter="not stated in what was read",
    reynolds=(150.0, 3000.0),
)

PRESSURE_DROP: tuple[FlowCorrelation, ...] = (
    _gajetti("gyroid", GAJETTI_GYROID),
    _gajetti("diamond", GAJETTI_DIAMOND),
    _SAVOLDI(
        formula="Darcy-Forchheimer, K = 0.0157 phi^2.72 cells^2, C = 0.0784 phi^-2.04",
        basis="laminar flow computed in one periodic cell, skeletal",
        scatter="mean 5.8 %, at most 18.5 %",
        evaluate=SAVOLDI_GYROID.pressure_gradient,
    ),
    _SJTU_PRESSURE(
        surfaces=("gyroid",),
        formula="f = 552 phi^0.247 / Re + 1.16",
        scatter="rms 6 %, at most 15 %; printed walls lost 2.4 to 9 times as much",
        evaluate=SJTU_GYROID.pressure_gradient,
        porosity=(0.275, 0.443),
    ),
    _SJTU_PRESSURE(
        surfaces=("diamond",),
        formula="f = 807 phi^0.714 / Re + 0.486 phi^-0.703",
        scatter="rms 14 %, at most 33 %; printed walls lost 2.3 to 8 times as much",
        evaluate=SJTU_DIAMOND.pressure_gradient,
        porosity=(0.226, 0.429),
    ),
    _YAN_2024(formula="f = 4 x 2.577 Re^-0.095", evaluate=YAN_GYROID.pressure_gradient),
)
"""Correlations of the pressure gradient."""

HEAT_TRANSFER: tuple[FlowCorrelation, ...] = (
    _SAVOLDI(
        formula="Nu = St Re Pr, St = 0.0267 phi^0.19 f",
        basis="laminar flow at Pr = 1 computed in one periodic cell, skeletal, with walls of uniform temperature or heat flux",
        scatter="standard deviation 11 %",
        evaluate=partial(_reynolds_analogy, 0.0267, 0.19, SAVOLDI_GYROID),
        prandtl=PRANDTL_ONE,
    ),
    _yan_2023("gyroid", 0.606, 0.589, 440.0),
    _yan_2023("diamond", 0.683, 0.56, 380.0),
    _YAN_2024(
        formula="Nu = 0.471 Re^0.627 Pr^(1/3)",
        evaluate=partial(_power_law, 0.471, 0.627, 1.0 / 3.0),
        prandtl=(3.5, 9.0),
    ),
    _SJTU_HEAT(
        surfaces=("gyroid",),
        formula="Nu = 0.3941 Re^0.6435 Pr^(1/3)",
        evaluate=partial(_power_law, 0.3941, 0.6435, 1.0 / 3.0),
        porosity=(0.275, 0.443),
    ),
    _SJTU_HEAT(
        surfaces=("diamond",),
        formula="Nu = 0.3201 Re^0.6679 Pr^(1/3)",
        evaluate=partial(_power_law, 0.3201, 0.6679, 1.0 / 3.0),
        porosity=(0.226, 0.429),
    ),
    _sjtu_gas("gyroid", 0.126, 0.7898, 0.2409, (0.275, 0.443), **_AIR),
    _sjtu_gas("diamond", 0.0944, 0.8273, 0.226, (0.226, 0.429), **_AIR),
    _sjtu_gas(
        *("gyroid", 0.192994, 0.722221, -0.044313, (0.275, 0.443)),
        scatter="rms 7 %, 19 % next to the critical point; printed walls took 1.03 to 1.12 times as much heat",
        **_CARBON_DIOXIDE,
    ),
    _sjtu_gas(
        *("diamond", 0.184809, 0.707421, -0.281792, (0.226, 0.429)),
        scatter="rms 9 %, 19 % next to the critical point; printed walls took 1.5 to 2.1 times as much heat",
        **_CARBON_DIOXIDE,
    ),
)
"""Correlations of the Nusselt number."""
