"""Rows that are repeated, each any number of times, and ranges of numbers one after another, without loops."""

from __future__ import annotations

import numpy as np

from tpmscad._typing import IntArray


def repeat_rows(count: IntArray) -> tuple[IntArray, IntArray]:
    """Each row as often as `count` (n,) says, and the number of the repetition, from 0: (m,), (m,)."""
    row = np.repeat(np.arange(len(count)), count)
    return row, np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count)


def list_following(start: IntArray) -> IntArray:
    """Of elements in cycles that start at `start` (n + 1,), the total last: the one after each, (m,)."""
    following = np.arange(1, start[-1] + 1)
    following[start[1:] - 1] = start[:-1]
    return following


def list_preceding(start: IntArray) -> IntArray:
    """The element before each one, (m,), as in `list_following`."""
    before = np.arange(-1, start[-1] - 1)
    before[start[:-1]] = start[1:] - 1
    return before


def expand_ranges(begin: IntArray, end: IntArray) -> tuple[IntArray, IntArray]:
    """The number of each range [begin, end) (n,) as often as it has elements, and its elements: (m,), (m,)."""
    number, step = repeat_rows(np.maximum(end - begin, 0))
    return number, begin[number] + step
