"""Nodal fields of triply periodic surfaces, by name: the formula of the catalogue at scaled coordinates."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Annotated

from tpmscad.api.argument_kinds import POINT
from tpmscad.api.public_calls import validate_call
from tpmscad.api.shared_kinds import LENGTHS, TEXT
from tpmscad.catalogue import CATALOGUE, SurfaceRecord, find_surface
from tpmscad.fields.field import Field
from tpmscad.fields.kinds.expressions import coordinates_by_name, read_formula
from tpmscad.fields.periods_and_directions import choose_periods
from tpmscad.fields.tape.evaluation import Triple
from tpmscad.fields.tape.tape_nodes import Node

FORMULAS: Mapping[str, Field] = MappingProxyType(
    {name: read_formula(record.formula, coordinates_by_name("xyz", 1.0)) for name, record in CATALOGUE.items()}
)
"""The formulas of the catalogue as fields of the angles, so that what is printed is what is evaluated."""


@dataclass(frozen=True, slots=True)
class NodalField(Field):
    """The formula of the surface `name` at x = 2 pi (X / period - phase), and likewise for y and z."""

    name: str
    period: Triple
    phase: Triple

    @property
    def info(self) -> SurfaceRecord:
        """The surface's record in the catalogue."""
        return CATALOGUE[self.name]

    def trace(self, x: Node, y: Node, z: Node) -> Node:
        """The formula on the nodes of a tape."""
        angles = (
            (2 * math.pi / period) * t - 2 * math.pi * shift
            for t, period, shift in zip((x, y, z), self.period, self.phase, strict=True)
        )
        return FORMULAS[self.name].trace(*angles)

    def periods(self) -> Triple | None:
        """Periods along the axes, or None."""
        return self.period


@validate_call()
def tpms(
    name: Annotated[str, TEXT, "Name, title or alias of a surface of the catalogue (`fields.TPMS`)."],
    period: Annotated[
        float | Sequence[float] | None, LENGTHS, "Edges of the unit cell, in model units; 10 by default."
    ] = None,
    phase: Annotated[Triple, POINT, "Translation of the structure, in cells."] = (0.0, 0.0, 0.0),
    *,
    cell: Annotated[
        float | Sequence[float] | None, LENGTHS, "The same as `period`, by the word of lattices; give one of the two."
    ] = None,
) -> NodalField:
    """Return the nodal field of a triply periodic surface.

    Returns
    -------
    NodalField
        The field; its solid is the side that the formula makes negative.

    Raises
    ------
    InvalidRequest
        If the name is unknown, a period is not positive or a number is not finite.

    Examples
    --------
    >>> from tpmscad import fields
    >>> phi = fields.tpms("gyroid", period=10.0)
    >>> phi.periods()
    (10.0, 10.0, 10.0)
    """
    return NodalField(find_surface(name).name, choose_periods(period, cell), phase)
