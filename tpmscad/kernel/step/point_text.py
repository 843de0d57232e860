"""Text of many CARTESIAN_POINTs, formatted by compiled loops: nine tenths of a file's entities are points.

Coordinates are multiples of a power of ten, 10^-decimals. Their text is the exact decimal, shortened by its trailing zeros, so
that it reads back as the float nearest to the multiple; small ones have an exponent.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from tpmscad._compiled_loops import njit_cached
from tpmscad._typing import IntArray

HEAD, TAIL = np.frombuffer(b"=CARTESIAN_POINT('',(", np.uint8), np.frombuffer(b"));\n", np.uint8)

MAX_DECIMALS = 22
"""10^22 is the greatest power of ten that is a float: up to it a multiple of 10^-decimals is a quotient of two floats."""

CHUNK_POINTS = 200_000
"""Points formatted at a time: their buffer takes 20 MB."""

MAX_POINT_BYTES = 128
"""Above the longest entity: a number of 19 digits, the keyword, and three coordinates of at most 26 characters."""


def format_points(grid: IntArray, decimals: int, first: int) -> list[str]:
    """Text of the points grid (n, 3) times 10^-decimals, numbered from `first`, in pieces of whole lines."""
    out = np.empty(min(len(grid), CHUNK_POINTS) * MAX_POINT_BYTES, np.uint8)
    pieces = []
    for start in range(0, len(grid), CHUNK_POINTS):
        part = np.ascontiguousarray(grid[start : start + CHUNK_POINTS])
        length = _write_points(part, decimals, first + start, HEAD, TAIL, out)
        pieces.append(out[:length].tobytes().decode("ascii"))
    return pieces


@njit_cached
def _write_points(grid: Any, decimals: int, first: int, head: Any, tail: Any, out: Any) -> int:
    """Write the entities to `out` and return their length."""
    at = 0
    for i in range(len(grid)):
        out[at] = 35  # '#'
        at = _write_integer(first + i, 1, out, at + 1)
        for c in head:
            out[at] = c
            at += 1
        for axis in range(3):
            if axis:
                out[at] = 44  # ','
                at += 1
            at = _write_decimal(grid[i, axis], decimals, out, at)
        for c in tail:
            out[at] = c
            at += 1
    return at


@njit_cached
def _write_integer(value: int, least: int, out: Any, at: int) -> int:
    """Write the digits of a non-negative integer, with zeros in front up to `least` digits; the end of them."""
    count, rest = 1, value // 10
    while rest:
        count += 1
        rest //= 10
    count = max(count, least)
    for k in range(count - 1, -1, -1):
        out[at + k] = 48 + value % 10
        value //= 10
    return at + count


@njit_cached
def _write_decimal(value: int, decimals: int, out: Any, at: int) -> int:
    """Write value times 10^-decimals as a Part 21 real and return its end."""
    if value == 0:
        out[at], out[at + 1] = 48, 46  # '0.'
        return at + 2
    if value < 0:
        out[at] = 45  # '-'
        at += 1
        value = -value
    while value % 10 == 0 and decimals > 0:
        value //= 10
        decimals -= 1
    power, digits = 1, 0  # the digits that fit behind the point
    while digits < decimals and power <= value * 1000:
        power *= 10
        digits += 1
    if digits < decimals:  # more than three zeros behind the point: digits, point, exponent
        at = _write_integer(value, 1, out, at)
        out[at], out[at + 1], out[at + 2] = 46, 69, 45  # '.E-'
        return _write_integer(decimals, 1, out, at + 3)
    at = _write_integer(value // power, 1, out, at)
    out[at] = 46
    at += 1
    return at if digits == 0 else _write_integer(value % power, digits, out, at)
