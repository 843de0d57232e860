"""Values in the cells of a table: text to a value and back.

A cell holds a number, several numbers with commas between them, rows of such numbers with semicolons between them (the corners of
a box), `true` or `false`, or text. The text of a value is what results are matched by: equal values have equal text, and the text
is read as the value.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import PurePath
from typing import Any

import numpy as np

TEXT_COLUMNS = ("surface", "body", "recipe", "file", "open_faces", "openings", "keep", "clear")
"""Columns whose cells are text, even where it looks like a number."""

BOOLEANS = {"true": True, "false": False}


def is_blank(value: Any) -> bool:
    """Whether a cell is empty: None, text of nothing but spaces, or the nan by which pandas marks a missing value."""
    if value is None or (isinstance(value, str) and not value.strip()):
        return True
    return isinstance(value, float | np.floating) and math.isnan(value)


def parse_cell(column: str, text: str) -> Any:
    """The value of a cell of a text file."""
    text = text.strip()
    if column in TEXT_COLUMNS:
        return text
    if text.lower() in BOOLEANS:
        return BOOLEANS[text.lower()]
    rows = [_parse_numbers(row) for row in text.split(";")]
    if None in rows:
        return text
    return tuple(rows) if len(rows) > 1 else rows[0]


def _parse_numbers(text: str) -> tuple[int | float, ...] | int | float | None:
    """A number, or several with commas between them; None for anything else."""
    numbers = [number for part in text.split(",") if (number := _parse_number(part.strip())) is not None]
    if len(numbers) <= text.count(","):
        return None
    return tuple(numbers) if len(numbers) > 1 else numbers[0]


def _parse_number(text: str) -> int | float | None:
    """A finite number; None for anything else, digits with underscores included."""
    if "_" in text:
        return None
    for kind in (int, float):
        try:
            number = kind(text)
        except ValueError:
            continue
        return number if math.isfinite(number) else None
    return None


def format_cell(value: Any) -> str:
    """The text of a value, without loss; 10 and 10.0 have the same."""
    if value is None:
        return ""
    if isinstance(value, bool | np.bool_):
        return str(bool(value)).lower()
    if isinstance(value, str | PurePath):
        return str(value)
    if isinstance(value, float | np.floating):
        number = float(value)
        return str(int(number)) if number.is_integer() and abs(number) < 1e15 else repr(number)
    if isinstance(value, Mapping):  # openings of channels
        return ";".join(f"{name}={format_cell(part)}" for name, part in value.items())
    if isinstance(value, list | tuple | np.ndarray):
        nested = any(isinstance(part, list | tuple | np.ndarray) for part in value)
        return (";" if nested else ",").join(map(format_cell, value))
    return str(value)
