"""Derivatives of recorded nodes by the chain rule, as nodes of the same tape."""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any

from tpmscad.fields.tape.tape_nodes import (
    ELEMENTARY_FUNCTIONS,
    Node,
    apply_function,
    cosine,
    find_ancestors,
    power,
    read_number,
    root,
    select,
    sine,
)

Partials = tuple[Node | None, Node | None, Node | None]
"""Derivatives by three coordinates; None is zero."""


def differentiate(node: Node, seeds: Sequence[Node]) -> Partials:
    """Derivatives of a node by three nodes on which it depends."""
    recorder = node.recorder
    one = recorder.constant(1.0)
    found: dict[int, Partials] = {
        seed.index: (one if k == 0 else None, one if k == 1 else None, one if k == 2 else None)
        for k, seed in enumerate(seeds)
    }
    for each in find_ancestors([node], found, lambda n: n.args if n.rule is None else n.rule[0]):
        if each.index not in found:
            with recorder.inside(each.block):
                found[each.index] = _make_partials(each, found)
    return found[node.index]


def _make_partials(node: Node, found: dict[int, Partials]) -> Partials:
    arguments = node.args if node.rule is None else node.rule[0]
    partials = [found[argument.index] for argument in arguments]
    if node.name in ("at_least", "greater") or all(p is None for each in partials for p in each):
        return None, None, None
    if node.rule is None and node.name == "select":
        return _triple(lambda k: _select_partial(node.args[0], partials[1][k], partials[2][k]))
    if node.name == "check":
        low, high, _, number = node.numbers
        if number < 0:
            return partials[0]
        return _triple(
            lambda k: None if (p := partials[0][k]) is None else node.recorder.check(p, (low, high, number, -1))
        )
    factors = FACTORS[node.name](node) if node.rule is None else node.rule[1]()
    product = _chain if node.name in ELEMENTARY_FUNCTIONS or node.name == "root" else operator.mul
    return _triple(lambda k: _sum_products(product, [each[k] for each in partials], factors))


def _select_partial(mask: Node, yes: Node | None, no: Node | None) -> Node | None:
    if yes is None and no is None:
        return None
    zero = mask.recorder.constant(0.0)
    return select(mask, zero if yes is None else yes, zero if no is None else no)


def _other_output(node: Node, output: int) -> Node:
    if node.output:
        raise NotImplementedError(f"second derivatives of {node.name} are not on the tape")
    return node.recorder.record(node.name, node.args, node.numbers, output=output)


def _factors_of_quotient(node: Node) -> tuple[Node, Node]:
    inverse = 1.0 / node.args[1]
    return inverse, -(node * inverse)


def _factors_of_angle(node: Node) -> tuple[Node, Node]:
    s, c = node.args
    square = s * s + c * c
    return c / square, -(s / square)


FACTORS: Mapping[str, Callable[[Node], Sequence[Node | float]]] = MappingProxyType(
    {
        "scale": lambda n: n.numbers,
        "shift": lambda n: (1.0,),
        "add": lambda n: (1.0, 1.0),
        "subtract": lambda n: (1.0, -1.0),
        "multiply": lambda n: (n.args[1], n.args[0]),
        "divide": _factors_of_quotient,
        "chain": lambda n: (n.args[1], n.args[0]),
        "absolute": lambda n: ((n.args[0] > 0.0) - (n.args[0] < 0.0),),
        "root": lambda n: (0.5 / n,),
        "sine_cosine": lambda n: (-sine(n.args[0]) if n.output else cosine(n.args[0]),),
        "piecewise": lambda n: (_other_output(n, 1),),
        "tensor": lambda n: tuple(_other_output(n, k) for k in (1, 2, 3)),
        "periodic_spline": lambda n: tuple(_other_output(n, k) for k in (1, 2, 3)),
        "tan": lambda n: (n * n + 1.0,),
        "asin": lambda n: (1.0 / root(1.0 - n.args[0] * n.args[0]),),
        "acos": lambda n: (-1.0 / root(1.0 - n.args[0] * n.args[0]),),
        "atan": lambda n: (1.0 / (n.args[0] * n.args[0] + 1.0),),
        "sinh": lambda n: (apply_function("cosh", n.args[0]),),
        "cosh": lambda n: (apply_function("sinh", n.args[0]),),
        "tanh": lambda n: (1.0 - n * n,),
        "exp": lambda n: (n,),
        "log": lambda n: (1.0 / n.args[0],),
        "power": lambda n: (n.numbers[0] * power(n.args[0], n.numbers[0] - 1.0),),
        "angle": _factors_of_angle,
    }
)
"""Derivatives of each operation by its operands."""


def _sum_products(
    product: Callable[[Any, Any], Any], partials: Sequence[Node | None], factors: Sequence[Node | float]
) -> Node | None:
    """Sum of factor times partial derivative, without the terms that are zero."""
    total: Node | None = None
    for partial, factor in zip(partials, factors, strict=True):
        if partial is None or read_number(factor) == 0.0:
            continue
        if total is not None and read_number(factor) == -1.0:
            total = total - partial
            continue
        term = product(factor, partial)
        total = term if total is None else total + term
    return total


def _chain(factor: Node, partial: Node) -> Node:
    """Factor * partial, zero where the partial derivative is: on the axis the slope of sqrt(x^2 + y^2) is infinite."""
    return factor * partial if partial.number is not None else factor.recorder.record("chain", (factor, partial))


def _triple(make: Callable[[int], Node | None]) -> Partials:
    return make(0), make(1), make(2)
