"""A parameter study: every design of a table made, measured and written, by any executor, and resumed after an interruption."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from tpmscad._lazy_import import import_extra
from tpmscad._typing import ProgressOption
from tpmscad.api.public_calls import validate_call
from tpmscad.api.shared_kinds import ANYTHING, EXECUTOR, FLAG, PATH, PROGRESS, TEXT
from tpmscad.atomic_file import validate_output_path
from tpmscad.errors import InvalidRequest
from tpmscad.parallel import run_as_completed
from tpmscad.result_display import fit_lines, format_html_table
from tpmscad.stage_timer import StageTimer
from tpmscad.studies._estimate_exchanger import check_flow
from tpmscad.sweeps.cell_text import parse_cell
from tpmscad.sweeps.design_runs import (
    FIGURES,
    METRICS,
    PROPERTIES,
    SOLID,
    describe_failure,
    describe_flow,
    run_design,
)
from tpmscad.sweeps.parameter_table import Design, read_table
from tpmscad.sweeps.results_plot import plot_columns
from tpmscad.sweeps.results_table import REQUESTED, ResultsTable, open_results, read_figure


@dataclass(frozen=True, slots=True, repr=False)
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

        Raises
        ------
        InvalidRequest
            If there is no such column.
        """
        columns = list(self.rows[0])
        if name not in columns:
            near = get_close_matches(str(name), columns, n=1)
            hint = f"did you mean {near[0]!r}?" if near else f"the columns are {', '.join(columns)}"
            raise InvalidRequest(f"there is no column {name!r}; {hint}")
        return [row[name] for row in self.rows]

    @validate_call('results.plot("porosity", "E1", by="surface")')
    def plot(
        self,
        x: Annotated[
            str,
            TEXT.described_as(example='"porosity"'),
            'Columns of numbers: parameters or figures, such as "porosity" and "E1".',
        ],
        y: Annotated[str, TEXT.described_as(example='"E1"'), "As `x`."],
        *,
        by: Annotated[
            str | None,
            TEXT.described_as(example='"surface"'),
            'A column whose values part the designs, such as "surface": each has a line, a colour and an entry of the '
            "legend.",
        ] = None,
        front: Annotated[
            str | None,
            TEXT.described_as(example='"least,greatest"'),
            "Whether the least or the greatest of x and of y are best: the designs that no other beats in both are joined.",
        ] = None,
        ax: Annotated[Any, ANYTHING, "Axes to draw into; by default those of a new figure."] = None,
    ) -> Any:
        """Draw one column over another, as a line with a marker for each design that is met.

        Returns
        -------
        matplotlib.axes.Axes
            The axes, labelled with quantities and units.

        Raises
        ------
        InvalidRequest
            If there is no such column, if it holds something else than numbers, if no design that is met has both numbers, or if
            matplotlib is not installed (pip install "tpmscad[plot]").

        Notes
        -----
        Points are joined in the order of x. Designs that are not met, and those without one of the numbers, are left out.

        Examples
        --------
        >>> results = tpmscad.sweep("designs.csv", properties=True)  # doctest: +SKIP
        >>> results.plot("porosity", "E1", by="surface").figure.savefig("stiffness.png")  # doctest: +SKIP
        """
        columns = [self.column(name) for name in (x, y, by or x)]
        met = [cells for row, *cells in zip(self.rows, *columns, strict=True) if row["met"]]
        axes = plot_columns((x, y, by), met, ax, joined=front is None)
        if front is not None:
            ends = [word.strip() for word in front.split(",")]
            if len(ends) != 2 or not set(ends) <= {"least", "greatest"}:
                raise InvalidRequest(
                    f"front {front!r} must say least or greatest for each of x and y, as in 'least,greatest'"
                )
            best = self._find_front((x, y), [1.0 if word == "least" else -1.0 for word in ends])
            axes.plot(*zip(*sorted((row[x], row[y]) for row in best), strict=True), "k--", zorder=0)
        return axes

    @validate_call('results.pareto(least="pressure_drop_plus", greatest="effectiveness")')
    def pareto(
        self,
        *,
        least: Annotated[
            str, TEXT.described_as(example='"mass"'), "Figures whose least values are best, by commas."
        ] = "",
        greatest: Annotated[
            str, TEXT.described_as(example='"effectiveness"'), "Figures whose greatest values are best, by commas."
        ] = "",
    ) -> list[dict[str, Any]]:
        """The parameters of the designs that no other beats in all of some figures, as rows for another sweep.

        Returns
        -------
        list of dict
            The parameters by the names of the table's columns, in its order; those that are met and have all figures count.

        Raises
        ------
        InvalidRequest
            If no figure is named, or one is no column of numbers.

        Examples
        --------
        >>> coarse = tpmscad.sweep("designs.csv", flow=flow, solids=False)  # doctest: +SKIP
        >>> best = coarse.pareto(least="pressure_drop_plus,mass", greatest="effectiveness")  # doctest: +SKIP
        >>> tpmscad.sweep(best, flow=flow)  # doctest: +SKIP
        """
        names = [[name.strip() for name in text.split(",") if name.strip()] for text in (least, greatest)]
        if not any(names):
            raise InvalidRequest("name the figures whose least, or greatest, values are best")
        signs = [1.0] * len(names[0]) + [-1.0] * len(names[1])
        return [
            {name.removeprefix(REQUESTED): row[name] for name in row if name not in FIGURES and row[name] is not None}
            for row in self._find_front([*names[0], *names[1]], signs)
        ]

    def _find_front(self, names: Sequence[str], signs: Sequence[float]) -> list[Mapping[str, Any]]:
        """The rows that are met and that no other beats in all columns, of each of which the least times its sign is best."""
        columns = [self.column(name) for name in names]
        rows = [
            (row, cells)
            for row, *cells in zip(self.rows, *columns, strict=True)
            if row["met"] and all(isinstance(cell, int | float) for cell in cells)
        ]
        values = np.array([cells for _, cells in rows], float).reshape(-1, len(names)) * signs
        beaten = [bool(((values <= v).all(axis=1) & (values < v).any(axis=1)).any()) for v in values]
        return [row for (row, _), is_beaten in zip(rows, beaten, strict=True) if not is_beaten]

    def to_dict(self) -> dict[str, Any]:
        """Plain values, as in a report. The path, the number of reused rows, and the rows."""
        return {
            "path": str(self.path),
            "reused": self.reused,
            "met": self.met,
            "rows": [dict(row) for row in self.rows],
        }

    def __repr__(self) -> str:
        failures = self.failures
        kept = f", {self.reused} of them from an earlier run" if self.reused else ""
        lines = [f"{len(self.rows)} designs{kept}: {len(self.rows) - len(failures)} met; results in {self.path}"]
        lines += [
            f"row {number}  {row['error']}: {row['message']}"
            for number, row in enumerate(self.rows, 1)
            if not row["met"]
        ]
        return fit_lines(lines, ".failures")

    def _repr_html_(self) -> str:
        """The rows as a table without the columns that are empty in all of them."""
        filled = [
            name for name in (self.rows[0] if self.rows else ()) if any(row[name] is not None for row in self.rows)
        ]
        rows = [[row[name] for name in filled] for row in self.rows]
        return format_html_table(str(self).splitlines()[0], rows, filled)


@validate_call('sweep("designs.csv", output="results.csv")')
def sweep(
    table: Annotated[
        Any,
        ANYTHING,
        "One design a row: a CSV file, a Parquet file (``pip install 'tpmscad[tables]'``), dictionaries, or a data "
        "frame of pandas. The columns are keywords of `lattice`; in rows with a `body`, the path of a STEP file, "
        "those of `infill`; in rows whose `kind` is one of struts, those of `struts`. In rows with a `recipe`, a TOML "
        "file for ``tpmscad blend`` or ``tpmscad solidify``, the columns are keys of that recipe, such as ``tol`` or "
        "``structures[0].level``. An empty cell is the default. The column `file` names the file of the solid (.step, "
        ".stl, .3mf, ...), with other columns and the number of the row in braces: "
        "``{surface}_{thickness}_{row:03d}.step``.",
    ],
    executor: Annotated[
        Executor | None,
        EXECUTOR,
        "Makes the designs: a process pool, or on a cluster with a common file system Dask's "
        "``Client.get_executor()``. By default this process, one after the other.",
    ] = None,
    output: Annotated[
        str | Path, PATH.described_as(example='"results.csv"'), "The CSV file of the results."
    ] = "results.csv",
    *,
    metrics: Annotated[
        bool,
        FLAG,
        "Measure the smallest wall, the smallest pore and the hydraulic diameter, too; it takes longer than most "
        "lattices.",
    ] = False,
    properties: Annotated[
        bool,
        FLAG,
        "Compute the homogenised stiffness and conductivity of every design with `homogenize`, too: seconds a design "
        'where the walls are hexahedra (``boundary="natural"``), up to minutes with tetrahedra. The designs must '
        "repeat, as lattices of whole cells do; the solid's Poisson ratio is 0.3. Needs ``pip install "
        "'tpmscad[simulation]'``.",
    ] = False,
    flow: Annotated[
        Mapping[str, Any] | None,
        ANYTHING.described_as(
            "two fluids and how they pass", '{"plus": {"fluid": "water", "temperature": 60, "mass_flow": 0.01}}'
        ),
        "Of exchangers, estimate effectiveness, heat and pressure drops, too: `plus`, `minus`, `arrangement` and "
        "`wall_conductivity` as in `estimate_exchanger`, and `wall_density`, kg/m3, for the mass.",
    ] = None,
    solids: Annotated[
        bool,
        FLAG,
        "False: of exchangers only figures by samples, in a second or two each, and no solids; `pareto` then chooses the "
        "rows whose solids are worth it.",
    ] = True,
    progress: Annotated[
        ProgressOption,
        PROGRESS,
        'Called with "designs" and the fraction that is done. By default work of more than two seconds shows a bar in '
        "a terminal or a notebook; False shows nothing.",
    ] = None,
) -> SweepResults:
    """Make and measure every design of a table, and write a table of results.

    The results are the same, in the order of the table, whoever makes them. After an interruption the same call goes on: designs
    whose parameters are in the results already, and whose files are there, are not made again. A design that cannot be made is a
    row with its error, too, and the others go on. Columns of figures hold what was measured: a parameter of such a name, as a
    porosity that is asked for, is in the column `requested_porosity`.

    Returns
    -------
    SweepResults
        The rows: parameters, met, volume, area, porosity, faces, max_deviation, rms_deviation, Betti numbers (pieces, tunnels,
        cavities), metrics, properties, file, error, message, seconds. Lengths are in mm. Properties are E1 to E3, nu12 to nu23,
        G12 to G23, bulk_modulus, conductivity, and property_error, the relative change by the last refinement of the mesh. Moduli
        are relative to Young's modulus of the solid, and the conductivity, the mean over the axes, to that of the solid. Of
        exchangers the volume, wetted area (mm2), hydraulic diameter and opening area of each channel, and with `flow` the
        pressure drops (Pa), effectiveness and heat (W), the least that the sources say, so that drops are those of smooth walls,
        compactness (m2/m3) and mass (g) of the wall; `coarse` tells figures by samples, where met says that samples of each
        channel connect its openings.

    Raises
    ------
    InvalidRequest
        If the table cannot be read: the message names row and column; or if properties are asked for of a
        filled body, or without scikit-fem. Nothing has been made then.
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
    if properties:
        _require_lattices(designs.designs)
    if flow is not None:
        check_flow(flow)
    if not solids and (other := next((d for d in designs.designs if d.function != "fluid_domains"), None)):
        raise InvalidRequest(f"row {other.number}: only exchangers have figures without solids: leave out solids=False")
    results = open_results(path, designs.columns)
    wanted = (METRICS,) * metrics + (PROPERTIES,) * properties + (SOLID,) * solids
    told = None if flow is None else describe_flow(flow)
    missing = [design for design in designs.designs if not _is_done(design, results, wanted, told)]
    order = [design.key for design in designs.designs]
    tasks = []
    for design in missing:
        row = results.rows.pop(design.key, {})
        measured = (metrics or _has_any(row, METRICS), properties or _has_any(row, PROPERTIES))  # none is lost
        file = design.file and design.file.resolve()
        tasks.append((design.function, dict(design.parameters), file, *measured, flow, solids))
    results.write(order)
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


def _require_lattices(designs: Sequence[Design]) -> None:
    """InvalidRequest, before any work, if homogenised properties of the designs cannot be computed here."""
    import_extra("skfem", "homogenised properties", "simulation")
    for design in designs:
        if design.function == "infill":
            raise InvalidRequest(
                f"row {design.number}, column body: homogenised properties are those of a lattice that repeats, not of a filled "
                "body; leave out properties, or make a table of the lattices"
            )


def _is_done(design: Design, results: ResultsTable, wanted: Sequence[Sequence[str]], flow: str | None) -> bool:
    """Whether the results hold a design as it is asked for now: with its file, the groups of figures, and the flow."""
    row = results.rows.get(design.key)
    if row is None:
        return False
    if row.get("error"):
        return True
    if not all(_has_any(row, group) for group in wanted):
        return False
    if flow is not None and design.function == "fluid_domains" and row.get("flow") != flow:
        return False
    return design.file is None or (row.get("file") == str(design.file) and design.file.is_file())


def _has_any(row: Mapping[str, str], group: Sequence[str]) -> bool:
    """Whether one figure of a group, at least, was measured."""
    return any(row.get(name) for name in group)


def _read_row(results: ResultsTable, design: Design) -> Mapping[str, Any]:
    """The row of a design as values."""
    row = results.rows[design.key]
    parameters = {name: parse_cell(name, row[name]) if name in row else None for name in results.parameters}
    return parameters | {name: read_figure(name, row.get(name, "")) for name in FIGURES}
