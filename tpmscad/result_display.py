"""What a result shows of itself: at most ten lines of text, and in notebooks tables."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from html import escape
from typing import Any

import numpy as np

MAX_LINES = 10
"""Lines that `print` shows of a result."""

MAX_NAMES = 8
"""Names that a line lists."""

_COLUMNS = re.compile(r"\s{2,}")


def fit_lines(lines: Iterable[str], rest: str, *, tail: Sequence[str] = ()) -> str:
    """The lines, then those of `tail`; if they are too many, the last before `tail` give way to one that names `rest`."""
    lines = [line for text in lines for line in text.splitlines()]
    room = MAX_LINES - len(tail)
    if len(lines) > room:
        left = len(lines) - room + 1
        lines = [*lines[: room - 1], f"and {left} more lines: see {rest}"]
    return "\n".join([*lines, *tail])


def list_names(names: Sequence[str], shown: int = MAX_NAMES) -> str:
    """The first names, and the number of the others."""
    more = f" and {len(names) - shown} more" if len(names) > shown else ""
    return ", ".join(names[:shown]) + more


def format_html_table(caption: str, rows: Iterable[Sequence[Any]], head: Sequence[str] = ()) -> str:
    """A table with a caption. The first cell of each row is its title, unless the columns have titles in `head`."""
    titles = f"<tr>{''.join(f'<th>{escape(name)}</th>' for name in head)}</tr>" if head else ""
    first = "td" if head else "th"
    body = "".join(
        f"<tr><{first}>{_show_cell(title)}</{first}>{''.join(f'<td>{_show_cell(cell)}</td>' for cell in cells)}</tr>"
        for title, *cells in rows
    )
    above = f"<p>{escape(caption)}</p>" if caption else ""
    return f"{above}<table>{titles}{body}</table>"


def tabulate_summary(text: str) -> str:
    """A table with the first line of a text as its caption and a row for each line "title  value"; a line may have no title."""
    caption, *lines = text.splitlines()
    columns = (_COLUMNS.split(line.strip(), maxsplit=1) for line in lines)
    return format_html_table(caption, [each if len(each) > 1 else ("", *each) for each in columns])


def _show_cell(value: Any) -> str:
    """A value as escaped text for people: six digits of numbers, nothing for None."""
    if value is None:
        return ""
    if isinstance(value, bool | np.bool_):
        return "yes" if value else "no"
    if isinstance(value, float | np.floating):
        return f"{value:.6g}"
    if isinstance(value, list | tuple | np.ndarray):
        return ", ".join(map(_show_cell, value))
    return escape(str(value))
