"""Level-set fields of triply periodic surfaces, by name."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from tpmscad.fields.catalogue import TPMS, TpmsInfo, find
from tpmscad.fields.field import Field
from tpmscad.fields.points import Array, Jet, Triple, positive, triple
from tpmscad.fields.trigonometric import Polynomial, parse

POLYNOMIALS: Mapping[str, Polynomial] = MappingProxyType({name: parse(info.formula) for name, info in TPMS.items()})
"""The printed formulas, read: there is no second copy to disagree with them."""


@dataclass(frozen=True, slots=True)
class Tpms(Field):
    """The formula of the catalogue's entry `name` at x = 2 pi (X / period - phase), and so on."""

    name: str
    period: Triple
    phase: Triple

    @property
    def info(self) -> TpmsInfo:
        return TPMS[self.name]

    def at(self, x: Array, y: Array, z: Array) -> Array:
        return POLYNOMIALS[self.name].value(*self._angles(x, y, z))

    def jet(self, x: Array, y: Array, z: Array) -> Jet:
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


def tpms(name: str, period: float | Sequence[float] = 10.0, phase: Sequence[float] = (0.0, 0.0, 0.0)) -> Tpms:
    """The field of a surface of the catalogue (`TPMS`), negative on the side that its formula makes negative.

    period: edge of the cell in model units, or one for each axis. phase: by how much the structure is moved, in cells.
    """
    return Tpms(find(name).name, edges(period), triple(phase, "phase"))


def edges(period: float | Sequence[float]) -> Triple:
    """A period as three positive numbers; one number stands for all three."""
    px, py, pz = triple(period, "period") if np.ndim(period) else (period,) * 3
    return positive(px, "period"), positive(py, "period"), positive(pz, "period")
