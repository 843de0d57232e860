"""Thresholds for a volume fraction that varies in space: what a uniform structure of the local fraction has, place by place.

The threshold is a spline of the fraction, through the fractions of a uniform structure at a row of thresholds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from tpmscad.errors import InvalidRequest
from tpmscad.fields.field import Field, FieldLike, as_field
from tpmscad.fields.fraction import ACCURACY, Domain, fractions_of, threshold_for
from tpmscad.fields.points import Array, Jet

NODES = 17
"""Thresholds whose fractions are sampled; for gyroid rods of 0.2 to 0.5 the spline is off by 2e-5 at most."""


@dataclass(frozen=True, slots=True, eq=False)
class GradedThreshold(Field):
    """The threshold of the fraction `by`, which stays within the spline's range; `sign` -1 for the lower one of a sheet."""

    by: Field
    table: CubicSpline
    level: float
    sign: float

    def at(self, x: Array, y: Array, z: Array) -> Array:
        return self.level + self.sign * np.asarray(self.table(self._within(self.by.at(x, y, z))))

    def jet(self, x: Array, y: Array, z: Array) -> Jet:
        by, bx, by_, bz = self.by.jet(x, y, z)
        by = self._within(by)
        value, rate = self.level + self.sign * np.asarray(self.table(by)), self.sign * np.asarray(self.table(by, 1))
        return value, rate * bx, rate * by_, rate * bz

    def _within(self, fraction: Array) -> Array:
        low, high = self.table.x[[0, -1]]
        least, most = fraction.min(initial=high), fraction.max(initial=low)
        if least < low - ACCURACY or most > high + ACCURACY:
            raise InvalidRequest(
                f"a volume fraction of {least if least < low else most:.4g} is asked for, the span is {low:g} to {high:g}: "
                "widen the span, or end the fraction's ramp within it"
            )
        return fraction


def graded_threshold(
    phi: FieldLike,
    fraction: FieldLike,
    span: Sequence[float],
    kind: str = "rod",
    *,
    level: float = 0.0,
    domain: Domain | None = None,
) -> Field | tuple[Field, Field]:
    """The threshold field with which `rod` or `pore` of phi has the volume fraction `fraction` where it changes slowly.

    fraction: a field with values within span = (least, greatest). phi: periodic, or with a `domain` to sample, as for
    `threshold_for`. For kind "sheet" the two threshold fields about `level`.
    """
    by = as_field(fraction)
    try:
        low, high = (float(f) for f in span)
    except (TypeError, ValueError):
        raise InvalidRequest(f"span {span!r} must be two volume fractions, the least and the greatest") from None
    if not 0 < low < high < 1:
        raise InvalidRequest(f"span {span!r} must be two volume fractions between 0 and 1, the least first")
    ends = [threshold_for(phi, f, kind, level=level, domain=domain) for f in (low, high)]
    first, last = (e[1] - level if isinstance(e, tuple) else e for e in ends)
    rows = np.linspace(first, last, NODES)
    found = fractions_of(phi, rows, kind, level=level, domain=domain)
    found[0], found[-1] = low, high
    if not (np.diff(found) > 0).all():
        raise InvalidRequest(f"volume fractions from {low:g} to {high:g} do not tell thresholds apart: narrow the span")
    table = CubicSpline(found, rows)
    if kind == "sheet":
        return GradedThreshold(by, table, level, -1.0), GradedThreshold(by, table, level, 1.0)
    return GradedThreshold(by, table, 0.0, 1.0)
