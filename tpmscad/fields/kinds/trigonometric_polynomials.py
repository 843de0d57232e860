"""Trigonometric polynomials, parsed from a formula and evaluated as sums of products of functions of one variable.

A formula such as "2 (cos x cos y + cos y cos z) - cos 2x + 0.25" becomes sum_i a_i(x) g_i(y, z) with one term for each distinct
function of x (1, sin x, cos x, sin 2x, cos 2x): at most five products with functions of x, whatever the length of the formula.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import reduce
from operator import mul

from tpmscad.fields.tape.tape_nodes import Node, cosine, sine, sum_nodes

Harmonic = tuple[str, int]
"""("sin", 2) stands for sin 2t."""
Term = tuple[float, dict[str, Harmonic]]
TermGroup = tuple[Harmonic | None, tuple[tuple[float, Harmonic | None, Harmonic | None], ...]]
"""a(x) and the terms (number, b(y), c(z)) of its factor g(y, z); None stands for the function 1."""


@dataclass(frozen=True, slots=True)
class TrigonometricPolynomial:
    """Sum over groups of a(x) times the sum of number b(y) c(z)."""

    groups: tuple[TermGroup, ...]

    def trace(self, x: Node, y: Node, z: Node) -> Node:
        """The polynomial of angles on the nodes of a tape."""
        terms = []
        for a, members in self.groups:
            factors = []
            for number, b, c in members:
                waves = [_wave(wave, t) for wave, t in ((b, y), (c, z)) if wave is not None]
                factors.append(number * reduce(mul, waves) if waves else x.recorder.constant(number))
            inner = sum_nodes(factors)
            terms.append(inner if a is None else _wave(a, x) * inner)
        return sum_nodes(terms)


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
        tuple((a, tuple((number, b, c) for (b, c), number in members.items())) for a, members in grouped.items())
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


def _wave(harmonic: Harmonic, t: Node) -> Node:
    name, multiple = harmonic
    return (sine if name == "sin" else cosine)(float(multiple) * t)
