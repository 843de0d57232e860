"""Tables of designs: what a cell means, which tables are refused before the work, and results matched by their parameters."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tpmscad.errors import InvalidRequest
from tpmscad.recipe.toml_entry import replace_values
from tpmscad.sweeps.cell_text import format_cell, is_blank, parse_cell
from tpmscad.sweeps.parameter_table import read_table
from tpmscad.sweeps.results_table import open_results

pytestmark = pytest.mark.kernel  # the table asks the functions for their keywords


ROW = {"surface": "gyroid", "cell": 10, "thickness": 1}
RECIPE = """tol = 0.05
domain = [[0, 0, 0], [5, 5, 5]]
[field]
kind = "rod"
surface = "gyroid"
period = 5
level = -0.3
"""

numbers = st.floats(-1e100, 1e100) | st.integers(-(10**30), 10**30)


rows_of_numbers = st.lists(numbers, min_size=2, max_size=4).map(tuple)


@given(numbers | st.booleans() | rows_of_numbers | st.lists(rows_of_numbers, min_size=2, max_size=3).map(tuple))
def test_the_text_of_a_value_is_read_as_the_value(value: Any) -> None:
    assert parse_cell("cell", format_cell(value)) == value


def test_equal_values_have_equal_text_whatever_their_type() -> None:
    assert len({format_cell(value) for value in (10, 10.0, np.float64(10), np.int64(10))}) == 1
    assert format_cell((0.1, 2.0)) == format_cell([0.1, 2]) == format_cell(np.array([0.1, 2.0])) == "0.1,2"


@pytest.mark.parametrize(
    ("column", "text", "value"),
    [
        ("surface", "P", "P"),
        ("cells", "2, 3,4", (2, 3, 4)),
        ("side", "-", "-"),
        ("open_faces", ">Z,3", ">Z,3"),
        ("keep_fraction", "True", True),
        ("thickness", "1_0", "1_0"),
        ("thickness", "nan", "nan"),
        ("file", "12", "12"),
    ],
)
def test_a_cell_is_read_by_its_form_and_its_column(column: str, text: str, value: Any) -> None:
    assert parse_cell(column, text) == value


def test_empty_cells_are_blank_in_every_kind_of_table() -> None:
    assert all(map(is_blank, (None, "", "  ", float("nan"), np.float64("nan"))))
    assert not any(map(is_blank, (0, False, "0", 0.0)))


def test_csv_parquet_data_frame_and_dictionaries_give_the_same_designs(tmp_path: Path) -> None:
    pandas = pytest.importorskip("pandas")
    parquet = pytest.importorskip("pyarrow.parquet")
    import pyarrow

    rows: list[dict[str, Any]] = [{**ROW, "cells": (2, 1, 1), "skin": None}, {**ROW, "thickness": 0.5, "cells": None}]
    frame = pandas.DataFrame(rows)
    (tmp_path / "a.csv").write_text(
        '\ufeffsurface,cell,thickness,cells,skin\ngyroid,10,1,"2,1,1",\n\ngyroid,10,.5,,\n', "utf-8"
    )
    (tmp_path / "b.csv").write_text("surface;cell;thickness;cells\ngyroid;10;1;2,1,1\ngyroid;10;0.5\n")
    parquet.write_table(
        pyarrow.Table.from_pylist([{**row, "cells": row["cells"] and "2,1,1"} for row in rows]), tmp_path / "c.parquet"
    )
    tables = [
        read_table(source) for source in (rows, frame, *(tmp_path / name for name in ("a.csv", "b.csv", "c.parquet")))
    ]
    assert len({tuple(design.key for design in table.designs) for table in tables}) == 1
    assert tables[0].designs[0].parameters == {"surface": "gyroid", "cell": 10.0, "thickness": 1.0, "cells": (2, 1, 1)}


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ([], "no rows"),
        ([{**ROW, "wall": 1}], "column 'wall' is unknown; it is called thickness"),
        ([{**ROW, "thicknes": 1}], "column 'thicknes' is unknown; it is called thickness"),
        ([{**ROW, "map": "cylinder"}], "column 'map' is unknown; it takes a function"),
        ([ROW, {**ROW, "cell": "wide"}], "row 2, column cell: cell 'wide' is not a number"),
        ([{**ROW, "cells": (2, 2)}], r"row 1, column cells: cells \(2, 2\) must be"),
        ([{**ROW, "surface": "gyriod"}], "row 1, column surface: .*gyriod"),
        ([{"cell": 10, "thickness": 1}], "row 1, column surface: is empty"),
        ([{**ROW, "diameter": 1}], "row 1, column diameter: 1 is for struts: name their cell in the column kind"),
        ([{**ROW, "thickness": np.sum}], "row 1, column thickness: it takes a function, which a table cannot hold"),
        ([{**ROW, "surface": lambda p: p[..., 0]}], "row 1, column surface"),
        ([{**ROW, "skin": 1}], "row 1, column skin: 1 is for a body"),
        (
            [{**ROW, "body": "part.step", "boundary": "box"}],
            "row 1, column boundary: box is for a surface in a box, not a body",
        ),
        ([{**ROW, "body": object()}], "row 1, column body: .*path of a file"),
        ([ROW, {**ROW, "thickness": 2}, {**ROW, "cell": 10.0}], "rows 1 and 3 have the same parameters"),
        ([{**ROW, "file": "a.step"}, {**ROW, "cell": 9, "file": "a.step"}], "rows 1 and 2 have the same file"),
        ([{**ROW, "file": "a_{skin}.step"}], "row 1, column file: .*takes the cells of its row"),
        ([{**ROW, "file": "a.dwg"}], "row 1, column file: .*ends in '.dwg'"),
        ([{**ROW, "file": "nowhere/a.step"}], "row 1, column file: .*does not exist"),
        ([{"recipe": "absent.toml"}], "row 1, column recipe: there is no recipe"),
        ([3], "row 1 3 is no mapping"),
        ("table.txt", "ends in '.txt'"),
        ("table.csv", "there is no table"),
        (3, "neither the path of a file"),
    ],
)
def test_a_bad_table_is_refused_with_its_row_and_column(
    rows: Any, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InvalidRequest, match=said):
        read_table(rows)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "is empty"),
        ("surface,surface\n", "a name of its own"),
        ("surface,cells\ngyroid,2,2,2\n", r"row 1 .* 4 cells for 2 columns: .*quotation marks"),
        ("surface\n\udcff\n", "UTF-8"),
    ],
)
def test_a_bad_file_is_refused(text: str, said: str, tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_bytes(text.encode("utf-8", "surrogateescape"))
    with pytest.raises(InvalidRequest, match=said):
        read_table(path)


def test_a_parquet_file_that_is_none_or_cannot_be_read_here_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "t.parquet").write_bytes(b"surface\ngyroid\n")
    pytest.importorskip("pyarrow.parquet")
    with pytest.raises(InvalidRequest, match=r"t\.parquet is no Parquet file: "):
        read_table(tmp_path / "t.parquet")
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(
        InvalidRequest, match=r"needs pyarrow: pip install 'tpmscad\[tables\]', or give the table as CSV"
    ):
        read_table(tmp_path / "t.parquet")


def test_a_column_of_a_recipe_is_a_key_of_it(tmp_path: Path) -> None:
    path = tmp_path / "rod.toml"
    path.write_text(RECIPE)
    (design,) = read_table([{"recipe": path, "field.level": 0.1, "tol": 0.2}]).designs
    assert (design.function, design.parameters["field.level"]) == ("solidify", 0.1)
    for key, value, said in (
        ("field.levl", 0.1, "row 1: .*levl"),
        ("field.parts[0].level", 1, "no such place"),
        ("tol", "fine", "row 1: rod.toml, line 1, tol: .fine. is not a number"),
        ("structures..level", 1, "no key of a recipe"),
    ):
        with pytest.raises(InvalidRequest, match=said):
            read_table([{"recipe": path, key: value}])


def test_replaced_values_leave_the_document_alone() -> None:
    document = {"structures": [{"level": 1}, {"level": 2}], "tol": 0.1}
    changed = replace_values(document, {"structures[1].level": (3, 4), "subgrid_check": True})
    assert changed == {"structures": [{"level": 1}, {"level": [3, 4]}], "tol": 0.1, "subgrid_check": True}
    assert document["structures"][1] == {"level": 2}


def test_a_line_of_results_that_was_cut_off_is_not_taken_for_a_row(tmp_path: Path) -> None:
    path = tmp_path / "results.csv"
    table = open_results(path, ("surface", "cell"))
    table.write([])
    for cell in (5, 6):
        table.append(
            {"surface": "gyroid", "cell": cell}, {"met": True, "message": 'a "word", and\nmore', "seconds": 0.1}
        )
    whole = path.read_bytes()
    assert open_results(path, ("surface", "cell")).rows == table.rows
    for cut in range(len(whole) - 1, whole.rindex(b"gyroid"), -1):
        path.write_bytes(whole[:cut])
        assert len(open_results(path, ("surface", "cell")).rows) == 1


def test_what_is_asked_for_and_what_is_measured_have_columns_of_their_own(tmp_path: Path) -> None:
    path = tmp_path / "results.csv"
    table = open_results(path, ("cell", "porosity"))
    table.write([])
    table.append({"cell": 5, "porosity": 0.75}, {"met": True, "porosity": 0.7503})
    assert len(set(table.columns)) == len(table.columns)
    assert open_results(path, ("cell", "porosity")) == table
    (row,) = table.rows.values()
    assert (row["requested_porosity"], row["porosity"]) == ("0.75", "0.7503")
    old = path.read_text().replace("requested_porosity", "porosity")
    path.write_text(old)
    with pytest.raises(InvalidRequest, match=r"the column porosity twice: .* overwritten .* new file"):
        open_results(path, ("cell", "porosity"))
    assert path.read_text() == old


def test_a_file_that_is_no_table_of_results_is_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "results.csv"
    for content in (b"my,own,table\n1,2,3\n", b"\xff\xfe"):
        path.write_bytes(content)
        with pytest.raises(InvalidRequest, match="no table of results"):
            open_results(path, ("surface",))
        assert path.read_bytes() == content
