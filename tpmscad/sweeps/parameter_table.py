"""The table of a sweep: one design a row, read and validated as a whole before any work.

A column is a keyword of `tpmscad.lattice`; of `tpmscad.infill` in rows with a `body`; of `tpmscad.fluid_domains` in rows whose
`kind` is "domains"; of `tpmscad.struts` in rows whose `kind` is one of struts. In rows with a `recipe`, a TOML file of `tpmscad
blend` or `tpmscad solidify`, a column is the path of a key of that recipe, such as `tol` or `structures[0].level`, whose value it
replaces. The column `file` names the file of the solid; in braces it takes other columns and the number of the row. An empty cell
stands for the keyword's default. InvalidRequest names the row and the column of what is wrong.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from tpmscad.api.argument_kinds import show_value
from tpmscad.api.arguments import Argument, arguments_of
from tpmscad.api.public_calls import SYNONYMS, read_value
from tpmscad.api.shared_kinds import PATH, SHAPE
from tpmscad.atomic_file import validate_output_path
from tpmscad.catalogue import find_surface
from tpmscad.errors import InvalidRequest
from tpmscad.file_suffixes import MODEL_SUFFIXES
from tpmscad.recipe.blend_recipe import BlendRecipe
from tpmscad.recipe.recipe_runs import read_recipe
from tpmscad.solids._fluid_domains import fluid_domains
from tpmscad.solids._infill import infill
from tpmscad.solids._lattice import lattice
from tpmscad.solids._struts import struts
from tpmscad.strut_cells import KINDS
from tpmscad.sweeps.cell_text import format_cell, is_blank, parse_cell
from tpmscad.sweeps.results_table import Key, format_parameters, key_of

FILE = "file"
NOT_IN_A_TABLE = ("map", "progress")
"""Keywords that take functions only."""

DOMAINS = "domains"
"""In the column kind: the row is an exchanger."""

FUNCTIONS_TOLD = "it takes a function, which a table cannot hold: make such designs one by one"

KEYWORDS: Mapping[str, Mapping[str, Argument]] = {
    function.__name__: {
        name: argument for name, argument in arguments_of(function).items() if name not in NOT_IN_A_TABLE
    }
    for function in (infill, fluid_domains, struts, lattice)
}
"""The columns by the function that a row calls."""

PURPOSES = {
    "infill": "a body: name its file in the column body",
    "fluid_domains": f"exchangers: write {DOMAINS} in the column kind",
    "struts": "struts: name their cell in the column kind",
    "lattice": "a surface in a box, not a body or struts",
}
"""What a function makes, in the message on a column that the function of a row does not take."""

TABLE_FORMATS = (".csv", ".parquet")
MAX_LISTED_ROWS = 5


@dataclass(frozen=True, slots=True)
class Design:
    """A row of the table: its number, from 1; the function that makes it; its parameters in final form; its file, if any."""

    number: int
    function: str
    parameters: Mapping[str, Any]
    file: Path | None = None

    @property
    def key(self) -> Key:
        """What results are matched by: the names and the text of all parameters."""
        return key_of(format_parameters(self.parameters))


@dataclass(frozen=True, slots=True)
class ParameterTable:
    """The designs of a table, and the columns of their parameters in the table's order."""

    columns: tuple[str, ...]
    designs: tuple[Design, ...]


def read_table(source: Any) -> ParameterTable:
    """The designs of a CSV or Parquet file, of a data frame, or of a sequence of mappings."""
    rows = _read_rows(source)
    columns = tuple(dict.fromkeys(name for row in rows for name in row))
    filled = [{name: value for name, value in row.items() if not is_blank(value)} for row in rows]
    numbered = [(number, row) for number, row in enumerate(filled, 1) if row]
    if not numbered:
        raise InvalidRequest("the table has no rows: give one for each design, with surface, cell, thickness, ...")
    _check_columns(columns, any("recipe" in row for _, row in numbered))
    designs = tuple(_read_design(number, row) for number, row in numbered)
    _refuse_repeated("the same parameters", [design.key for design in designs], designs)
    _refuse_repeated("the same file", [design.file or design.number for design in designs], designs)
    return ParameterTable(tuple(name for name in columns if name != FILE), designs)


def _read_rows(source: Any) -> list[dict[str, Any]]:
    """The rows as mappings of columns to values; cells of text files are parsed."""
    if isinstance(source, str | Path):
        return _read_file(Path(source))
    if hasattr(source, "to_dict") and hasattr(source, "columns"):  # a data frame of pandas, which need not be installed
        source = source.to_dict("records")
    if isinstance(source, Mapping) or not isinstance(source, Iterable) or getattr(source, "ndim", 1) == 0:
        raise InvalidRequest(
            f"the table {show_value(source)} is neither the path of a file ({', '.join(TABLE_FORMATS)}) nor a sequence of "
            "mappings nor a data frame"
        )
    rows = []
    for number, row in enumerate(source, 1):
        if not isinstance(row, Mapping) or not all(isinstance(name, str) for name in row):
            raise InvalidRequest(f"row {number} {show_value(row)} is no mapping of names of columns to values")
        rows.append({name: value.item() if hasattr(value, "item") else value for name, value in row.items()})
    return rows


def _read_file(path: Path) -> list[dict[str, Any]]:
    suffix = path.suffix.lower()
    if suffix not in TABLE_FORMATS:
        raise InvalidRequest(f"the table {path.name} ends in {path.suffix!r}: give a file {' or '.join(TABLE_FORMATS)}")
    if not path.is_file():
        raise InvalidRequest(f"there is no table {path}: check the path")
    return _read_csv(path) if suffix == ".csv" else _read_parquet(path)


def _read_csv(path: Path) -> list[dict[str, Any]]:
    """The rows of a text file with commas, or semicolons, between the cells."""
    try:
        text = path.read_text("utf-8-sig")
        head = text.split("\n", 1)[0]
        lines = list(csv.reader(text.splitlines(), delimiter=";" if ";" in head else ",", strict=True))
    except (UnicodeDecodeError, csv.Error) as error:
        raise InvalidRequest(f"{path.name} is no table of text in UTF-8: {error}") from error
    if not lines:
        raise InvalidRequest(f"{path.name} is empty: its first line names the columns")
    columns = [name.strip() for name in lines[0]]
    if len(set(columns)) < len(columns) or "" in columns:
        raise InvalidRequest(
            f"{path.name}: every column needs a name of its own in the first line: {', '.join(columns)}"
        )
    for number, cells in enumerate(lines[1:], 1):
        if len(cells) > len(columns):
            raise InvalidRequest(
                f"row {number} of {path.name} has {len(cells)} cells for {len(columns)} columns: put several numbers of one cell "
                'in quotation marks, "2,2,2"'
            )
    return [{name: parse_cell(name, cell) for name, cell in zip(columns, cells, strict=False)} for cells in lines[1:]]


def _read_parquet(path: Path) -> list[dict[str, Any]]:
    try:
        import pyarrow
        from pyarrow import parquet
    except ImportError as error:
        raise InvalidRequest(
            f"reading {path.name} needs pyarrow: pip install 'tpmscad[tables]', or give the table as CSV"
        ) from error
    try:
        rows: list[dict[str, Any]] = parquet.read_table(path).to_pylist()
    except pyarrow.ArrowInvalid as error:
        raise InvalidRequest(f"{path.name} is no Parquet file: {error}") from error
    return [{n: parse_cell(n, v) if isinstance(v, str) else v for n, v in row.items()} for row in rows]


def _check_columns(columns: Sequence[str], has_recipes: bool) -> None:
    """InvalidRequest for a column that no row can use."""
    known = list(dict.fromkeys([*(name for of in KEYWORDS.values() for name in of), "recipe", FILE]))
    for name in columns:
        if name in known or has_recipes:
            continue
        near = [SYNONYMS.get(name.lower(), ""), *get_close_matches(name, known, n=1)]
        meant = next((word for word in near if word), "")
        if name in NOT_IN_A_TABLE:
            hint = FUNCTIONS_TOLD
        else:
            hint = f"it is called {meant}" if meant else f"the columns are {', '.join(known)}"
        raise InvalidRequest(f"column {name!r} is unknown; {hint}")


def _read_design(number: int, row: Mapping[str, Any]) -> Design:
    """The design of a row with values in final form."""
    given = {name: value for name, value in row.items() if name != FILE}
    if "recipe" in given:
        function, parameters = _read_recipe_row(number, given)
    else:
        function = _choose_function(given)
        missing = next((a.name for a in KEYWORDS[function].values() if a.is_required and a.name not in given), None)
        if missing is not None:
            meant = KEYWORDS[function][missing].kind.text
            if missing == "surface":
                meant = f"the name of one, such as gyroid; or struts in the column kind: {', '.join(KINDS)}"
            raise InvalidRequest(f"row {number}, column {missing}: is empty; give {meant}")
        own = {name: value for name, value in given.items() if (name, value) != ("kind", DOMAINS)}
        parameters = given | {name: _read_keyword(number, function, name, value) for name, value in own.items()}
        if "surface" in parameters:
            with _locate_errors(number, "surface"):
                find_surface(parameters["surface"])
    return Design(number, function, parameters, _name_file(number, row.get(FILE), given))


def _choose_function(given: Mapping[str, Any]) -> str:
    """The function that makes a row: by its kind, or its body."""
    kind = given.get("kind")
    if kind == DOMAINS:
        return "fluid_domains"
    if "body" in given:
        return "infill"
    return "struts" if "surface" not in given and isinstance(kind, str) and kind in KINDS else "lattice"


def _read_keyword(number: int, function: str, name: str, value: Any) -> Any:
    """A keyword of a function in its final form."""
    if name not in KEYWORDS[function]:
        other = next(PURPOSES[each] for each, known in KEYWORDS.items() if name in known)
        raise InvalidRequest(
            f"row {number}, column {name}: {format_cell(value)} is for {other}, or leave the cell empty"
        )
    with _locate_errors(number, name):
        if KEYWORDS[function][name].kind is SHAPE and not isinstance(value, str | Path):
            raise InvalidRequest("give the path of a file: results are matched by the text of their parameters")
        found = read_value(name, KEYWORDS[function][name].kind, value)
        if callable(found):
            raise InvalidRequest(FUNCTIONS_TOLD)
        return found


def _read_recipe_row(number: int, given: Mapping[str, Any]) -> tuple[str, dict[str, Any]]:
    """The function that a recipe is for and the parameters; the recipe with its changed keys is read on trial."""
    changes = {name: value for name, value in given.items() if name != "recipe"}
    with _locate_errors(number, "recipe"):
        path = Path(read_value("recipe", PATH, given["recipe"]))
        if not path.is_file():
            raise InvalidRequest(f"there is no recipe {path}: check the path")
    with _locate_errors(number):
        is_blend = isinstance(read_recipe(path, changes), BlendRecipe)
    return "blend" if is_blend else "solidify", dict(given)


def _name_file(number: int, pattern: Any, given: Mapping[str, Any]) -> Path | None:
    """The file of a design: the pattern with the number of the row and the other cells put in."""
    if pattern is None:
        return None
    cells = {name: value if isinstance(value, int | float) else format_cell(value) for name, value in given.items()}
    with _locate_errors(number, FILE):
        try:
            name = str(pattern).format(**{"row": number, **cells})
        except (KeyError, ValueError, IndexError, AttributeError, TypeError) as error:
            raise InvalidRequest(
                f"{pattern} takes the cells of its row and its number in braces, gyroid_{{thickness}}_{{row:03d}}.step "
                f"({type(error).__name__}: {error})"
            ) from error
        return validate_output_path(name, MODEL_SUFFIXES)


def _refuse_repeated(what: str, keys: Sequence[Any], designs: Sequence[Design]) -> None:
    """InvalidRequest if two designs have equal keys."""
    rows: dict[Any, list[int]] = {}
    for key, design in zip(keys, designs, strict=True):
        rows.setdefault(key, []).append(design.number)
    repeated = [numbers for numbers in rows.values() if len(numbers) > 1]
    if repeated:
        shown = " and ".join(map(str, repeated[0][:MAX_LISTED_ROWS]))
        raise InvalidRequest(f"rows {shown} have {what}: leave all but one out, or change them")


@contextmanager
def _locate_errors(number: int, column: str = "") -> Iterator[None]:
    """Put the row, and the column, before the messages of errors of the request that pass through."""
    try:
        yield
    except InvalidRequest as error:
        place = f"row {number}, column {column}" if column else f"row {number}"
        raise InvalidRequest(f"{place}: {error}") from error
