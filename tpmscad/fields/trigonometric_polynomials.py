"""Trigonometric polynomials, parsed from a formula and evaluated as sums of products of functions of one variable.

A formula such as "2 (cos x cos y + cos y cos z) - cos 2x + 0.25" becomes sum_i a_i(x) g_i(y, z) with one term for each distinct
function of x (1, sin x, cos x, sin 2x, cos 2x). On a grid at most five products of full size are formed, whatever the length of
the formula.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array
from tpmscad.fields.evaluation import FieldJet

Harmonic = tuple[str, int]
"""("sin", 2) stands for sin 2t."""
Term = tuple[float, dict[str, Harmonic]]
TermGroup = tuple[Harmonic | None, tuple[tuple[float, Harmonic | None, Harmonic | None], ...]]
"""a(x) and the terms (number, b(y), c(z)) of its factor g(y, z); None stands for the function 1."""
HarmonicTable = dict[Harmonic | None, Array | None]
"""Values of the functions of one axis; None stands for 1. Functions without an entry are 0, as the derivative of 1."""


@dataclass(frozen=True, slots=True)
class TrigonometricPolynomial:
    """Sum over groups of a(x) times the sum of number b(y) c(z); `harmonics` lists the functions of each axis."""

    groups: tuple[TermGroup, ...]
    harmonics: tuple[tuple[Harmonic, ...], ...]

    def value(self, x: Array, y: Array, z: Array) -> Array:
        """Value at angles that broadcast."""
        a, b, c = (_tabulate(harmonics, t) for harmonics, t in zip(self.harmonics, (x, y, z), strict=True))
        return _sum_groups(self.groups, a, b, c, x.ndim)

    def jet(self, x: Array, y: Array, z: Array) -> FieldJet:
        """Value and the three derivatives by the angles."""
        (a, da), (b, db), (c, dc) = (
            _tabulate_with_derivatives(harmonics, t) for harmonics, t in zip(self.harmonics, (x, y, z), strict=True)
        )
        n = x.ndim
        return (
            _sum_groups(self.groups, a, b, c, n),
            _sum_groups(self.groups, da, b, c, n),
            _sum_groups(self.groups, a, db, c, n),
            _sum_groups(self.groups, a, b, dc, n),
        )


def parse_formula(formula: str) -> TrigonometricPolynomial:
    """Polynomial of a formula of numbers, sin and cos of multiples of x, y, z, juxtaposed products, + - and parentheses."""
    tokens: list[str] = re.findall(r"\d+\.?\d*|sin|cos|[xyz()+\-]", formula)
    if "".join(tokens) != re.sub(r"\s", "", formula):
        raise ValueError(
            f"{formula!r} contains a token that is neither a number, sin, cos, x, y, z, a sign nor a parenthesis"
        )
    terms, rest = _parse_sum(tokens)
    if rest:
        raise ValueError(f"{formula!r} cannot be parsed from {' '.join(rest)!r} on")
    grouped: dict[Harmonic | None, dict[tuple[Harmonic | None, Harmonic | None], float]] = {}
    for number, waves in terms:
        members = grouped.setdefault(waves.get("x"), {})
        key = waves.get("y"), waves.get("z")
        members[key] = members.get(key, 0.0) + number
    return TrigonometricPolynomial(
        tuple((a, tuple((number, b, c) for (b, c), number in members.items())) for a, members in grouped.items()),
        tuple(tuple(sorted({waves[axis] for _, waves in terms if axis in waves})) for axis in "xyz"),
    )


def _parse_sum(tokens: list[str]) -> tuple[list[Term], list[str]]:
    terms: list[Term] = []
    sign = 1.0
    if tokens and tokens[0] in "+-":
        sign, tokens = (-1.0 if tokens[0] == "-" else 1.0), tokens[1:]
    while True:
        part, tokens = _parse_product(tokens)
        terms += [(sign * number, waves) for number, waves in part]
        if not tokens or tokens[0] == ")":
            return terms, tokens
        sign, tokens = (-1.0 if tokens[0] == "-" else 1.0), tokens[1:]


def _parse_product(tokens: list[str]) -> tuple[list[Term], list[str]]:
    if not tokens or tokens[0] in "+-)":
        raise ValueError("a term is missing")
    product: list[Term] = [(1.0, {})]
    while tokens and tokens[0] not in "+-)":
        head, *tokens = tokens
        factor: list[Term]
        if head == "(":
            factor, tokens = _parse_sum(tokens)
            if tokens[:1] != [")"]:
                raise ValueError("a parenthesis is not closed")
            tokens = tokens[1:]
        elif head in ("sin", "cos"):
            multiple = 1
            if tokens and tokens[0].isdigit():
                multiple, tokens = int(tokens[0]), tokens[1:]
            if tokens[:1] not in (["x"], ["y"], ["z"]):
                raise ValueError(f"{head} of what: x, y, z or a multiple of one is needed")
            factor, tokens = [(1.0, {tokens[0]: (head, multiple)})], tokens[1:]
        else:
            factor = [(float(head), {})]
        product = [(m * n, _multiply_harmonics(v, w)) for m, v in product for n, w in factor]
    return product, tokens


def _multiply_harmonics(first: dict[str, Harmonic], second: dict[str, Harmonic]) -> dict[str, Harmonic]:
    if first.keys() & second.keys():
        raise ValueError("powers must be written as multiple angles")
    return first | second


def _tabulate(waves: tuple[Harmonic, ...], t: Array) -> HarmonicTable:
    table: HarmonicTable = {None: None}
    for name, multiple in waves:
        angle = t if multiple == 1 else multiple * t
        table[name, multiple] = np.sin(angle) if name == "sin" else np.cos(angle)
    return table


def _tabulate_with_derivatives(waves: tuple[Harmonic, ...], t: Array) -> tuple[HarmonicTable, HarmonicTable]:
    """Table of values and table of derivatives."""
    values = _tabulate(tuple((name, m) for m in sorted({m for _, m in waves}) for name in ("sin", "cos")), t)
    derivatives: HarmonicTable = {}
    for name, m in waves:
        cofunction = values["cos" if name == "sin" else "sin", m]
        assert cofunction is not None
        derivatives[name, m] = (m if name == "sin" else -m) * cofunction
    return {wave: values[wave] for wave in (None, *waves)}, derivatives


def _sum_groups(
    groups: tuple[TermGroup, ...], a: HarmonicTable, b: HarmonicTable, c: HarmonicTable, dimension: int
) -> Array:
    total: Array | None = None
    for wave, members in groups:
        if wave not in a:
            continue
        inner: Array | None = None
        for number, second, third in members:
            if second in b and third in c:
                part = _scale(number, _multiply(b[second], c[third]), dimension)
                inner = part if inner is None else inner + part
        if inner is not None:
            part = _scale(1.0, _multiply(a[wave], inner), dimension)
            total = part if total is None else total + part
    return np.zeros((1,) * dimension) if total is None else total


def _multiply(first: Array | None, second: Array | None) -> Array | None:
    if first is None or second is None:
        return second if first is None else first
    return first * second


def _scale(number: float, values: Array | None, dimension: int) -> Array:
    if values is None:
        return np.full((1,) * dimension, number)
    return values if number == 1.0 else number * values
