"""What the correlations of flow need to know of a channel: of the endless sheet in its core, and of its way through the body.

The porosity and the hydraulic diameter are those of the endless sheet, exactly, by Steiner's formula: what the correlations were
fitted to. Closings and skins count in the volume, and so in the velocity, not in the porosity.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from tpmscad import surfaces
from tpmscad.errors import InvalidRequest
from tpmscad.results.domain_results import MINUS, PLUS, FluidDomains

METRES = 1e-3
"""Metres in a model unit, mm."""


@dataclass(frozen=True, slots=True)
class ChannelGeometry:
    """A channel, lengths in mm; `cross_section` is that of wall and both channels, None if it is not known.

    `is_core`: whether porosity and hydraulic diameter are those of the endless sheet, not measured with closings and skins.
    """

    surface: str
    side: str
    cell: float
    porosity: float
    hydraulic_diameter: float
    cross_section: float | None
    length: float
    is_core: bool = True

    @property
    def volume(self) -> float | None:
        """Volume of the channel, mm3."""
        return None if self.cross_section is None else self.porosity * self.cross_section * self.length

    @property
    def name(self) -> str:
        """Surface and channel."""
        return f"{self.surface} channel {self.side}"


def describe_channel(
    surface: str, cell: float, offset: tuple[float, float], side: str, length: float, cross_section: float | None = None
) -> ChannelGeometry:
    """The channel beyond one side of the wall between two offsets (mm) of an endless sheet."""
    info = surfaces.find_surface(surface)
    reference, own = info.references[0], offset[1] if side == "+" else offset[0]
    for each in offset:
        surfaces.check_offset(info.name, reference, each, cell)
    porosity = surfaces.skeletal_volume_fraction(info.name, reference, own / cell, side)
    if porosity <= 0.0:
        raise InvalidRequest(
            f"thickness {offset[1] - offset[0]:g} leaves no channel in a cell of {cell:g}: thin the wall"
        )
    area = surfaces.cell_measures(info.name, reference).swept_area(own / cell)
    return ChannelGeometry(info.name, side, cell, porosity, 4.0 * porosity / area * cell, cross_section, length)


def measure_channel(domains: FluidDomains, side: str, length: float | None = None) -> ChannelGeometry:
    """The channel of fluid domains; its length is by default the distance of its two openings."""
    edges = set(domains.cell)
    if len(edges) > 1:
        raise InvalidRequest(f"the correlations are of cubic cells, the cell of these domains is {list(domains.cell)}")
    name = PLUS if side == "+" else MINUS
    if length is None:
        length = find_length(name, [contact.centre for contact in domains.touches if name in contact.areas])
    volume = domains.domains[name].volume
    if domains.offset is not None:
        core = describe_channel(domains.surface, edges.pop(), domains.offset, side, length)
        return ChannelGeometry(
            core.surface,
            side,
            core.cell,
            core.porosity,
            core.hydraulic_diameter,
            volume / (core.porosity * length),
            length,
        )
    porosity, diameter = volume / domains.volume, domains.hydraulic_diameters[name]
    return ChannelGeometry(
        domains.surface, side, edges.pop(), porosity, diameter, domains.volume / length, length, is_core=False
    )


def find_length(name: str, centres: Sequence[tuple[float, float, float] | None]) -> float:
    """The distance of the centres of a channel's two openings, mm."""
    known = [centre for centre in centres if centre is not None]
    if len(known) != 2:
        raise InvalidRequest(
            f"{name} opens at {len(centres)} faces: give `length`, the flow length in mm, of two it is known"
        )
    return math.dist(known[0], known[1])
