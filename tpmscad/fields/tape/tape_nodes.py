"""Tapes as they are recorded: the elementary operations of a field as a graph of nodes.

A field states its formula once, in `trace(x, y, z)`, on nodes instead of numbers: `+ - * /` and the functions of this module add
operations. Equal operations are recorded once. Derivatives (`tape_derivatives.py`) are nodes, too, so that values and gradients
share what they have in common, and a formula may use the gradient of another field.

`Recorder.where(mask)` encloses operations that are needed at some points only: blocks without such a point skip them. Results are
to be used under a `select` with that mask.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import reduce
from typing import Any

import numpy as np

from tpmscad._typing import Array
from tpmscad.errors import InvalidRequest

ErrorFactory = Callable[[float, tuple[float, float, float]], InvalidRequest]
"""The error for a value at a point."""

EVERY_AXIS = 0b111
"""The coordinates on which a node depends, a bit for each axis."""


@dataclass(frozen=True, slots=True, eq=False)
class MaskedBlock:
    """Operations under a mask: recorded in `parent`, whose mask holds where this one does, and run where it holds at a point."""

    parent: MaskedBlock | None
    mask: Node
    known: dict[Any, Node] = field(default_factory=dict)


def list_enclosing(block: MaskedBlock | None) -> list[MaskedBlock]:
    """A masked block and those that it is recorded in, from the inside outwards."""
    return [] if block is None else [block, *list_enclosing(block.parent)]


@dataclass(frozen=True, slots=True, eq=False)
class SplineNumbers:
    """The numbers of a spline, and its coefficients (l, m, n), which may be many: they are known by their identity."""

    head: Array
    coefficients: Array


class Node:
    """A number at every point: the result of an operation on other nodes."""

    __slots__ = ("args", "block", "depends", "index", "name", "numbers", "operation", "output", "recorder", "rule")

    def __init__(
        self,
        recorder: Recorder,
        name: str,
        args: tuple[Node, ...],
        numbers: Any,
        output: int,
        depends: int,
        operation: object,
    ) -> None:
        self.operation = operation
        self.recorder, self.name, self.args, self.numbers, self.output = recorder, name, args, numbers, output
        self.block, self.depends, self.index = recorder.block, depends, len(recorder.nodes)
        self.rule: tuple[Sequence[Node], Callable[[], Sequence[Node | float]]] | None = None
        recorder.nodes.append(self)

    @property
    def number(self) -> float | None:
        """The value of a constant; None for other nodes."""
        return float(self.numbers[0]) if self.name == "constant" else None

    def __add__(self, other: Node | float) -> Node:
        number = read_number(other)
        if number is not None:
            own = self.number
            if own is not None:
                return self.recorder.constant(own + number)
            return self if number == 0.0 else self.recorder.record("shift", (self,), (number,))
        assert isinstance(other, Node)
        if self.number is not None:
            return other + self
        return self.recorder.record("add", (self, other))

    __radd__ = __add__

    def __sub__(self, other: Node | float) -> Node:
        number = read_number(other)
        if number is not None:
            return self + (-number)
        assert isinstance(other, Node)
        return self.recorder.record("subtract", (self, other))

    def __rtruediv__(self, other: float) -> Node:
        return self.recorder.constant(other) / self

    def __rsub__(self, other: float) -> Node:
        return self.recorder.constant(other) - self

    def __neg__(self) -> Node:
        return -1.0 * self

    def __mul__(self, other: Node | float) -> Node:
        number = read_number(other)
        if number is not None:
            own = self.number
            if own is not None:
                return self.recorder.constant(own * number)
            return self if number == 1.0 else self.recorder.record("scale", (self,), (number,))
        assert isinstance(other, Node)
        if self.number is not None:
            return other * self
        return self.recorder.record("multiply", (self, other))

    __rmul__ = __mul__

    def __truediv__(self, other: Node | float) -> Node:
        return self.recorder.record("divide", (self, self.recorder.as_node(other)))

    def __ge__(self, other: Node | float) -> Node:
        return self.recorder.record("at_least", (self, self.recorder.as_node(other)))

    def __gt__(self, other: Node | float) -> Node:
        return self.recorder.record("greater", (self, self.recorder.as_node(other)))

    def __le__(self, other: Node | float) -> Node:
        return self.recorder.record("at_least", (self.recorder.as_node(other), self))

    def __lt__(self, other: Node | float) -> Node:
        return self.recorder.record("greater", (self.recorder.as_node(other), self))

    def __or__(self, other: Node) -> Node:
        """A mask that holds where one of two masks does."""
        return select(self, self, other)

    def __and__(self, other: Node) -> Node:
        """A mask that holds where two masks do."""
        return self * other


@dataclass(slots=True, eq=False)
class ForeignFunction:
    """A function evaluated outside the tape by `source.at` and `source.jet`, at coordinates, where the mask, if any, holds."""

    source: Any
    coordinates: tuple[Node, Node, Node]
    mask: Node | None


class Recorder:
    """The nodes of one tape, in the order of recording, and the foreign functions that it calls."""

    def __init__(self) -> None:
        self.nodes: list[Node] = []
        self.block: MaskedBlock | None = None
        self.known: dict[Any, Node] = {}
        self.externals: list[ForeignFunction] = []
        self.errors: list[ErrorFactory] = []
        x, y, z = (self.record("coordinate", (), (axis,), depends=1 << axis) for axis in range(3))
        self.coordinates = x, y, z

    def record(
        self, name: str, args: tuple[Node, ...], numbers: Any = (), *, output: int = 0, depends: int = 0
    ) -> Node:
        """The node of an operation, recorded unless it is known."""
        key = (name, tuple(arg.index for arg in args), _hashable(numbers)), output
        for known in (*(each.known for each in list_enclosing(self.block)), self.known):
            if key in known:
                return known[key]
        for arg in args:
            depends |= arg.depends
        node = Node(self, name, args, numbers, output, depends, key[0])
        (self.known if self.block is None else self.block.known)[key] = node
        return node

    def constant(self, value: float) -> Node:
        """A constant, which belongs to no masked block."""
        with self.inside(None):
            return self.record("constant", (), (float(value),))

    def as_node(self, value: Node | float) -> Node:
        """A node, or the constant node of a number."""
        return value if isinstance(value, Node) else self.constant(value)

    @contextmanager
    def where(self, mask: Node) -> Iterator[None]:
        """Record operations that only points of the mask need, in a masked block those of both."""
        both = mask if self.block is None else self.block.mask & mask
        with self.inside(MaskedBlock(self.block, both)):
            yield

    def external(self, source: Any, coordinates: tuple[Node, Node, Node]) -> Node:
        """The value of a foreign function of coordinates, needed at the points of the block.

        `source.at` and `source.jet` evaluate it outside the tape, once for all calls with coordinates of the same values.
        """
        x, y, z = (resolve_alias(node) for node in coordinates)
        mask = None if self.block is None else self.block.mask
        known = [k for k, each in enumerate(self.externals) if each.source is source and each.coordinates == (x, y, z)]
        number = known[0] if known else len(self.externals)
        if not known:
            self.externals.append(ForeignFunction(source, (x, y, z), mask))
        elif self.externals[number].mask is not mask:
            self.externals[number].mask = None
        with self.inside(None):
            value, *slopes = (self.record("input", (), (number,), output=k, depends=EVERY_AXIS) for k in range(4))
            return self.with_gradient(value, coordinates, lambda: slopes)

    def require_within(
        self, node: Node, low: float, high: float, value_error: ErrorFactory, slope_error: ErrorFactory | None = None
    ) -> Node:
        """The node, with an error raised at points of the block where its value, or a derivative, is not within [low, high]."""
        first = len(self.errors)
        self.errors += [value_error] if slope_error is None else [value_error, slope_error]
        return self.check(node, (low, high, first, -1 if slope_error is None else first + 1))

    def with_gradient(
        self, value: Node, coordinates: Sequence[Node], make_factors: Callable[[], Sequence[Node | float]]
    ) -> Node:
        """A node with the value of another whose derivatives by given coordinates are stated, not derived."""
        node = Node(self, "alias", (value,), (), 0, value.depends, None)
        node.rule = coordinates, make_factors
        return node

    def check(self, node: Node, numbers: tuple[float, ...]) -> Node:
        """The node, checked in its block: the numbers are the limits, and of the errors of its values and derivatives."""
        mask = self.constant(1.0) if self.block is None else self.block.mask
        return self.record("check", (node, mask), numbers, depends=EVERY_AXIS)

    @contextmanager
    def inside(self, block: MaskedBlock | None) -> Iterator[None]:
        """Record operations in a masked block, or outside all."""
        before, self.block = self.block, block
        try:
            yield
        finally:
            self.block = before


def resolve_alias(node: Node) -> Node:
    """The node whose value an alias has."""
    while node.name == "alias":
        node = node.args[0]
    return node


def is_mask(node: Node) -> bool:
    """Whether a node is a comparison, or a choice between such."""
    return node.name in ("at_least", "greater") or (node.name == "select" and all(map(is_mask, node.args)))


def find_ancestors(
    nodes: Sequence[Node], stop: Collection[int], operands: Callable[[Node], Sequence[Node]]
) -> list[Node]:
    """The nodes and all on which they depend, in the order of recording; the search ends at indices in `stop`, included."""
    found = {node.index: node for node in nodes}
    waiting = list(found.values())
    while waiting:
        node = waiting.pop()
        if node.index in stop:
            continue
        for each in operands(node):
            if each.index not in found:
                found[each.index] = each
                waiting.append(each)
    return [found[index] for index in sorted(found)]


def select(mask: Node, yes: Node, no: Node) -> Node:
    """`yes` where the mask holds, else `no`."""
    return yes if yes is no else mask.recorder.record("select", (mask, yes, no))


def choose_extreme(sign: int, first: Node, second: Node) -> Node:
    """The maximum (sign +1) or minimum (sign -1); the first, with its derivatives, where both are equal."""
    return select(first >= second if sign > 0 else first <= second, first, second)


def clamp(node: Node, low: float, high: float) -> Node:
    """The value clamped to [low, high]; infinite limits are none."""
    if low > -math.inf:
        node = choose_extreme(+1, node, node.recorder.constant(low))
    return node if high == math.inf else choose_extreme(-1, node, node.recorder.constant(high))


def sine(node: Node) -> Node:
    """Sine of an angle in radians."""
    return node.recorder.record("sine_cosine", (node,))


def cosine(node: Node) -> Node:
    """Cosine of an angle in radians."""
    return node.recorder.record("sine_cosine", (node,), output=1)


def absolute(node: Node) -> Node:
    """Absolute value; its derivative at 0 is 0."""
    return node.recorder.record("absolute", (node,))


def root(node: Node) -> Node:
    """Square root."""
    return node.recorder.record("root", (node,))


def norm(*parts: Node) -> Node:
    """Length of a vector."""
    return root(sum_nodes([part * part for part in parts]))


def sum_nodes(parts: Sequence[Node]) -> Node:
    """Sum from the first to the last."""
    return reduce(operator.add, parts)


def apply_function(name: str, node: Node) -> Node:
    """An elementary function of the list."""
    return node.recorder.record(name, (node,), (0.0,))


def angle(ordinate: Node, abscissa: Node) -> Node:
    """atan2(ordinate, abscissa) in radians."""
    return ordinate.recorder.record("angle", (ordinate, abscissa), (0.0,))


def power(base: Node, exponent: float) -> Node:
    """The base to the exponent; small whole exponents are products."""
    if exponent == int(exponent) and 0 <= exponent <= 4:
        return reduce(operator.mul, [base] * int(exponent), base.recorder.constant(1.0))
    return base.recorder.record("power", (base,), (float(exponent),))


def piecewise_polynomial(knots: Array, coefficients: Array, node: Node) -> Node:
    """Polynomials between knots (n + 1,), of coefficients (order, n), highest power first (`scipy.interpolate.PPoly`).

    The first and the last polynomial are continued beyond the knots.
    """
    order, pieces = coefficients.shape
    numbers = np.concatenate([[pieces, order], knots, coefficients.T.ravel()])
    return node.recorder.record("piecewise", (node,), numbers)


def tensor_spline(
    knots: Sequence[Array], degrees: Sequence[int], coefficients: Array, nodes: tuple[Node, Node, Node]
) -> Node:
    """The tensor-product B-spline of coefficients (l, m, n) on knot vectors; the nodes lie within the knots."""
    head = np.concatenate([degrees, coefficients.shape, *knots])
    return nodes[0].recorder.record("tensor", nodes, SplineNumbers(head, coefficients))


def periodic_spline(coefficients: Array, period: Sequence[float], nodes: tuple[Node, Node, Node]) -> Node:
    """The cubic B-spline on a uniform periodic grid: coefficient (i, j, k) of (l, m, n) is at (i / l, j / m, k / n) periods."""
    counts = np.array(coefficients.shape)
    head = np.concatenate([counts, counts / np.array(period)])
    return nodes[0].recorder.record("periodic_spline", nodes, SplineNumbers(head, coefficients))


ELEMENTARY_FUNCTIONS = frozenset({"tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "exp", "log"})
"""Elementary functions of one argument that are computed point by point."""


def read_number(value: Node | float) -> float | None:
    """The value of a number or constant; None for other nodes."""
    return value.number if isinstance(value, Node) else float(value)


def _hashable(numbers: Any) -> Any:
    if isinstance(numbers, SplineNumbers):
        return numbers.head.tobytes(), id(numbers.coefficients)
    return numbers.tobytes() if isinstance(numbers, np.ndarray) else numbers
