"""Tables of points with a value each, as CSV files."""

from __future__ import annotations

import csv
import os
from pathlib import Path
from typing import Any

import numpy as np

from tpmscad._typing import Array
from tpmscad.errors import InvalidRequest

POINT_COLUMNS = 4
"""Columns of a table of points: x, y, z and the value."""


def read_point_table(path: str | os.PathLike[str]) -> tuple[Array, Array]:
    """Points (n, 3) and values (n,) of a CSV file with the columns x, y, z, value; a first line of names is skipped."""
    file = Path(path)
    if not file.is_file():
        raise InvalidRequest(f"there is no file {file}")
    try:
        text = file.read_text("utf-8-sig")
    except UnicodeDecodeError:
        raise InvalidRequest(f"{file.name} is no text: give a CSV file with the columns x, y, z, value") from None
    try:
        dialect: Any = csv.Sniffer().sniff(text[:4096], delimiters=",;\t ")
    except csv.Error:
        dialect = csv.excel
    dialect.skipinitialspace = True
    rows: list[list[float]] = []
    for number, row in enumerate(csv.reader(text.splitlines(), dialect), 1):
        cells = [cell for cell in row if cell.strip()]
        if not cells or cells[0].lstrip().startswith("#"):
            continue
        try:
            rows.append([float(cell) for cell in cells])
        except ValueError:
            if rows:
                raise InvalidRequest(f"file {file.name}, line {number}: {', '.join(cells)!r} are not numbers") from None
            continue  # the names of the columns
        if len(cells) != POINT_COLUMNS:
            raise InvalidRequest(
                f"file {file.name}, line {number}: {len(cells)} columns; x, y, z and a value are needed"
            )
    if not rows:
        raise InvalidRequest(f"file {file.name} holds no row of x, y, z and a value")
    table = np.array(rows)
    return table[:, :3], table[:, 3]
