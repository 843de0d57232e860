"""Fields of triply periodic surfaces, by name: the nodal formula of the catalogue, or the series of the minimal surface.

A series is a sum of products of one function of x, one of y and one of z each, sines and cosines of multiples of the angle.
Common factors are taken out, so that a tape holds two operations for most products.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, reduce
from itertools import product
from operator import add
from types import MappingProxyType
from typing import Annotated

import numpy as np

from tpmscad.api.argument_kinds import POINT, choice_of
from tpmscad.api.public_calls import validate_call
from tpmscad.api.shared_kinds import LENGTHS, TEXT
from tpmscad.catalogue import CATALOGUE, SurfaceRecord, check_reference, find_surface
from tpmscad.fields.field import Field
from tpmscad.fields.kinds.expressions import coordinates_by_name, read_formula
from tpmscad.fields.periods_and_directions import choose_periods
from tpmscad.fields.tape.evaluation import Triple
from tpmscad.fields.tape.tape_nodes import Node, cosine, sine
from tpmscad.minimal_series import MINIMAL_SERIES, expand_series

FORMULAS: Mapping[str, Field] = MappingProxyType(
    {name: read_formula(record.formula, coordinates_by_name("xyz", 1.0)) for name, record in CATALOGUE.items()}
)
"""The formulas of the catalogue as fields of the angles, so that what is printed is what is evaluated."""

CANCELLED = 1e-15
"""Coefficient of a product, relative to the greatest, below which its waves cancel."""


@dataclass(frozen=True, slots=True)
class NodalField(Field):
    """The function of the surface `name` at x = 2 pi (X / period - phase), and likewise for y and z.

    `reference`: "nodal" for the formula of the catalogue, "minimal" for the series of the minimal surface.
    """

    name: str
    period: Triple
    phase: Triple
    reference: str = "nodal"

    @property
    def info(self) -> SurfaceRecord:
        """The surface's record in the catalogue."""
        return CATALOGUE[self.name]

    @property
    def value_range(self) -> tuple[float, float]:
        """Minimum and maximum of the function."""
        return self.info.value_range if self.reference == "nodal" else MINIMAL_SERIES[self.name].value_range

    def trace(self, x: Node, y: Node, z: Node) -> Node:
        """The function on the nodes of a tape."""
        angles = (
            (2 * math.pi / period) * t - 2 * math.pi * shift
            for t, period, shift in zip((x, y, z), self.period, self.phase, strict=True)
        )
        if self.reference == "nodal":
            return FORMULAS[self.name].trace(*angles)
        return _trace_products(list_products(self.name), *angles)

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
    reference: Annotated[
        str,
        choice_of("minimal", "nodal"),
        "The formula of the catalogue, 'nodal', or the series whose zero set is the minimal surface, 'minimal'.",
    ] = "nodal",
    cell: Annotated[
        float | Sequence[float] | None, LENGTHS, "The same as `period`, by the word of lattices; give one of the two."
    ] = None,
) -> NodalField:
    """Return the field of a triply periodic surface.

    Returns
    -------
    NodalField
        The field; its solid is the side that the function makes negative.

    Raises
    ------
    InvalidRequest
        If the name is unknown, the surface lacks the reference, a period is not positive or a number is not finite.

    Notes
    -----
    The zero set of a minimal field has mean curvature zero within `tpmscad.minimal_series`'s residual, 1e-10 to 4e-6 over the
    period, and the place and symmetry of the nodal surface.

    Examples
    --------
    >>> from tpmscad import fields
    >>> phi = fields.tpms("gyroid", period=10.0)
    >>> phi.periods()
    (10.0, 10.0, 10.0)
    """
    record = find_surface(name)
    check_reference(record, reference)
    return NodalField(record.name, choose_periods(period, cell), phase, reference)


Factor = tuple[int, bool]
"""cos n t, or sin n t if True, of an angle t."""


@cache
def list_products(name: str) -> Mapping[Factor, Mapping[Factor, Mapping[Factor, float]]]:
    """The series of a minimal surface as coefficients of products, by their factors of z, then y, then x."""
    vectors, amplitudes = expand_series(name)
    table: dict[tuple[Factor, Factor, Factor], float] = {}
    for vector, amplitude in zip(vectors.astype(int).tolist(), amplitudes, strict=True):
        for sines in product((False, True), repeat=3):
            # exp(i k . x) is the product of cos + i sin over the axes; sin 0 vanishes
            factors = [1j * np.sign(k) if odd else 1.0 for k, odd in zip(vector, sines, strict=True)]
            weight = amplitude * np.prod(factors)
            x, y, z = ((abs(k), odd) for k, odd in zip(vector, sines, strict=True))
            table[z, y, x] = table.get((z, y, x), 0.0) + float(weight.real)
    nested: dict[Factor, dict[Factor, dict[Factor, float]]] = {}
    least = CANCELLED * max(abs(c) for c in table.values())
    for (z, y, x), coefficient in sorted(table.items()):
        if abs(coefficient) > least:
            nested.setdefault(z, {}).setdefault(y, {})[x] = coefficient
    return nested


def _trace_products(products: Mapping[Factor, Mapping[Factor, Mapping[Factor, float]]], *angles: Node) -> Node:
    """The sum of products of waves of three angles."""
    x, y, z = angles

    def wave(angle: Node, factor: Factor) -> Node:
        multiple, odd = factor
        return sine(multiple * angle) if odd else cosine(multiple * angle)

    def total(terms: Iterator[Node]) -> Node:
        return reduce(add, terms)

    return total(
        wave(z, c) * total(wave(y, b) * total(wave(x, a) * v for a, v in row.items()) for b, row in rows.items())
        for c, rows in products.items()
    )
