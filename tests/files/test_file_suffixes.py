"""One list of suffixes: every row has its writer and reader, and what is said of files follows from it."""

from __future__ import annotations

from collections.abc import Mapping

import pytest

from tpmscad import cli, file_suffixes
from tpmscad.fields.data.mesh_files import READERS
from tpmscad.file_suffixes import LAYER_WRITERS, MESH_PROGRAMS, MESH_WRITERS, MODEL_SUFFIXES, TRIANGLE_WRITERS

pytestmark = pytest.mark.kernel


@pytest.mark.parametrize("writers", [TRIANGLE_WRITERS, LAYER_WRITERS, MESH_WRITERS])
def test_every_row_names_a_function(writers: Mapping[str, str]) -> None:
    for suffix in writers:
        assert file_suffixes.load_writer(writers, suffix).__name__.startswith("write_")


def test_readers_and_programs_have_the_rows_of_the_list() -> None:
    assert tuple(READERS) == file_suffixes.READ_TRIANGLE_SUFFIXES
    assert tuple(MESH_PROGRAMS) == tuple(MESH_WRITERS)


@pytest.mark.parametrize(
    ("command", "suffixes"),
    [("lattice", MODEL_SUFFIXES), ("mesh", MESH_WRITERS), ("domains", file_suffixes.DOMAIN_SUFFIXES)],
)
def test_the_help_of_commands_lists_them(
    command: str, suffixes: tuple[str, ...], capsys: pytest.CaptureFixture
) -> None:
    with pytest.raises(SystemExit):
        cli.main([command, "--help"])
    shown = " ".join(capsys.readouterr().out.split())
    assert not [suffix for suffix in suffixes if suffix not in shown and suffix != ".stp"]


def test_a_list_in_words_leaves_the_second_name_of_step_out() -> None:
    assert file_suffixes.list_suffixes(MODEL_SUFFIXES) == ".step, .stl, .3mf, .glb or .brep"
    assert file_suffixes.list_suffixes((".json",)) == ".json"
