"""Affine forms: enclosures of a value over many boxes at once, conservative to round-off.

Over a box with centre m and half-widths h, a form says value(m + d) = center + slope . d + e with |e| <= remainder, for all
|d| <= h, and besides that low <= value <= high. Affine functions are enclosed exactly, smooth ones with remainders of second
order in h (Stolfi and de Figueiredo, Self-validated numerical methods and applications, 1997); a plain interval, slope 0, takes
over where that is narrower, as at the tip of a root. Points at which an operation is undefined or overflows are promised nothing.

Every operation widens its result by ROUND_OFF of the terms from which it was made, so that the enclosure holds for the
function of real numbers and for its evaluation in floating point.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, BoolArray

ROUND_OFF = 16 * np.finfo(float).eps
"""Relative widening of an operation: several roundings of the form's parts, and those of the operation at points."""

TINY = 1e-290
"""Absolute widening, above the products that underflow."""

TWO = np.full(1, 2.0)

Range = tuple[Array, Array]
"""Lower and upper bounds (n,)."""


@dataclass(frozen=True, slots=True, eq=False)
class Form:
    """Enclosures over n boxes: arrays (n,), the slope (3, n), or of length 1 where all boxes have the same."""

    center: Array
    slope: Array
    remainder: Array
    low: Array
    high: Array


class AffineArithmetic:
    """Operations on forms over boxes with centres and half-widths (3, n)."""

    def __init__(self, lo: Array, hi: Array) -> None:
        """Boxes with corners (3, n)."""
        self.lo, self.hi = lo, hi
        self.center = 0.5 * lo + 0.5 * hi
        self.half = np.maximum(hi - self.center, self.center - lo) * (1 + ROUND_OFF)

    def coordinate(self, axis: int) -> Form:
        """A coordinate, which is known exactly."""
        slope = np.zeros((3, 1))
        slope[axis] = 1.0
        center = self.center[axis]
        return Form(
            center, np.broadcast_to(slope, self.half.shape), np.zeros_like(center), self.lo[axis], self.hi[axis]
        )

    @staticmethod
    def constant(value: float) -> Form:
        """A constant."""
        one = np.full(1, value)
        return Form(one, np.zeros((3, 1)), np.zeros(1), one, one)

    def spread(self, a: Form) -> Array:
        """The greatest |value - center| (n,) by slope and remainder."""
        return np.asarray((np.abs(a.slope) * self.half).sum(axis=0) + a.remainder)

    def reach(self, a: Form) -> Array:
        """A bound (n,) of |center| and of all terms of the form."""
        return np.asarray(np.abs(a.center) + self.spread(a))

    def widen(self, center: Array, slope: Array, remainder: Array, scale: Array, between: Range | None = None) -> Form:
        """The form with round-off of terms of this scale added, narrowed to what is known of its range."""
        remainder = remainder + (ROUND_OFF * scale + TINY)
        radius = (np.abs(slope) * self.half).sum(axis=0) + remainder
        low, high = center - radius * (1 + ROUND_OFF), center + radius * (1 + ROUND_OFF)
        unknown = ~(np.isfinite(low) & np.isfinite(high))  # an infinite term, or none: a product of 0 and infinity
        low, high = np.where(unknown, -np.inf, low), np.where(unknown, np.inf, high)
        if between is not None:
            first, last = between
            first = np.where(np.isnan(first), -np.inf, first - ROUND_OFF * np.abs(first) - TINY)
            last = np.where(np.isnan(last), np.inf, last + ROUND_OFF * np.abs(last) + TINY)
            low, high = np.maximum(low, first), np.minimum(high, last)
            empty = low > high  # of points at which nothing is defined
            low, high = np.where(empty, -np.inf, low), np.where(empty, np.inf, high)
        half = 0.5 * high - 0.5 * low
        plain = unknown | ~(remainder <= half)
        middle = np.where(np.isfinite(half), 0.5 * low + 0.5 * high, 0.0)
        around = np.where(np.isfinite(half), half + ROUND_OFF * (np.abs(middle) + half) + TINY, np.inf)
        return Form(
            np.where(plain, middle, center),
            np.where(plain, 0.0, slope),
            np.where(plain, around, remainder),
            low,
            high,
        )

    def from_range(self, between: Range) -> Form:
        """A form of which only the range is known."""
        zero = np.zeros_like(between[0])
        return self.widen(zero, np.zeros((3, 1)), np.full_like(zero, np.inf), zero, between)

    def add(self, a: Form, b: Form, sign: float = 1.0) -> Form:
        """The sum a + sign * b; equal affine functions cancel exactly."""
        low, high = (b.low, b.high) if sign > 0 else (b.high, b.low)
        scale = self.reach(a) + self.reach(b)
        if sign < 0:
            equal = (a.center == b.center) & (a.slope == b.slope).all(axis=0) & (a.remainder + b.remainder == 0)
            found = self.widen(
                a.center - b.center, a.slope - b.slope, a.remainder + b.remainder, scale, (a.low - low, a.high - high)
            )
            return self.choose(equal, self.constant(0.0), found)
        return self.widen(
            a.center + b.center, a.slope + b.slope, a.remainder + b.remainder, scale, (a.low + low, a.high + high)
        )

    def scale(self, a: Form, factor: float) -> Form:
        """Factor * a."""
        if factor == 0.0:
            return self.constant(0.0)
        ends = factor * a.low, factor * a.high
        return self.widen(
            factor * a.center,
            factor * a.slope,
            abs(factor) * a.remainder,
            abs(factor) * self.reach(a),
            ends if factor > 0 else ends[::-1],
        )

    def multiply(self, a: Form, b: Form) -> Form:
        """The product a * b, a square if both are one form."""
        if a is b:
            point = self.expansion_point(a)
            return self.apply(a, point * point, 2 * point, (TWO, TWO), power_range(a.low, a.high, 2.0))
        sides_a, sides_b = (np.abs(f.slope) * self.half for f in (a, b))
        linear_a, linear_b = sides_a.sum(axis=0), sides_b.sum(axis=0)
        # the squares of each coordinate have one sign: half of them moves to the centre
        squares = 0.5 * a.slope * b.slope * self.half * self.half
        crossed = linear_a * linear_b - np.abs(squares).sum(axis=0)
        remainder = (
            crossed
            + (np.abs(a.center) + linear_a) * b.remainder
            + (np.abs(b.center) + linear_b) * a.remainder
            + a.remainder * b.remainder
        )
        center = a.center * b.center + squares.sum(axis=0)
        slope = a.center * b.slope + b.center * a.slope
        return self.widen(center, slope, remainder, self.reach(a) * self.reach(b), product_range(a, b))

    def apply(self, a: Form, value: Array, rate: Array, second: Range, between: Range) -> Form:
        """f(a) by Taylor's formula: from f and f' at the `expansion_point`, and the ranges of f'' and of f on [low, high]."""
        point = self.expansion_point(a)
        around = np.maximum(a.high - point, point - a.low)
        square = 0.5 * around * around
        least, most = np.minimum(second[0], 0.0) * square, np.maximum(second[1], 0.0) * square
        moved = rate * (a.center - point)
        center, slope = value + moved + 0.5 * (least + most), rate * a.slope
        scale = np.abs(value) + np.abs(rate) * (self.reach(a) + np.abs(point)) + (most - least)
        return self.widen(center, slope, np.abs(rate) * a.remainder + 0.5 * (most - least), scale, between)

    @staticmethod
    def expansion_point(a: Form) -> Array:
        """The centre of a form, within its range."""
        return np.asarray(np.clip(a.center, a.low, a.high))

    def invert(self, a: Form) -> Form:
        """1 / a; the whole line where a may be 0."""
        point = self.expansion_point(a)
        defined = (a.low > 0) | (a.high < 0)
        low, high = 1 / a.high, 1 / a.low
        value = np.where(defined, 1 / point, 0.0)
        second = 2 * low**3, 2 * high**3
        between = np.where(defined, low, -np.inf), np.where(defined, high, np.inf)
        found = self.apply(a, value, -value * value, second, between)
        return self.choose(defined, found, self.from_range((np.full_like(low, -np.inf), np.full_like(low, np.inf))))

    @staticmethod
    def choose(boxes: BoolArray, a: Form, b: Form) -> Form:
        """The form a in some boxes (n,), b in the others."""
        return Form(
            np.where(boxes, a.center, b.center),
            np.where(boxes, a.slope, b.slope),
            np.where(boxes, a.remainder, b.remainder),
            np.where(boxes, a.low, b.low),
            np.where(boxes, a.high, b.high),
        )

    def unite(self, a: Form, b: Form, between: Range | None = None) -> Form:
        """What encloses both."""
        center, slope = 0.5 * (a.center + b.center), 0.5 * (a.slope + b.slope)
        apart = 0.5 * (np.abs(a.center - b.center) + (np.abs(a.slope - b.slope) * self.half).sum(axis=0))
        both = np.minimum(a.low, b.low), np.maximum(a.high, b.high)
        remainder = apart + np.maximum(a.remainder, b.remainder)
        return self.widen(center, slope, remainder, self.reach(a) + self.reach(b), both if between is None else between)


def product_range(a: Form, b: Form) -> Range:
    """The range of a * b; 0 times infinity is 0, as a bound of 0 is."""
    ends = [first * second for first in (a.low, a.high) for second in (b.low, b.high)]
    least = np.stack(np.broadcast_arrays(*ends))
    least = np.where(np.isnan(least), 0.0, least)
    return least.min(axis=0), least.max(axis=0)


def power_range(low: Array, high: Array, exponent: float) -> Range:
    """The range of the power where it is defined: exponents that are no whole numbers take positive bases only."""
    if exponent == 0.0:
        return np.ones_like(low), np.ones_like(high)
    is_whole = exponent == int(exponent)
    if not is_whole:
        low, high = np.maximum(low, 0.0), np.maximum(high, 0.0)
    first, last = np.power(low, exponent), np.power(high, exponent)
    least, most = np.minimum(first, last), np.maximum(first, last)
    crosses = (low <= 0) & (high >= 0)
    if exponent < 0:
        return np.where(crosses, -np.inf, least), np.where(crosses, np.inf, most)
    return (np.where(crosses, 0.0, least) if is_whole and exponent % 2 == 0 else least), most
