"""Fields of formulas: text such as "sin(x)*cos(y) + 0.2*z", parsed into a tree with exact derivatives and never run as code.

Python's parser reads the text; only numbers, coordinates, named fields, arithmetic and the functions of a list become nodes, so
that a formula cannot call or reach anything else.
"""

from __future__ import annotations

import ast
import math
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from functools import partial, reduce
from operator import add
from types import MappingProxyType
from typing import Annotated

from tpmscad.api.public_calls import validate_call
from tpmscad.api.shared_kinds import FIELD, POSITIVE, TEXT
from tpmscad.errors import InvalidRequest
from tpmscad.fields.field import (
    BinaryField,
    ConstantField,
    Field,
    FieldLike,
    MinMaxField,
    PowerField,
    ScaledField,
    SumField,
    as_field,
    multiply_fields,
)
from tpmscad.fields.kinds.ramps import AffineFunction
from tpmscad.fields.tape.evaluation import Triple
from tpmscad.fields.tape.tape_nodes import (
    ELEMENTARY_FUNCTIONS,
    Node,
    absolute,
    angle,
    apply_function,
    cosine,
    root,
    sine,
)

MAX_CHARACTERS = 10_000
"""Length of a formula; longer ones are made by programs, which can compose fields directly."""

MAX_DEPTH = 100
"""Nesting of a formula, well below the depth at which evaluation meets the interpreter's recursion limit."""

MULTIPLE_TOL = 1e-9
"""Relative difference from a whole multiple within which one wave repeats with another."""

CONSTANTS: Mapping[str, float] = MappingProxyType({"pi": math.pi, "e": math.e})
"""Names of numbers."""


FUNCTIONS: Mapping[str, Callable[[Node], Node]] = MappingProxyType(
    {"sin": sine, "cos": cosine, "sqrt": root, "abs": absolute}
    | {name: partial(apply_function, name) for name in sorted(ELEMENTARY_FUNCTIONS)}
)
"""Functions of one argument. `min`, `max`, `hypot` and `atan2` take several."""


@dataclass(frozen=True, slots=True)
class FunctionOfField(Field):
    """A function of the list applied to a field."""

    name: str
    argument: Field

    def trace(self, x: Node, y: Node, z: Node) -> Node:
        """The formula on the nodes of a tape."""
        return FUNCTIONS[self.name](self.argument.trace(x, y, z))


@dataclass(frozen=True, slots=True)
class QuotientField(BinaryField):
    """first / second."""

    def trace(self, x: Node, y: Node, z: Node) -> Node:
        """The formula on the nodes of a tape."""
        return self.first.trace(x, y, z) / self.second.trace(x, y, z)


@dataclass(frozen=True, slots=True)
class AngleField(BinaryField):
    """atan2(first, second), radians; it jumps where the angle passes pi."""

    def trace(self, x: Node, y: Node, z: Node) -> Node:
        """The formula on the nodes of a tape."""
        return angle(self.first.trace(x, y, z), self.second.trace(x, y, z))


@dataclass(frozen=True, slots=True, eq=False)
class ExpressionField(Field):
    """The field of a formula; a value that is not finite raises InvalidRequest with the place."""

    formula: str
    tree: Field

    def trace(self, x: Node, y: Node, z: Node) -> Node:
        """The formula on the nodes of a tape."""
        limit = sys.float_info.max
        value = self.tree.trace(x, y, z)
        return x.recorder.require_within(
            value, -limit, limit, partial(self._refuse, "value"), partial(self._refuse, "gradient")
        )

    def periods(self) -> Triple | None:
        """Periods along the axes, or None."""
        rates = _wave_rates(self.tree)
        if rates is None or not all(rates):
            return None
        bases = [min(each) for each in rates]
        for each, base in zip(rates, bases, strict=True):
            if any(abs(rate / base - round(rate / base)) > MULTIPLE_TOL for rate in each):
                return None
        return 2 * math.pi / bases[0], 2 * math.pi / bases[1], 2 * math.pi / bases[2]

    def _refuse(self, what: str, _: float, point: Triple) -> InvalidRequest:
        where = ", ".join(f"{t:g}" for t in point)
        return InvalidRequest(
            f"the {what} of {self.formula!r} is not finite at ({where}): keep the domain away from there, or change the "
            "formula (divisions, log, sqrt and fractional powers are limited to part of space)"
        )


@validate_call()
def expression(
    formula: Annotated[
        str,
        TEXT.described_as(example='"sin(x) + 0.2*z"'),
        "Numbers, ``+ - * / **`` (or ``^``), ``pi``, ``e``, the functions ``sin cos tan asin acos atan atan2 sinh "
        "cosh tanh exp log sqrt abs hypot min max``, and coordinates. Angles in radians. Negative values are solid.",
    ],
    period: Annotated[
        float | None,
        POSITIVE,
        "If given, x, y and z stand for 2 pi / period times the coordinate, as in the formulas of the catalogue; X, Y "
        "and Z remain the coordinates in model units. Otherwise x, y, z are model units, too.",
    ] = None,
    **named: Annotated[
        FieldLike, FIELD, 'Further names of the formula: ``expression("max(g, b)", g=gyroid, b=ball)``.'
    ],
) -> ExpressionField:
    """Return the field of a formula of x, y and z.

    Returns
    -------
    ExpressionField
        The field with exact gradient. It is periodic if the formula shows it: sums and products of sine and cosine waves.

    Raises
    ------
    InvalidRequest
        If the formula holds anything else, is too long or too deep; on evaluation, if a value is not finite.

    Examples
    --------
    >>> from tpmscad import fields
    >>> gyroid = fields.expression("sin(x)*cos(y) + sin(y)*cos(z) + sin(z)*cos(x)", period=10)
    >>> bool(abs(gyroid((1.0, 2.0, 3.0)) - fields.tpms("gyroid", 10.0)((1.0, 2.0, 3.0))) < 1e-14)
    True
    """
    rate = 1.0 if period is None else 2 * math.pi / period
    names: dict[str, Field] = {name: ConstantField(value) for name, value in CONSTANTS.items()}
    names |= coordinates_by_name("xyz", rate) | coordinates_by_name("XYZ", 1.0)
    taken = [name for name in named if name in names or name in FUNCTIONS]
    if taken:
        raise InvalidRequest(f"{taken[0]!r} has a meaning in every formula: give the field another name")
    names |= {name: as_field(value) for name, value in named.items()}
    return ExpressionField(formula, read_formula(formula, names))


def coordinates_by_name(letters: str, rate: float) -> dict[str, Field]:
    """The coordinates times a rate, by their letters."""
    slopes = (rate, 0.0, 0.0), (0.0, rate, 0.0), (0.0, 0.0, rate)
    return {name: AffineFunction(slope, 0.0) for name, slope in zip(letters, slopes, strict=True)}


def read_formula(formula: str, names: Mapping[str, Field]) -> Field:
    """The field of a formula of numbers, functions and named fields; InvalidRequest for anything else."""
    if len(formula) > MAX_CHARACTERS:
        raise InvalidRequest(
            f"the formula has {len(formula)} characters, more than {MAX_CHARACTERS}: compose fields instead"
        )
    try:
        root = ast.parse(formula.strip().replace("^", "**"), mode="eval").body
        depth = _depth(root)
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        place = f" at character {error.offset}" if isinstance(error, SyntaxError) and error.offset else ""
        raise InvalidRequest(f"the formula {_shorten(formula)!r} cannot be read{place}: {error.args[0]}") from None
    if depth > MAX_DEPTH:
        raise InvalidRequest(f"the formula nests {depth} deep, more than {MAX_DEPTH}: compose fields instead")
    return _Reader(formula, names).read(root)


def linear_rates(field: Field) -> Triple | None:
    """Derivatives by x, y and z if the field is linear: composed of coordinates, constants, sums and factors."""
    match field:
        case ConstantField():
            return 0.0, 0.0, 0.0
        case AffineFunction(slope):
            return slope
        case ScaledField(inner, factor):
            rates = linear_rates(inner)
            return None if rates is None else (factor * rates[0], factor * rates[1], factor * rates[2])
        case SumField(first, second):
            a, b = linear_rates(first), linear_rates(second)
            return None if a is None or b is None else (a[0] + b[0], a[1] + b[1], a[2] + b[2])
    return None


def _wave_rates(field: Field) -> list[set[float]] | None:
    """Rates (radians per model unit) along x, y and z of the waves that a field is composed of; None if it is not periodic."""
    match field:
        case FunctionOfField("sin" | "cos" | "tan", argument) if (linear := linear_rates(argument)) is not None:
            return [{abs(rate)} - {0.0} for rate in linear]
        case FunctionOfField(_, argument) | PowerField(argument, _) | ScaledField(argument, _):
            return _wave_rates(argument)
        case ConstantField():
            return [set(), set(), set()]
        case BinaryField(first, second):
            a, b = _wave_rates(first), _wave_rates(second)
            return None if a is None or b is None else [p | q for p, q in zip(a, b, strict=True)]
    periods = field.periods()
    return None if periods is None else [{2 * math.pi / p} if p else set() for p in periods]


class _Reader:
    """Converts the nodes of Python's parser to fields, or names what the formula may not hold."""

    def __init__(self, formula: str, names: Mapping[str, Field]) -> None:
        self.formula, self.names = formula, names

    def read(self, node: ast.AST) -> Field:
        """The field of a node."""
        match node:
            case ast.Constant(value=(int() | float()) as value) if not isinstance(value, bool):
                return ConstantField(self._number(value))
            case ast.Name(id=name):
                return self._look_up(name)
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                return -self.read(operand)
            case ast.UnaryOp(op=ast.UAdd(), operand=operand):
                return self.read(operand)
            case ast.BinOp(left=left, op=operator, right=right):
                return self._combine(operator, self.read(left), self.read(right))
            case ast.Call(func=ast.Name(id=name), args=arguments, keywords=[]):
                return self._apply(name, [self.read(argument) for argument in arguments])
        raise InvalidRequest(
            f"{_shorten(ast.unparse(node))!r} may not stand in the formula {_shorten(self.formula)!r}: use numbers, x, y, z, "
            f"+ - * / ** and the functions {', '.join(FUNCTIONS)}, atan2, hypot, min, max"
        )

    def _number(self, value: float) -> float:
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
        if not math.isfinite(number):
            raise InvalidRequest(f"a number of the formula {_shorten(self.formula)!r} is too large")
        return number

    def _look_up(self, name: str) -> Field:
        if name in self.names:
            return self.names[name]
        raise InvalidRequest(f"{name!r} is unknown in the formula {_shorten(self.formula)!r}{self._suggest(name)}")

    def _suggest(self, name: str) -> str:
        if name in FUNCTIONS:
            return f": it is a function, write {name}(x)"
        similar = get_close_matches(name, [*self.names, *FUNCTIONS, "atan2", "hypot", "min", "max"], n=1)
        return f": did you mean {similar[0]!r}?" if similar else f"; known are {', '.join(self.names)}"

    def _combine(self, operator: ast.operator, left: Field, right: Field) -> Field:
        match operator:
            case ast.Add():
                return left + right
            case ast.Sub():
                return left - right
            case ast.Mult():
                return multiply_fields(right, left) if isinstance(left, ConstantField) else left * right
            case ast.Div() if isinstance(right, ConstantField):
                return left / right.value
            case ast.Div():
                return QuotientField(left, right)
            case ast.Pow() if isinstance(right, ConstantField):
                return PowerField(left, right.value)
            case ast.Pow():
                return FunctionOfField("exp", right * FunctionOfField("log", left))
        raise InvalidRequest(
            f"the formula {_shorten(self.formula)!r} holds an operator other than + - * / and ** (or ^)"
        )

    def _apply(self, name: str, arguments: list[Field]) -> Field:
        n = len(arguments)
        if name in FUNCTIONS:
            if n != 1:
                raise InvalidRequest(f"{name} takes one argument, here {n}, in the formula {_shorten(self.formula)!r}")
            return FunctionOfField(name, arguments[0])
        if name in ("min", "max"):
            if n < 2:
                raise InvalidRequest(f"{name} takes two or more arguments in the formula {_shorten(self.formula)!r}")
            sign = 1 if name == "max" else -1
            return reduce(lambda first, other: MinMaxField(first, other, sign), arguments)
        if name == "hypot" and n in (2, 3):
            return FunctionOfField("sqrt", reduce(add, [PowerField(argument, 2.0) for argument in arguments]))
        if name == "atan2" and n == 2:
            return AngleField(arguments[0], arguments[1])
        if name in ("hypot", "atan2"):
            raise InvalidRequest(f"{name} takes two arguments, here {n}, in the formula {_shorten(self.formula)!r}")
        raise InvalidRequest(f"the function {name!r} is unknown in the formula{self._suggest(name)}")


def _depth(root: ast.AST) -> int:
    """Levels of nesting, counted without recursion."""
    level, depth = [root], 0
    while level:
        level, depth = [child for node in level for child in ast.iter_child_nodes(node)], depth + 1
    return depth


def _shorten(text: str) -> str:
    """At most 60 characters of a text, for messages."""
    return text if len(text) <= 60 else f"{text[:57]}..."
