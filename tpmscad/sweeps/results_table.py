"""The table of results in a CSV file: read back, appended to row by row, and put in order at the end.

A row is written at once and flushed to the disk, so that an interruption loses at most the rows in work; a last line that was cut
off is recognised by its missing end. Rows are known by the text of their parameters.
"""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tpmscad.atomic_file import atomic_write
from tpmscad.errors import InvalidRequest
from tpmscad.sweeps.cell_text import format_cell
from tpmscad.sweeps.design_runs import FIGURES

REQUESTED = "requested_"
"""Before the name of a parameter that a figure has, too: the column of its name holds what was measured."""

Key = frozenset[tuple[str, str]]
TextRow = dict[str, str]


@dataclass(slots=True)
class ResultsTable:
    """The rows of a file of results, as text, by their key; columns of parameters come first."""

    path: Path
    parameters: tuple[str, ...]
    rows: dict[Key, TextRow] = field(default_factory=dict)

    @property
    def columns(self) -> tuple[str, ...]:
        """All columns in order."""
        return (*self.parameters, *FIGURES)

    def append(self, parameters: Mapping[str, Any], figures: Mapping[str, Any]) -> None:
        """Add a finished row to the end of the file."""
        row = format_parameters(parameters) | {name: format_cell(value) for name, value in figures.items()}
        self.rows[key_of(row)] = row
        with self.path.open("a", encoding="utf-8", newline="") as file:
            file.write(self._format_lines([row]))
            file.flush()
            os.fsync(file.fileno())

    def write(self, order: Sequence[Key]) -> None:
        """Write the whole file: the rows in this order, then those of an earlier table."""
        first = [key for key in order if key in self.rows]
        rest = self.rows.keys() - set(first)
        rows = [self.rows[key] for key in [*first, *(key for key in self.rows if key in rest)]]
        with atomic_write(self.path) as aside:
            aside.write_text(
                self._format_lines([dict(zip(self.columns, self.columns, strict=True)), *rows]), "utf-8", newline=""
            )

    def _format_lines(self, rows: Iterable[TextRow]) -> str:
        text = io.StringIO()
        csv.DictWriter(text, self.columns, restval="", lineterminator="\n").writerows(rows)
        return text.getvalue()


def name_column(parameter: str) -> str:
    """The column of a parameter: its name, unless a figure has it, as a porosity may be asked for and is measured."""
    return REQUESTED + parameter if parameter in FIGURES else parameter


def format_parameters(parameters: Mapping[str, Any]) -> TextRow:
    """The text of parameters by their columns."""
    return {name_column(name): format_cell(value) for name, value in parameters.items()}


def key_of(row: Mapping[str, str]) -> Key:
    """What a row is known by: the names and the text of its parameters."""
    return frozenset((name, text) for name, text in row.items() if name not in FIGURES and text)


def open_results(path: Path, parameters: Sequence[str]) -> ResultsTable:
    """The rows that an earlier run has left; none if there is no file. InvalidRequest if the file holds something else."""
    columns = [name_column(name) for name in parameters]
    if not path.exists():
        return ResultsTable(path, tuple(columns))
    text = path.read_bytes().decode("utf-8", "replace")
    whole = text[: text.rfind("\n") + 1]  # a line without its end was cut off
    lines = list(csv.reader(io.StringIO(whole, newline="")))
    head = tuple(lines[0]) if lines else ()
    if text and head[-len(FIGURES) :] != tuple(FIGURES):
        raise InvalidRequest(
            f"{path} is no table of results of a sweep: give the name of a new file, or remove this one"
        )
    earlier = head[: -len(FIGURES)]
    if lost := [name for name in earlier if name in FIGURES]:
        raise InvalidRequest(
            f"{path} has the column {lost[0]} twice: what was asked for there is overwritten by what was measured; give the name "
            "of a new file, or remove this one"
        )
    table = ResultsTable(path, tuple(dict.fromkeys([*columns, *earlier])))
    for cells in lines[1:]:
        if len(cells) == len(head):
            row = {name: cell for name, cell in zip(head, cells, strict=True) if cell}
            table.rows[key_of(row)] = row
    return table


def read_figure(name: str, text: str) -> Any:
    """The value of a column of figures; None if it is empty."""
    if not text:
        return None
    kind = FIGURES[name]
    return text == "true" if kind is bool else kind(text)
