"""Enclosures of splines over boxes: Taylor's formula, with remainders bounded by coefficients of derivatives.

A B-spline lies between its least and greatest coefficient, and so do its derivatives, which are B-splines of differences of the
coefficients (de Boor, A practical guide to splines, 1978, chapter X). Of each box those of the spans that it meets count.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np

from tpmscad._compiled_loops import njit_cached
from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.fields.tape.affine_forms import AffineArithmetic, Form, Range
from tpmscad.fields.tape.field_tape import FieldTape
from tpmscad.fields.tape.tape_nodes import Node, SplineNumbers

JUMP_TOL = 1e-12
"""Difference of two pieces at their knot, relative to the greatest coefficient, from which polynomials jump there."""


TERMS = 20
"""Round-off of a spline's evaluation, in units of the last place of its coefficients: about the terms of three axes."""


@njit_cached
def _bound_coefficients(table, first, last, wx, wy, wz, found):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Least and greatest derivative coefficients with indices from first to last (3, n), into found (2, n).

    A coefficient is the sum of weights, rows of (rows, order + 1), times neighbouring numbers of the table; indices are periodic.
    """
    height, depth, length = table.shape[1], table.shape[2], table.shape[0]
    for box in range(first.shape[1]):
        least, most = np.inf, -np.inf
        for i in range(first[0, box], last[0, box] + 1):
            for j in range(first[1, box], last[1, box] + 1):
                for k in range(first[2, box], last[2, box] + 1):
                    total = 0.0
                    for a in range(wx.shape[1]):
                        plane = table[(i + a) % length]
                        for b in range(wy.shape[1]):
                            line = plane[(j + b) % height]
                            weight = wx[i % len(wx), a] * wy[j % len(wy), b]
                            for c in range(wz.shape[1]):
                                total += weight * wz[k % len(wz), c] * line[(k + c) % depth]
                    least, most = min(least, total), max(most, total)
        found[0, box], found[1, box] = least, most


@dataclass(frozen=True, slots=True, eq=False)
class _Axis:
    """A direction of a spline: its degree, breaks of its spans, and rows of weights for derivatives of order 0, 1, 2.

    Of a periodic axis the breaks are whole numbers of steps of the grid, `rate` to a unit of length, and no knots are kept.
    """

    degree: int
    knots: Array | None
    count: int
    rate: float
    weights: tuple[Array | None, ...]
    smoothness: int

    def find_indices(self, low: Array, high: Array, order: int) -> tuple[IntArray, IntArray]:
        """The first and last coefficient (n,) of a derivative that counts between two arguments."""
        if self.knots is None:
            base = [np.floor(np.clip(t * self.rate, -1e15, 1e15)).astype(np.int64) for t in (low, high)]
            many = base[1] - base[0] >= self.count
            first, last = base[0] - 1, base[1] + 2 - order
            return np.where(many, 0, first), np.where(many, self.count - 1, last)
        spans = [
            np.clip(np.searchsorted(self.knots, t, side=side) - 1, self.degree, self.count - 1)  # type: ignore[call-overload]
            for t, side in ((low, "left"), (high, "right"))
        ]
        return np.maximum(spans[0] - self.degree, 0), spans[1] - order

    def meets_one_span(self, low: Array, high: Array) -> BoolArray:
        """Whether no break lies between two arguments (n,)."""
        first, last = self.find_indices(low, high, 0)
        return np.asarray(last - first == self.degree)

    def clip(self, low: Array, high: Array) -> tuple[Array, Array]:
        """The arguments within the knots."""
        if self.knots is None:
            return low, high
        ends = self.knots[self.degree], self.knots[self.count]
        return np.clip(low, *ends), np.clip(high, *ends)


@dataclass(frozen=True, slots=True, eq=False)
class SplineEnclosure:
    """A tensor-product spline, its evaluation at points, and its axes."""

    points: FieldTape
    coefficients: Array
    axes: tuple[_Axis, _Axis, _Axis]

    @property
    def is_continuous(self) -> bool:
        """Whether the spline does not jump at a knot."""
        return min(axis.smoothness for axis in self.axes) >= 0

    def bound(self, lows: Sequence[Array], highs: Sequence[Array], orders: Sequence[int]) -> Range:
        """The range (n,) of a derivative between arguments."""
        weights = [axis.weights[order] for axis, order in zip(self.axes, orders, strict=True)]
        n = len(lows[0])
        if any(w is None for w in weights):
            return np.zeros(n), np.zeros(n)
        indices = [
            axis.find_indices(low, high, order)
            for axis, low, high, order in zip(self.axes, lows, highs, orders, strict=True)
        ]
        found = np.empty((2, n))
        first, last = (np.stack([pair[k] for pair in indices]) for k in (0, 1))
        _bound_coefficients(self.coefficients, first, last, *weights, found)
        return found[0], found[1]

    def enclose(self, boxes: AffineArithmetic, arguments: Sequence[Form], output: int) -> Form:
        """The value (output 0) or a derivative (1 to 3) at arguments."""
        n = boxes.half.shape[1]
        parts = [axis.clip(a.low, a.high) for axis, a in zip(self.axes, arguments, strict=True)]
        lows = [np.ascontiguousarray(np.broadcast_to(low, n)) for low, _ in parts]
        highs = [np.ascontiguousarray(np.broadcast_to(high, n)) for _, high in parts]
        usable = np.all([np.isfinite(low) & np.isfinite(high) for low, high in zip(lows, highs, strict=True)], axis=0)
        middles = [np.where(usable, 0.5 * low + 0.5 * high, 0.0) for low, high in zip(lows, highs, strict=True)]
        around = [
            np.where(usable, np.maximum(h - m, m - low), np.inf) for low, h, m in zip(lows, highs, middles, strict=True)
        ]
        orders = [0, 0, 0] if output == 0 else [int(k == output - 1) for k in range(3)]
        between = self.bound(lows, highs, orders)
        # within one span of an axis the spline is as smooth as a polynomial
        smooth = np.min(
            [
                np.where(axis.meets_one_span(low, high), 2, axis.smoothness - order)
                for axis, low, high, order in zip(self.axes, lows, highs, orders, strict=True)
            ],
            axis=0,
        )
        value, gradient = self.points.jets_at(np.stack(middles, axis=1))
        value = value if output == 0 else gradient[:, output - 1]
        ranges = [self.bound(lows, highs, [o + int(k == j) for k, o in enumerate(orders)]) for j in range(3)]
        rates = np.stack([0.5 * (a + b) for a, b in ranges])
        high = np.sum([0.5 * (b - a) * r for (a, b), r in zip(ranges, around, strict=True)], axis=0)
        low = -high
        if output == 0 and (smooth >= 1).any():
            rates = np.where(smooth >= 1, gradient.T, rates)
            curved = self._bound_curvature(lows, highs, around)
            low, high = np.where(smooth >= 1, curved[0], low), np.where(smooth >= 1, curved[1], high)
        high = np.where(smooth < 0, np.inf, high)
        moved = [r * (a.center - m) for r, a, m in zip(rates, arguments, middles, strict=True)]
        center = value + np.sum(moved, axis=0) + 0.5 * (low + high)
        slope = np.sum([r * a.slope for r, a in zip(rates, arguments, strict=True)], axis=0)
        remainder = np.sum([np.abs(r) * a.remainder for r, a in zip(rates, arguments, strict=True)], axis=0)
        reach = np.sum([np.abs(r) * boxes.reach(a) for r, a in zip(rates, arguments, strict=True)], axis=0)
        # evaluation sums terms as large as the coefficients, times the weights of differences where it is of a derivative
        most = np.max(np.abs(between if output == 0 else self.bound(lows, highs, (0, 0, 0))), axis=0)
        weights = np.array([_greatest_sum(axis.weights[1]) for axis in self.axes])
        own = TERMS * most * (1.0 if output == 0 else weights[output - 1])
        scale = own + reach + np.abs(low) + np.abs(high) + TERMS * most * (weights @ np.array(around))
        margin = np.finfo(float).eps * own
        return boxes.widen(
            center, slope, remainder + 0.5 * (high - low), scale, (between[0] - margin, between[1] + margin)
        )

    def _bound_curvature(self, lows: Sequence[Array], highs: Sequence[Array], around: Sequence[Array]) -> Range:
        """The range (n,) of the terms of second order in Taylor's formula."""
        low = high = np.zeros(len(lows[0]))
        for i, j in combinations_with_replacement(range(3), 2):
            second = self.bound(lows, highs, [int(k == i) + int(k == j) for k in range(3)])
            square = around[i] * around[j]
            if i == j:
                low, high = low + np.minimum(second[0], 0) * square / 2, high + np.maximum(second[1], 0) * square / 2
            else:
                most = np.maximum(np.abs(second[0]), np.abs(second[1])) * square
                low, high = low - most, high + most
        return low, high


def make_spline_enclosure(name: str, numbers: SplineNumbers) -> SplineEnclosure:
    """The enclosure of a spline as a tape records it (`tape_nodes.tensor_spline`, `periodic_spline`)."""
    head = numbers.head
    if name == "tensor":
        degrees, counts = head[:3].astype(int), head[3:6].astype(int)
        knots = np.split(head[6:], np.cumsum(degrees + counts + 1)[:2])
        x, y, z = (_make_axis(t, int(p)) for t, p in zip(knots, degrees, strict=True))
    else:
        x, y, z = (
            _Axis(3, None, int(n), float(r), tuple(np.array([w]) * r**k for k, w in enumerate(DIFFERENCES)), 2)
            for n, r in zip(head[:3], head[3:6], strict=True)
        )
    points = FieldTape(_RecordedSpline(name, numbers))
    return SplineEnclosure(points, np.ascontiguousarray(numbers.coefficients, float), (x, y, z))


def _greatest_sum(weights: Array | None) -> float:
    """The greatest sum of absolute weights of a difference."""
    return 0.0 if weights is None else float(np.abs(weights).sum(axis=1).max())


DIFFERENCES = ([1.0], [-1.0, 1.0], [1.0, -2.0, 1.0])
"""Of coefficients on a uniform grid, of orders 0, 1 and 2."""


@dataclass(frozen=True, slots=True, eq=False)
class _RecordedSpline:
    """A spline as a formula of its arguments."""

    name: str
    numbers: SplineNumbers

    def trace(self, x: Node, y: Node, z: Node) -> Node:
        """The operation on a tape."""
        return x.recorder.record(self.name, (x, y, z), self.numbers)


def _make_axis(knots: Array, degree: int) -> _Axis:
    count = len(knots) - degree - 1
    knots = np.asarray(knots, float)
    inner = knots[(knots > knots[degree]) & (knots < knots[count])]
    multiplicity = int(np.unique(inner, return_counts=True)[1].max()) if len(inner) else 0
    weights: list[Array | None] = [np.ones((count, 1))]
    for order in (1, 2):
        before, q, t = weights[-1], degree - order + 1, knots[order - 1 : len(knots) - order + 1]
        if before is None or q < 1:
            weights.append(None)  # a derivative that is zero
            continue
        width = t[q + 1 : -1] - t[1 : -q - 1]
        factor = np.divide(q, width, out=np.zeros_like(width), where=width > 0)
        # neighbours differ by one place
        weights.append(factor[:, None] * (np.pad(before[1:], ((0, 0), (1, 0))) - np.pad(before[:-1], ((0, 0), (0, 1)))))
    return _Axis(degree, knots, count, 1.0, tuple(weights), degree - multiplicity if multiplicity else 2)


def enclose_polynomials(
    boxes: AffineArithmetic, knots: Array, polynomials: Array, a: Form, output: int
) -> tuple[Form, bool]:
    """Piecewise polynomials (pieces, order), or their slopes (output 1), as a tape records them; whether they are continuous.

    Taylor's formula within one piece; the hull of all pieces where a box meets several.
    """
    if output:
        order = polynomials.shape[1]
        polynomials = polynomials[:, :-1] * np.arange(order - 1, 0, -1) if order > 1 else np.zeros_like(polynomials)
    point = boxes.expansion_point(a)
    first, last = (np.searchsorted(knots[1:-1], t, side="right") for t in (a.low, a.high))
    least, most, scale = np.full_like(point, np.inf), np.full_like(point, -np.inf), np.zeros_like(point)
    for step in range(int((last - first).max(initial=0)) + 1):
        piece = np.minimum(first + step, last)
        low = np.where(step == 0, a.low, np.maximum(a.low, knots[piece]))
        high = np.where(piece == last, a.high, np.minimum(a.high, knots[piece + 1]))
        terms = _shift_polynomials(polynomials[piece], 0.5 * low + 0.5 * high - knots[piece])
        between = _bound_polynomial(terms, 0.5 * high - 0.5 * low)
        least, most = np.fmin(least, between[0]), np.fmax(most, between[1])
        least, most = (np.where(np.isnan(between[0] + between[1]), s * np.inf, t) for s, t in ((-1, least), (1, most)))
        scale = np.fmax(
            scale, _scale_of(polynomials[piece], np.maximum(np.abs(low - knots[piece]), np.abs(high - knots[piece])))
        )
    margin = 8 * np.finfo(float).eps * scale
    own = least - margin, most + margin
    terms = _shift_polynomials(polynomials[first], point - knots[first])
    around = np.maximum(a.high - point, point - a.low)
    second = _bound_polynomial([t * k * (k - 1) for k, t in enumerate(terms)][2:] or [np.zeros_like(point)], around)
    several = first < last
    bend = np.where(several, -np.inf, second[0]), np.where(several, np.inf, second[1])
    rate = terms[1] if len(terms) > 1 else np.zeros_like(point)
    found = boxes.apply(a, terms[0], rate, bend, own)
    found = boxes.widen(found.center, found.slope, found.remainder, scale, (found.low, found.high))
    return found, _is_continuous(knots, polynomials)


def _shift_polynomials(polynomials: Array, by: Array) -> list[Array]:
    """Coefficients, the lowest power first, about another origin (n,), of polynomials (n, order), the highest power first."""
    terms = list(polynomials.T)
    found = []
    while terms:
        for k in range(1, len(terms)):
            terms[k] = terms[k] + terms[k - 1] * by
        found.append(terms.pop())
    return found


def _bound_polynomial(terms: Sequence[Array], around: Array) -> Range:
    """The range of a polynomial within +-around."""
    low = high = np.asarray(terms[0])
    for k, t in enumerate(terms[1:], 1):
        size = np.where(t == 0, 0.0, t * around**k)
        low = low + (np.minimum(size, 0) if k % 2 == 0 else -np.abs(size))
        high = high + (np.maximum(size, 0) if k % 2 == 0 else np.abs(size))
    return low, high


def _scale_of(polynomials: Array, reach: Array) -> Array:
    """The sum of the absolute terms."""
    total = np.zeros_like(reach)
    for column in polynomials.T:
        total = np.where(total == 0, 0.0, total * reach) + np.abs(column)
    return total


def _is_continuous(knots: Array, polynomials: Array) -> bool:
    """Whether each polynomial ends where the next one begins."""
    if len(polynomials) < 2:
        return True
    width = np.diff(knots)[:-1]
    ends = _shift_polynomials(polynomials[:-1], width)[0]
    sizes = _scale_of(polynomials[:-1], np.abs(width))
    return bool((np.abs(ends - polynomials[1:, -1]) <= JUMP_TOL * np.maximum(sizes, np.abs(polynomials[1:, -1]))).all())
