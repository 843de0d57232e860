"""Nodal fields of triply periodic surfaces, by name: the formula of the catalogue at scaled coordinates."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

from tpmscad._typing import Array
from tpmscad.catalogue import CATALOGUE, SurfaceRecord, find_surface
from tpmscad.fields.evaluation import FieldJet, Triple
from tpmscad.fields.field import Field
from tpmscad.fields.periods_and_directions import choose_periods
from tpmscad.fields.trigonometric_polynomials import TrigonometricPolynomial, parse_formula
from tpmscad.public_calls import public

POLYNOMIALS: Mapping[str, TrigonometricPolynomial] = MappingProxyType(
    {name: parse_formula(record.formula) for name, record in CATALOGUE.items()}
)
"""The parsed formulas of the catalogue, so that what is printed is what is evaluated."""


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

    def at(self, x: Array, y: Array, z: Array) -> Array:
        """Values at coordinates that broadcast."""
        return POLYNOMIALS[self.name].value(*self._angles(x, y, z))

    def jet(self, x: Array, y: Array, z: Array) -> FieldJet:
        """Value and partial derivatives at coordinates that broadcast."""
        value, fx, fy, fz = POLYNOMIALS[self.name].jet(*self._angles(x, y, z))
        a, b, c = (2 * math.pi / p for p in self.period)
        return value, a * fx, b * fy, c * fz

    def periods(self) -> Triple | None:
        """Periods along the axes, or None."""
        return self.period

    def _angles(self, *coordinates: Array) -> tuple[Array, ...]:
        return tuple(
            (2 * math.pi / period) * t - 2 * math.pi * shift
            for t, period, shift in zip(coordinates, self.period, self.phase, strict=True)
        )


@public()
def tpms(
    name: str,
    period: float | Sequence[float] | None = None,
    phase: Triple = (0.0, 0.0, 0.0),
    *,
    cell: float | Sequence[float] | None = None,
) -> NodalField:
    """Return the nodal field of a triply periodic surface.

    Parameters
    ----------
    name : str
        Name, title or alias of a surface of the catalogue (`fields.TPMS`).
    period : float or (px, py, pz), optional
        Edges of the unit cell, in model units; 10 by default.
    phase : (x, y, z)
        Translation of the structure, in cells.
    cell : float or (px, py, pz), optional
        The same as `period`, by the word of lattices; give one of the two.

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
