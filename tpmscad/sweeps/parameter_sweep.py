"""A parameter study: every design of a table made, measured and written, by any executor, and resumed after an interruption."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tpmscad._typing import ProgressOption
from tpmscad.atomic_file import validate_output_path
from tpmscad.errors import InvalidRequest
from tpmscad.parallel import run_as_completed
from tpmscad.public_calls import public
from tpmscad.stage_timer import StageTimer
from tpmscad.sweeps.cell_text import parse_cell
from tpmscad.sweeps.design_runs import FIGURES, METRICS, describe_failure, run_design
from tpmscad.sweeps.parameter_table import Design, read_table
from tpmscad.sweeps.results_table import ResultsTable, open_results, read_figure

MAX_FAILURES_SHOWN = 10
"""Failures that the summary of a sweep lists."""


@dataclass(frozen=True, slots=True)
class SweepResults:
    """The results of a sweep, in the order of its table.

    Attributes
    ----------
    path : Path
        The CSV file of the results.
    rows : tuple of dict
        One for each design: its parameters and its figures by the names of the columns; None where nothing was measured.
    reused : int
        Number of rows that an earlier run had made.
    """

    path: Path
    rows: tuple[Mapping[str, Any], ...]
    reused: int

    @property
    def met(self) -> bool:
        """Whether every design was made as requested."""
        return all(row["met"] for row in self.rows)

    @property
    def failures(self) -> tuple[Mapping[str, Any], ...]:
        """The rows of the designs that could not be made or miss the request."""
        return tuple(row for row in self.rows if not row["met"])

    def column(self, name: str) -> list[Any]:
        """The values of a column, one for each design.

        Parameters
        ----------
        name : str
            A parameter or a figure, such as "porosity".

        Returns
        -------
        list
            Numbers, text, tuples of numbers, or None where the cell is empty.
        """
        if not any(name in row for row in self.rows):
            raise InvalidRequest(f"there is no column {name!r}; the columns are {', '.join(self.rows[0])}")
        return [row.get(name) for row in self.rows]

    def to_dict(self) -> dict[str, Any]:
        """Plain values, as in a report.

        Returns
        -------
        dict
            The path, the number of reused rows, and the rows.
        """
        return {
            "path": str(self.path),
            "reused": self.reused,
            "met": self.met,
            "rows": [dict(row) for row in self.rows],
        }

    def __str__(self) -> str:
        failures = self.failures
        kept = f", {self.reused} of them from an earlier run" if self.reused else ""
        lines = [f"{len(self.rows)} designs{kept}: {len(self.rows) - len(failures)} met; results in {self.path}"]
        lines += [
            f"row {number}  {row['error']}: {row['message']}"
            for number, row in enumerate(self.rows, 1)
            if not row["met"]
        ][:MAX_FAILURES_SHOWN]
        if len(failures) > MAX_FAILURES_SHOWN:
            lines.append(f"and {len(failures) - MAX_FAILURES_SHOWN} more")
        return "\n".join(lines)


@public('sweep("designs.csv", output="results.csv")')
def sweep(
    table: Any,
    executor: Executor | None = None,
    output: str | Path = "results.csv",
    *,
    metrics: bool = False,
    progress: ProgressOption = None,
) -> SweepResults:
    """Make and measure every design of a table, and write a table of results.

    The results are the same, in the order of the table, whoever makes them. After an interruption the same call goes on: designs
    whose parameters are in the results already, and whose files are there, are not made again. A design that cannot be made is a
    row with its error, too, and the others go on.

    Parameters
    ----------
    table : str, Path, sequence of mappings, or DataFrame
        One design a row: a CSV file, a Parquet file (``pip install 'tpmscad[tables]'``), dictionaries, or a data frame of pandas.
        The columns are keywords of `lattice`; in rows with a `body`, the path of a STEP file, those of `infill`. In rows with a
        `recipe`, a TOML file for ``tpmscad blend`` or ``tpmscad solidify``, the columns are keys of that recipe, such as ``tol``
        or ``structures[0].level``. An empty cell is the default. The column `file` names the file of the solid (.step, .stl,
        .3mf, ...), with other columns and the number of the row in braces: ``{surface}_{thickness}_{row:03d}.step``.
    executor : concurrent.futures.Executor, optional
        Makes the designs: a process pool, or on a cluster with a common file system Dask's ``Client.get_executor()``. By default
        this process, one after the other.
    output : str or Path, optional
        The CSV file of the results.
    metrics : bool, optional
        Measure the smallest wall, the smallest pore and the hydraulic diameter, too; it takes longer than most lattices.
    progress : callable or bool, optional
        Called with "designs" and the fraction that is done. By default work of more than two seconds shows a bar in a terminal or
        a notebook; False shows nothing.

    Returns
    -------
    SweepResults
        The rows: parameters, met, volume, area, porosity, faces, max_deviation, rms_deviation, Betti numbers (pieces, tunnels,
        cavities), metrics, file, error, message, seconds. Lengths are in mm.

    Raises
    ------
    InvalidRequest
        If the table cannot be read: the message names row and column. Nothing has been made then.
    TpmscadError
        If a process of the executor dies; the rows that are finished have been written.

    Examples
    --------
    >>> designs = [{"surface": "gyroid", "cell": 10, "thickness": t} for t in (0.5, 1.0, 1.5)]
    >>> results = tpmscad.sweep(designs, output="results.csv")  # doctest: +SKIP
    >>> results.column("porosity")  # doctest: +SKIP
    [0.84..., 0.69..., 0.54...]
    """
    path = validate_output_path(output, (".csv",))
    designs = read_table(table)
    results = open_results(path, designs.columns)
    missing = [design for design in designs.designs if not _is_done(design, results, metrics)]
    order = [design.key for design in designs.designs]
    for design in missing:
        results.rows.pop(design.key, None)
    results.write(order)
    tasks = [
        (design.function, dict(design.parameters), design.file and design.file.resolve(), metrics) for design in missing
    ]
    n_done = len(order) - len(missing)
    with StageTimer(progress)("designs") as report:
        for number, figures in run_as_completed(executor, run_design, tasks, describe_failure):
            design = missing[number]
            if figures.get("file"):
                figures["file"] = str(design.file)
            results.append(design.parameters, figures)
            n_done += 1
            report(n_done / len(order))
    results.write(order)
    rows = tuple(_read_row(results, design) for design in designs.designs)
    return SweepResults(path, rows, len(order) - len(missing))


def _is_done(design: Design, results: ResultsTable, metrics: bool) -> bool:
    """Whether the results hold a design as it is asked for now: with its file, and with metrics if they are wanted."""
    row = results.rows.get(design.key)
    if row is None:
        return False
    if row.get("error"):
        return True
    if metrics and not any(row.get(name) for name in METRICS):
        return False
    return design.file is None or (row.get("file") == str(design.file) and design.file.is_file())


def _read_row(results: ResultsTable, design: Design) -> Mapping[str, Any]:
    """The row of a design as values."""
    row = results.rows[design.key]
    parameters = {name: parse_cell(name, row[name]) if name in row else None for name in results.parameters}
    return parameters | {name: read_figure(name, row.get(name, "")) for name in FIGURES}
