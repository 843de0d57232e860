"""Level-set fields of triply periodic surfaces, by name."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from tpmscad._typing import Array
from tpmscad.catalogue import CATALOGUE, SurfaceRecord, find_surface
from tpmscad.fields.evaluation import FieldJet, Triple, as_positive, as_triple
from tpmscad.fields.field import Field
from tpmscad.fields.trigonometric_polynomials import TrigonometricPolynomial, parse_formula

POLYNOMIALS: Mapping[str, TrigonometricPolynomial] = MappingProxyType(
    {name: parse_formula(info.formula) for name, info in CATALOGUE.items()}
)
"""The printed formulas, read: there is no second copy to disagree with them."""


@dataclass(frozen=True, slots=True)
class NodalField(Field):
    """The formula of the catalogue's entry `name` at x = 2 pi (X / period - phase), and so on."""

    name: str
    period: Triple
    phase: Triple

    @property
    def info(self) -> SurfaceRecord:
        return CATALOGUE[self.name]

    def at(self, x: Array, y: Array, z: Array) -> Array:
        return POLYNOMIALS[self.name].value(*self._angles(x, y, z))

    def jet(self, x: Array, y: Array, z: Array) -> FieldJet:
        value, fx, fy, fz = POLYNOMIALS[self.name].jet(*self._angles(x, y, z))
        a, b, c = (2 * math.pi / p for p in self.period)
        return value, a * fx, b * fy, c * fz

    def periods(self) -> Triple | None:
        return self.period

    def _angles(self, *coordinates: Array) -> tuple[Array, ...]:
        return tuple(
            (2 * math.pi / period) * t - 2 * math.pi * shift
            for t, period, shift in zip(coordinates, self.period, self.phase, strict=True)
        )


def tpms(name: str, period: float | Sequence[float] = 10.0, phase: Sequence[float] = (0.0, 0.0, 0.0)) -> NodalField:
    """The field of a surface of the catalogue (`TPMS`), negative on the side that its formula makes negative.

    period: edge of the cell in model units, or one for each axis. phase: by how much the structure is moved, in cells.
    """
    return NodalField(find_surface(name).name, as_periods(period), as_triple(phase, "phase"))


def as_periods(period: float | Sequence[float]) -> Triple:
    """A period as three positive numbers; one number stands for all three."""
    px, py, pz = as_triple(period, "period") if np.ndim(period) else (period,) * 3
    return as_positive(px, "period"), as_positive(py, "period"), as_positive(pz, "period")
