"""Kinds of arguments: what a public function takes in words, an example of it, and the function that reads it.

A reader returns the value in its final form (a float, a tuple, an array) or raises `InvalidValue` with the reason. Nothing is
converted that a person would not call by the same name: a bool is no number, nor are bytes, text and arrays of one number.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from decimal import Decimal
from numbers import Integral, Real
from typing import TYPE_CHECKING, Any, Self, TypeVar

if TYPE_CHECKING:
    from tpmscad._typing import Array

T = TypeVar("T")

GREATEST, LEAST = 1e100, 1e-100
"""Magnitudes of numbers, and of positive numbers: the cubes of others leave the range of float64."""

MAX_SHOWN = 60
"""Characters of a value in a message."""


class InvalidValue(Exception):
    """Why a value is not of a kind; `public_calls` adds the argument and the value.

    `place` leads to the part of a sequence or table that the reason is about: index or key, from the outside inwards.
    """

    place: tuple[int | str, ...] = ()


class WrongType(InvalidValue):
    """The value is not even of the type: another kind may take it."""


@dataclass(frozen=True, slots=True)
class ArgumentKind:
    """What an argument takes, in words; an example as it is written; its reader, which raises InvalidValue; its choices."""

    text: str
    example: str
    read: Callable[[Any], Any]
    choices: tuple[str, ...] = ()

    def described_as(self, text: str = "", example: str = "") -> Self:
        """The same kind described by other words, or by another example."""
        return replace(self, text=text or self.text, example=example or self.example)

    def or_else(self, other: ArgumentKind) -> ArgumentKind:
        """A kind that takes what either takes."""

        def read(value: Any) -> Any:
            try:
                return self.read(value)
            except WrongType:
                return other.read(value)
            except InvalidValue as reason:
                try:
                    return other.read(value)
                except InvalidValue:
                    raise reason from None

        return ArgumentKind(f"{self.text}, or {other.text}", self.example, read)


def show_value(value: Any) -> str:
    """A value in one line for a message, cut off if it is long."""
    try:
        text = " ".join(repr(value).split())
    except Exception:  # the `repr` of a foreign object, or a number of too many digits
        text = f"of type {type(value).__name__}"
    return text if len(text) <= MAX_SHOWN else f"{text[: MAX_SHOWN - 3]}..."


def read_number(value: Any) -> float:
    """A finite number."""
    if getattr(value, "shape", None) == ():  # of NumPy: an array of one number, or a scalar
        value = value.item()
    if isinstance(value, bool) or not isinstance(value, Real | Decimal):
        raise WrongType("is not a number")
    try:
        number = float(value)
    except (OverflowError, ValueError):
        raise InvalidValue(f"is beyond {GREATEST:g}, the greatest number taken") from None
    if not math.isfinite(number):
        raise InvalidValue("must be finite")
    if abs(number) > GREATEST:
        raise InvalidValue(f"is beyond {GREATEST:g}, the greatest number taken")
    return number


def read_positive(value: Any) -> float:
    """A number above zero."""
    number = read_number(value)
    if number <= 0:
        raise InvalidValue("must be positive")
    if number < LEAST:
        raise InvalidValue(f"is below {LEAST:g}, the least positive number taken")
    return number


def restrict(read: Callable[[Any], T], is_allowed: Callable[[T], bool], reason: str) -> Callable[[Any], T]:
    """A reader of those values of another that are allowed; `reason` says why others are not."""

    def read_allowed(value: Any) -> T:
        found = read(value)
        if not is_allowed(found):
            raise InvalidValue(reason)
        return found

    return read_allowed


read_not_negative = restrict(read_number, lambda number: number >= 0, "must not be negative")


def read_whole(value: Any) -> int:
    """A whole number; a float without fraction stands for one."""
    number = read_number(value)
    if number != int(number):
        raise InvalidValue("must be a whole number")
    return int(value) if isinstance(value, Integral) else int(number)


read_count = restrict(read_whole, lambda number: number >= 1, "must be positive: at least 1")


def read_items(value: Any) -> list[Any]:
    """The entries of a sequence or of an array."""
    if isinstance(value, str | bytes | bytearray | dict | set | frozenset):
        raise WrongType("is no sequence of values")
    if getattr(value, "shape", None) == () or not (hasattr(value, "__len__") and hasattr(value, "__iter__")):
        raise WrongType("is no sequence of values")
    return list(value)


def read_part(reader: Callable[[Any], Any], value: Any, place: int | str) -> Any:
    """The part at a place of a sequence or table, which the reason names if it is not of the kind."""
    try:
        return reader(value)
    except InvalidValue as reason:
        reason.place = (place, *reason.place)
        raise


def tuple_of(reader: Callable[[Any], Any], count: int, words: str, example: str) -> ArgumentKind:
    """A tuple of `count` values that are read by one reader; `words` says what they are."""

    def read(value: Any) -> Any:
        if isinstance(value, Real):
            raise WrongType(f"must be {words}")
        items = read_items(value)
        if len(items) != count:
            raise InvalidValue(f"must be {words}, not {len(items)}")
        return tuple(read_part(reader, item, k) for k, item in enumerate(items))

    return ArgumentKind(words, example, read)


def one_or_three(reader: Callable[[Any], Any], one: str, example: str) -> ArgumentKind:
    """One value for all axes, or three."""
    three = tuple_of(reader, 3, f"{one}, or three, one for each axis", example)

    def read(value: Any) -> Any:
        return three.read(value) if hasattr(value, "__len__") and not isinstance(value, str | bytes) else reader(value)

    return ArgumentKind(three.text, example, read)


def read_corners(value: Any) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Two corners of a box, each coordinate of the first below that of the second."""
    low, high = tuple_of(POINT.read, 2, "two corners ((x0, y0, z0), (x1, y1, z1))", "").read(value)
    if not all(a < b for a, b in zip(low, high, strict=True)):
        raise InvalidValue("is empty: each coordinate of the first corner must be below the second's")
    return low, high


def read_unbounded_number(value: Any) -> float:
    """A number or an infinity."""
    if isinstance(value, float) and math.isinf(value):
        return float(value)
    return read_number(value)


AXES = {sign + axis: (sign, axis) for sign in ("", "-") for axis in "xyz"}


def read_direction(value: Any) -> str | tuple[float, float, float]:
    """A signed axis, or a vector that is not zero."""
    if isinstance(value, str):
        if value not in AXES:
            raise InvalidValue("names no axis: give x, y, z, -x, -y, -z or a vector")
        return value
    vector: tuple[float, float, float] = POINT.read(value)
    if not math.hypot(*vector) > LEAST:
        raise InvalidValue("has no direction: its length is zero")
    return vector


def read_array(value: Any) -> Array:
    """Numbers in an array of float64; text, bools and ragged lists are refused, infinities and nan are not."""
    import numpy as np  # the command line's help goes without it

    try:
        array = np.asarray(value)
    except (TypeError, ValueError, OverflowError, RecursionError):
        raise InvalidValue("is no array of numbers of one shape") from None
    if array.dtype.kind not in "iuf" and array.size:
        raise InvalidValue(f"is no array of numbers, but of {array.dtype}")
    return np.asarray(array, float)


def array_kind(words: str, example: str, *ndim: int) -> ArgumentKind:
    """Finite numbers in an array with one of these numbers of dimensions, not empty."""

    def read(value: Any) -> Array:
        import numpy as np

        array = read_array(value)
        if array.ndim not in ndim or array.size == 0:
            raise InvalidValue(f"of shape {array.shape} must be {words}")
        if not np.isfinite(array).all():
            wrong = np.argwhere(~np.isfinite(array))
            first = tuple(map(int, wrong[0]))
            raise InvalidValue(f"is not finite at {len(wrong)} of {array.size} entries, the first at index {first}")
        return array

    return ArgumentKind(words, example, read)


def choice_of(*words: str) -> ArgumentKind:
    """One of some words."""
    listed = ", ".join(map(repr, words))

    def read(value: Any) -> str:
        if not isinstance(value, str) or value not in words:
            raise InvalidValue(f"is unknown; choose one of {listed}")
        return value

    return ArgumentKind(f"one of {listed}", repr(words[0]), read, words)


def instance_of(words: str, example: str, *types: type) -> ArgumentKind:
    """A value of one of these types, as it is."""

    def read(value: Any) -> Any:
        if not isinstance(value, types):
            raise WrongType(f"must be {words}")
        return value

    return ArgumentKind(words, example, read)


def read_callable(value: Any) -> Any:
    """Anything that can be called, but no class."""
    if not callable(value) or isinstance(value, type):
        raise WrongType("can't be called")
    return value


def read_field(value: Any) -> Any:
    """A field, a function of points, or a number, which stands for a constant field."""
    return value if callable(value) and not isinstance(value, type) else read_number(value)


def sequence_of(reader: Callable[[Any], Any], words: str, example: str) -> ArgumentKind:
    """A list of values that are read by one reader."""

    def read(value: Any) -> list[Any]:
        return [read_part(reader, item, k) for k, item in enumerate(read_items(value))]

    return ArgumentKind(words, example, read)


def read_path(value: Any) -> str | os.PathLike[str]:
    """The path of a file: text that is not empty, or a Path."""
    if not isinstance(value, str | os.PathLike) or not isinstance(os.fspath(value), str):
        raise WrongType("is no path of a file")
    if not os.fspath(value) or "\0" in os.fspath(value):
        raise InvalidValue("is no path of a file: it is empty or holds a null character")
    return value


def read_shape(value: Any) -> Any:
    """A body, a path, or anything that the room that takes it recognises; numbers, bytes and containers are none."""
    if value is None or isinstance(value, Real | bytes | bytearray | dict | set | type):
        raise InvalidValue("is no body")
    return value if not isinstance(value, str) else read_path(value)


def read_iterable(value: Any) -> Any:
    """What can be gone through, or a single thing."""
    if value is None or isinstance(value, bool | float | bytes) or getattr(value, "shape", None) == ():
        raise InvalidValue("names no faces")
    return list(value) if isinstance(value, Iterable) and not isinstance(value, str) else value


POINT = tuple_of(read_number, 3, "three numbers (x, y, z)", "(0.0, 0.0, 0.0)")
