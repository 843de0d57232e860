"""Fields for grading: coordinates, affine functions, ramps between two values and limits, for thresholds that vary in space."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

from tpmscad.api.argument_kinds import AXES, POINT, choice_of
from tpmscad.api.public_calls import validate_call
from tpmscad.api.shared_kinds import DIRECTION, FIELD, FLAG, NUMBER, PAIR
from tpmscad.errors import InvalidRequest
from tpmscad.fields.field import Field, FieldLike, UnaryField, as_field
from tpmscad.fields.kinds.primitive_regions import HalfSpaceRegion
from tpmscad.fields.periods_and_directions import Direction, as_unit_vector
from tpmscad.fields.tape.evaluation import Triple
from tpmscad.fields.tape.tape_nodes import Node, clamp, sum_nodes


@dataclass(frozen=True, slots=True)
class AffineFunction(Field):
    """offset + slope . p."""

    slope: Triple
    offset: float

    def trace(self, x: Node, y: Node, z: Node) -> Node:
        """The formula on the nodes of a tape."""
        terms = [factor * t for factor, t in zip(self.slope, (x, y, z), strict=True) if factor != 0]
        if self.offset or not terms:
            terms.insert(0, x.recorder.constant(self.offset))
        return sum_nodes(terms)


@dataclass(frozen=True, slots=True)
class RampField(Field):
    """`low` where parameter <= start, `high` where parameter >= end, and a transition in t between them.

    The transition is t itself, or 10 t^3 - 15 t^4 + 6 t^5 if `smooth`.
    """

    parameter: Field
    start: float
    end: float
    low: float
    high: float
    smooth: bool

    def trace(self, x: Node, y: Node, z: Node) -> Node:
        """The formula on the nodes of a tape."""
        t = clamp((self.parameter.trace(x, y, z) - self.start) / (self.end - self.start), 0.0, 1.0)
        s = t * t * t * (10.0 + t * (6.0 * t - 15.0)) if self.smooth else t
        return (1.0 - s) * self.low + s * self.high


@dataclass(frozen=True, slots=True)
class ClippedField(UnaryField):
    """A field whose values are limited to [low, high]."""

    low: float
    high: float

    def trace(self, x: Node, y: Node, z: Node) -> Node:
        """The formula on the nodes of a tape."""
        return clamp(self.field.trace(x, y, z), self.low, self.high)


@validate_call()
def linear(
    slope: Annotated[Triple, POINT, "Gradient, per model unit."],
    offset: Annotated[float, NUMBER, "Value at the origin."] = 0.0,
) -> AffineFunction:
    """Return the affine function offset + slope . p.

    Returns
    -------
    AffineFunction
        The field.

    Examples
    --------
    >>> from tpmscad import fields
    >>> float(fields.linear((1, 0, 2), offset=-1.0)((3.0, 0.0, 1.0)))
    4.0
    """
    return AffineFunction(slope, offset)


@validate_call()
def coordinate(
    axis: Annotated[Direction, DIRECTION, '"x", "y", "z", "-x", "-y", "-z" or a vector of any length.'],
    origin: Annotated[Triple, POINT, "Point of distance zero, in model units."] = (0.0, 0.0, 0.0),
) -> HalfSpaceRegion:
    """Return the signed distance from an origin along an axis.

    Returns
    -------
    HalfSpaceRegion
        The field, also the half-space behind the origin.

    Examples
    --------
    >>> from tpmscad import fields
    >>> float(fields.coordinate("z", origin=(0, 0, 5))((1.0, 2.0, 7.0)))
    2.0
    """
    return HalfSpaceRegion(origin, as_unit_vector(axis))


@validate_call()
def clip(
    field: Annotated[FieldLike, FIELD, "The field: a density or a threshold, say."],
    low: Annotated[float, NUMBER, "The least value."],
    high: Annotated[float, NUMBER.described_as(example="0.8"), "The greatest value, above the least one."],
) -> ClippedField:
    """Return a field whose values are limited.

    Returns
    -------
    ClippedField
        The field where it lies between the limits, elsewhere the limit, with its exact gradient, zero beyond the limits.

    Raises
    ------
    InvalidRequest
        If the greatest value is not above the least one.

    Examples
    --------
    >>> from tpmscad import fields
    >>> density = fields.clip(fields.linear((0.1, 0, 0)), 0.2, 0.6)
    >>> density([[0, 0, 0], [3, 0, 0], [9, 0, 0]]).round(6).tolist()
    [0.2, 0.3, 0.6]
    """
    if not low < high:
        raise InvalidRequest(f"the least value {low:g} of clip must be below the greatest, {high:g}")
    return ClippedField(as_field(field), low, high)


@validate_call()
def ramp(
    by: Annotated[
        FieldLike | str,
        choice_of(*AXES).or_else(FIELD).described_as('"x", "y", "z" or a field', '"x"'),
        "The parameter: a coordinate, a distance or any other field.",
    ],
    span: Annotated[
        Sequence[float], PAIR, "Values of the parameter at which the ramp starts and ends; start may exceed end."
    ],
    values: Annotated[Sequence[float], PAIR, "Values of the ramp at the start and the end; constant beyond them."],
    *,
    smooth: Annotated[
        bool, FLAG, "True for a quintic transition with two continuous derivatives, False for a linear one."
    ] = True,
) -> RampField:
    """Return a field that changes from one value to another while a parameter crosses an interval.

    Returns
    -------
    RampField
        The field.

    Raises
    ------
    InvalidRequest
        If the span is empty or a number is not finite.

    Examples
    --------
    >>> from tpmscad import fields
    >>> threshold = fields.ramp("x", (0, 40), (-0.6, 0.2))
    >>> round(float(threshold((20.0, 0.0, 0.0))), 6)
    -0.2
    """
    field = coordinate(by) if isinstance(by, str) else as_field(by)
    (start, end), (low, high) = span, values
    if start == end:
        raise InvalidRequest(f"the span of a ramp is empty: it starts and ends at {start:g}")
    return RampField(field, start, end, low, high, smooth)
