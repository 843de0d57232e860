"""The interpreter of tapes for boxes: enclosures of values and gradients, conservative to round-off.

It runs the recorded operations, derivatives included, on affine forms (`affine_forms`) over many boxes at once. Where a mask is
undecided in a box, both branches are united, so that the gradient encloses those on either side of a crease. Splines are bounded
by their coefficients (`spline_enclosures`). Foreign functions, which no tape holds, may have any value.

A value may jump where a mask that is undecided chooses between unlike values; extremes, which choose the greater or less of two,
are continuous. `JetEnclosures.may_jump` tells the boxes where nothing but this is known, as the theorem of the mean value
needs continuity.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, BoolArray
from tpmscad.fields.tape.affine_forms import ROUND_OFF, AffineArithmetic, Form, Range, power_range, product_range
from tpmscad.fields.tape.field_tape import FieldTape
from tpmscad.fields.tape.spline_enclosures import SplineEnclosure, enclose_polynomials, make_spline_enclosure
from tpmscad.fields.tape.tape_nodes import Node, SplineNumbers, find_ancestors, resolve_alias

MAX_BOXES = 4096
"""Boxes evaluated at a time: a form has 56 bytes a box, so that the forms of a formula stay in the cache."""

ANGLE_ROUND_OFF = 1e-14
"""Relative to 1 + |angle|: uncertainty of the place of a sine's extremes."""

MAX_TANGENT = 1e9
"""Tangent beyond which a pole may lie within round-off of the angle."""

ATAN_BEND, TANH_BEND = 0.65, 0.77
"""Above the greatest second derivatives of the arc tangent, 3 sqrt(3) / 8, and of the hyperbolic tangent, 4 / (3 sqrt(3))."""


@dataclass(frozen=True, slots=True, eq=False)
class JetEnclosures:
    """Enclosures over n boxes: of the value, of the derivatives if asked for, and whether the value may jump (n,)."""

    value: Form
    gradient: tuple[Form, ...]
    may_jump: BoolArray

    @property
    def gradient_ranges(self) -> Range:
        """Lower and upper bounds (3, n) of the derivatives."""
        return np.stack([g.low for g in self.gradient]), np.stack([g.high for g in self.gradient])


class TapeEnclosures:
    """A field's tape, run on boxes."""

    def __init__(self, tape: FieldTape) -> None:
        self._tape = tape
        self._splines: dict[int, SplineEnclosure] = {}
        self._plans: dict[bool, tuple[list[Node], list[Node], dict[int, int]]] = {}
        value = resolve_alias(tape.value)
        self._value_nodes = {node.index for node in _list_nodes([value])}
        self._chooses_extremes = _find_extreme_masks(_list_nodes([value]))

    def enclose(self, lo: Array, hi: Array, with_gradient: bool) -> JetEnclosures:
        """Enclosures over boxes with corners lo, hi (n, 3)."""
        if not len(lo):
            lo, hi = np.zeros((0, 3)), np.zeros((0, 3))
        parts = [
            self._enclose_batch(lo[i : i + MAX_BOXES].T, hi[i : i + MAX_BOXES].T, with_gradient)
            for i in range(0, max(1, len(lo)), MAX_BOXES)
        ]
        if len(parts) == 1:
            return parts[0]
        gradient = tuple(_join([part.gradient[k] for part in parts]) for k in range(len(parts[0].gradient)))
        return JetEnclosures(
            _join([part.value for part in parts]), gradient, np.concatenate([part.may_jump for part in parts])
        )

    def _enclose_batch(self, lo: Array, hi: Array, with_gradient: bool) -> JetEnclosures:
        outputs, nodes, last_use = self._plan(with_gradient)
        run = _Run(self, AffineArithmetic(lo, hi))
        forms: dict[int, Form] = {}
        with np.errstate(all="ignore"):
            for at, node in enumerate(nodes):
                operands = [resolve_alias(arg) for arg in node.args]
                forms[node.index] = run.operate(node, operands, [forms[each.index] for each in operands])
                for each in operands:
                    if last_use[each.index] == at:
                        forms.pop(each.index, None)
        count = lo.shape[1]
        value, *gradient = (_broadcast(forms[node.index], count) for node in outputs)
        return JetEnclosures(value, tuple(gradient), run.may_jump)

    def _plan(self, with_gradient: bool) -> tuple[list[Node], list[Node], dict[int, int]]:
        """The outputs, all nodes in order, and the position of each node's last use."""
        if with_gradient not in self._plans:
            outputs = self._tape.evaluator(with_gradient).outputs
            nodes = _list_nodes(outputs)
            last_use = {resolve_alias(arg).index: at for at, node in enumerate(nodes) for arg in node.args}
            last_use |= {node.index: len(nodes) for node in outputs}
            self._plans[with_gradient] = outputs, nodes, last_use
        return self._plans[with_gradient]

    def spline_of(self, node: Node) -> SplineEnclosure:
        """The bounds of a spline, made once for all results of the node's operation."""
        assert isinstance(node.numbers, SplineNumbers)
        key = id(node.numbers.coefficients), node.numbers.head.tobytes()
        number = hash(key)
        if number not in self._splines:
            self._splines[number] = make_spline_enclosure(node.name, node.numbers)
        return self._splines[number]

    def may_jump_by(self, node: Node) -> bool:
        """Whether the value may jump where this mask is undecided."""
        return node.index in self._value_nodes and node.index not in self._chooses_extremes


class _Run:
    """One run over a batch of boxes."""

    def __init__(self, tape: TapeEnclosures, boxes: AffineArithmetic) -> None:
        self.tape, self.boxes = tape, boxes
        self.may_jump = np.zeros(boxes.half.shape[1], bool)

    def operate(self, node: Node, operands: Sequence[Node], forms: Sequence[Form]) -> Form:
        """The enclosure of an operation's result."""
        boxes = self.boxes
        match node.name:
            case "coordinate":
                return boxes.coordinate(int(node.numbers[0]))
            case "constant":
                return boxes.constant(float(node.numbers[0]))
            case "check":
                return forms[0]
            case "scale":
                return boxes.scale(forms[0], float(node.numbers[0]))
            case "shift":
                return boxes.add(forms[0], boxes.constant(float(node.numbers[0])))
            case "add":
                return boxes.add(forms[0], forms[1])
            case "subtract":
                return boxes.add(forms[0], forms[1], -1.0)
            case "multiply" | "chain":
                return boxes.multiply(forms[0], forms[1])
            case "divide":
                return boxes.multiply(forms[0], boxes.invert(forms[1]))
            case "at_least" | "greater":
                return self._compare(node, *forms)
            case "select":
                return self._select(operands, *forms)
            case "piecewise":
                return self._piecewise(node, forms[0])
            case "tensor" | "periodic_spline":
                spline = self.tape.spline_of(node)
                if not spline.is_continuous and node.index in self.tape._value_nodes:
                    self.may_jump[:] = True
                return spline.enclose(boxes, forms, node.output)
            case "angle":
                return self._angle(node, *forms)
            case "input":
                ends = np.full(1, -np.inf), np.full(1, np.inf)
                if node.index in self.tape._value_nodes:
                    self.may_jump[:] = True
                return boxes.from_range(ends)
        return self._function(node, forms[0])

    def _compare(self, node: Node, a: Form, b: Form) -> Form:
        difference = self.boxes.add(a, b, -1.0)
        if node.name == "at_least":
            holds = (difference.low >= 0) | (a.low >= b.high)
            fails = (difference.high < 0) | (a.high < b.low)
        else:
            holds = (difference.low > 0) | (a.low > b.high)
            fails = (difference.high <= 0) | (a.high <= b.low)
        holds, fails = np.broadcast_arrays(holds, fails)
        if self.tape.may_jump_by(node):
            self.may_jump |= ~(holds | fails)
        low, high = holds.astype(float), 1.0 - fails.astype(float)
        half = 0.5 * (high - low)
        return Form(0.5 * (low + high), np.zeros((3, len(low))), half, low, high)

    def _select(self, operands: Sequence[Node], mask: Form, yes: Form, no: Form) -> Form:
        holds, fails = (mask.low > 0) | (mask.high < 0), (mask.low == 0) & (mask.high == 0)
        if np.all(holds):
            return yes
        if np.all(fails):
            return no
        between = None
        sign = _extreme_sign(*operands)
        if sign > 0:
            between = np.maximum(yes.low, no.low), np.maximum(yes.high, no.high)
        elif sign < 0:
            between = np.minimum(yes.low, no.low), np.minimum(yes.high, no.high)
        both = self.boxes.unite(yes, no, between)
        return self.boxes.choose(holds, yes, self.boxes.choose(fails, no, both))

    def _piecewise(self, node: Node, a: Form) -> Form:
        numbers = np.asarray(node.numbers)
        pieces, order = numbers[:2].astype(int)
        knots, coefficients = np.split(numbers[2:], [pieces + 1])
        found, is_continuous = enclose_polynomials(
            self.boxes, knots, coefficients.reshape(pieces, order), a, node.output
        )
        if not is_continuous and node.index in self.tape._value_nodes:
            self.may_jump[:] = True
        return found

    def _angle(self, node: Node, s: Form, c: Form) -> Form:
        """atan2(s, c): the theorem of the mean value, but for boxes that its cut or centre touches."""
        square = self.boxes.add(self.boxes.multiply(s, s), self.boxes.multiply(c, c))
        cut = (c.low <= 0) & (s.low <= 0) & (s.high >= 0)
        if node.index in self.tape._value_nodes:
            self.may_jump |= np.broadcast_to(cut, self.may_jump.shape)
        corners = np.stack([np.arctan2(y, x) for y in (s.low, s.high) for x in (c.low, c.high)])
        low, high = np.where(cut, -math.pi, corners.min(axis=0)), np.where(cut, math.pi, corners.max(axis=0))
        reciprocal = self.boxes.invert(square)
        by_s, by_c = (product_range(f, reciprocal) for f in (c, self.boxes.scale(s, -1.0)))
        ms, mc = self.boxes.expansion_point(s), self.boxes.expansion_point(c)
        s_rate, c_rate = 0.5 * (by_s[0] + by_s[1]), 0.5 * (by_c[0] + by_c[1])
        center = np.arctan2(ms, mc) + s_rate * (s.center - ms) + c_rate * (c.center - mc)
        remainder = (
            np.abs(s_rate) * s.remainder
            + np.abs(c_rate) * c.remainder
            + 0.5 * (by_s[1] - by_s[0]) * np.maximum(s.high - ms, ms - s.low)
            + 0.5 * (by_c[1] - by_c[0]) * np.maximum(c.high - mc, mc - c.low)
        )
        scale = 4.0 + np.abs(s_rate) * self.boxes.reach(s) + np.abs(c_rate) * self.boxes.reach(c)
        slope = s_rate * s.slope + c_rate * c.slope
        remainder = np.where(cut, np.inf, remainder)
        return self.boxes.widen(center, slope, remainder, scale, (low, high))

    def _function(self, node: Node, a: Form) -> Form:
        """A function of one argument, by its derivatives, on the part of the range in its domain."""
        first, last = _find_domain(node)
        a = Form(a.center, a.slope, a.remainder, np.clip(a.low, first, last), np.clip(a.high, first, last))
        low, high, x = a.low, a.high, self.boxes.expansion_point(a)
        match node.name:
            case "absolute":
                return self._absolute(a)
            case "root":
                value = np.sqrt(x)
                second = -0.25 * low**-1.5, -0.25 * high**-1.5
                return self.boxes.apply(a, value, 0.5 / value, second, (np.sqrt(low), np.sqrt(high)))
            case "sine_cosine":
                sine, cosine = _sine_range(low, high), _sine_range(low + 0.5 * math.pi, high + 0.5 * math.pi)
                own, value, rate = (cosine, np.cos(x), -np.sin(x)) if node.output else (sine, np.sin(x), np.cos(x))
                # the value is known to a rounding of 1, not of itself
                found = self.boxes.apply(a, value, rate, (-own[1], -own[0]), own)
                ends = found.low - ROUND_OFF, found.high + ROUND_OFF
                return self.boxes.widen(found.center, found.slope, found.remainder, np.ones_like(x), ends)
            case "tan":
                turns = np.floor(low / math.pi + 0.5) != np.floor(high / math.pi + 0.5)
                value, ends = np.tan(x), [np.tan(low), np.tan(high)]
                pole = turns | (np.maximum(*np.abs(ends)) > MAX_TANGENT)
                own = np.where(pole, -np.inf, ends[0]), np.where(pole, np.inf, ends[1])
                second = 2 * own[0] * (1 + own[0] ** 2), 2 * own[1] * (1 + own[1] ** 2)
                return self.boxes.apply(a, value, 1 + value * value, second, own)
            case "asin":
                return self.boxes.apply(
                    a, np.arcsin(x), 1 / np.sqrt(1 - x * x), _asin_bend(low, high), (np.arcsin(low), np.arcsin(high))
                )
            case "acos":
                bend, own = _asin_bend(low, high), (np.arccos(high), np.arccos(low))
                return self.boxes.apply(a, np.arccos(x), -1 / np.sqrt(1 - x * x), (-bend[1], -bend[0]), own)
            case "atan":
                bend = np.full_like(x, -ATAN_BEND), np.full_like(x, ATAN_BEND)
                return self.boxes.apply(a, np.arctan(x), 1 / (1 + x * x), bend, (np.arctan(low), np.arctan(high)))
            case "sinh":
                own = np.sinh(low), np.sinh(high)
                return self.boxes.apply(a, np.sinh(x), np.cosh(x), own, own)
            case "cosh":
                ends = [np.cosh(low), np.cosh(high)]
                own = np.where((low <= 0) & (high >= 0), 1.0, np.minimum(*ends)), np.maximum(*ends)
                return self.boxes.apply(a, np.cosh(x), np.sinh(x), own, own)
            case "tanh":
                value, bend = np.tanh(x), (np.full_like(x, -TANH_BEND), np.full_like(x, TANH_BEND))
                return self.boxes.apply(a, value, 1 - value * value, bend, (np.tanh(low), np.tanh(high)))
            case "exp":
                own = np.exp(low), np.exp(high)
                return self.boxes.apply(a, np.exp(x), np.exp(x), own, own)
            case "log":
                return self.boxes.apply(a, np.log(x), 1 / x, (-1 / low**2, -1 / high**2), (np.log(low), np.log(high)))
            case "power":
                p = float(node.numbers[0])
                bends = [p * (p - 1) * t for t in power_range(low, high, p - 2)]
                second = np.minimum(*bends), np.maximum(*bends)
                return self.boxes.apply(a, np.power(x, p), p * np.power(x, p - 1), second, power_range(low, high, p))
        raise NotImplementedError(f"no enclosure is known of the operation {node.name}")

    def _absolute(self, a: Form) -> Form:
        negative = self.boxes.scale(a, -1.0)
        most = np.maximum(-a.low, a.high)
        both = self.boxes.unite(a, negative, (np.zeros_like(most), most))
        return self.boxes.choose(a.low >= 0, a, self.boxes.choose(a.high <= 0, negative, both))


def _find_domain(node: Node) -> tuple[float, float]:
    """Where a function is defined."""
    if node.name in ("root", "log") or (node.name == "power" and node.numbers[0] != int(node.numbers[0])):
        return 0.0, math.inf
    return (-1.0, 1.0) if node.name in ("asin", "acos") else (-math.inf, math.inf)


def _asin_bend(low: Array, high: Array) -> Range:
    """The range of the second derivative of the arc sine, which increases."""
    return low / (1 - low * low) ** 1.5, high / (1 - high * high) ** 1.5


def _sine_range(low: Array, high: Array) -> Range:
    """The range of the sine."""
    first, last = low - ANGLE_ROUND_OFF * (1 + np.abs(low)), high + ANGLE_ROUND_OFF * (1 + np.abs(high))
    top = np.ceil((first - 0.5 * math.pi) / (2 * math.pi)) <= np.floor((last - 0.5 * math.pi) / (2 * math.pi))
    bottom = np.ceil((first + 0.5 * math.pi) / (2 * math.pi)) <= np.floor((last + 0.5 * math.pi) / (2 * math.pi))
    unknown = ~(np.abs(first) + np.abs(last) < np.inf)
    ends = np.sin(low), np.sin(high)
    margin = ANGLE_ROUND_OFF * (1 + np.abs(low) + np.abs(high))  # of the quarter turn added for the cosine, too
    return (
        np.where(unknown, -np.inf, np.where(bottom, -1.0, np.minimum(*ends) - margin)),
        np.where(unknown, np.inf, np.where(top, 1.0, np.maximum(*ends) + margin)),
    )


def _extreme_sign(mask: Node, yes: Node, no: Node) -> int:
    """+1 for the maximum of two nodes, -1 for the minimum, 0 for other choices."""
    if mask.name not in ("at_least", "greater"):
        return 0
    first, second = (resolve_alias(arg) for arg in mask.args)
    if first is yes and second is no:
        return 1
    return -1 if first is no and second is yes else 0


def _find_extreme_masks(nodes: Sequence[Node]) -> set[int]:
    """Masks that choose the greater or less of what they compare, and nothing else."""
    good: set[int] = set()
    bad: set[int] = set()
    for node in nodes:
        operands = [resolve_alias(arg) for arg in node.args]
        if node.name == "select" and _extreme_sign(*operands):
            good.add(operands[0].index)
            operands = operands[1:]
        bad |= {each.index for each in operands if each.name in ("at_least", "greater")}
    return good - bad


def _list_nodes(outputs: Sequence[Node]) -> list[Node]:
    """The outputs and what they are computed from, in order, without the masks of blocks and of checks."""
    return find_ancestors(outputs, (), lambda node: [resolve_alias(arg) for arg in node.args])


def _broadcast(form: Form, count: int) -> Form:
    return Form(
        np.broadcast_to(form.center, count),
        np.broadcast_to(form.slope, (3, count)),
        np.broadcast_to(form.remainder, count),
        np.broadcast_to(form.low, count),
        np.broadcast_to(form.high, count),
    )


def _join(forms: Sequence[Form]) -> Form:
    return Form(
        np.concatenate([f.center for f in forms]),
        np.concatenate([f.slope for f in forms], axis=1),
        np.concatenate([f.remainder for f in forms]),
        np.concatenate([f.low for f in forms]),
        np.concatenate([f.high for f in forms]),
    )
