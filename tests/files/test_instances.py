"""Lattices of many cells as copies of one: what the file holds, what it says of its copies, and what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tpmscad
from tpmscad.errors import InvalidRequest, NotMet
from tpmscad.files import _export_instances as lattice_instances
from tpmscad.kernel.measure.shape_report import check_shape

pytestmark = pytest.mark.kernel

REQUEST: dict[str, Any] = {"cell": 8.0, "thickness": 0.8, "tol": 0.05}


@pytest.mark.parametrize(
    ("counts", "schema"),
    [((1, 1, 1), "ap242"), ((3, 2, 1), "ap214"), ((4, 1, 11), "ap242"), ((3, 4, 2), "ap242")],
)
def test_every_cell_stands_in_its_place(counts: tuple[int, int, int], schema: str, tmp_path: Path) -> None:
    file = tpmscad.export_instances("schwarz_p", tmp_path / "p.step", cells=counts, schema=schema, **REQUEST)
    one = tpmscad.lattice("schwarz_p", **REQUEST)
    n = int(np.prod(counts))
    read = tpmscad.check_step(file.path)
    assert read.ok
    assert (read.shape.solids, read.shape.faces) == (n, n * one.certificate.n_faces)
    assert read.shape.volume == pytest.approx(n * one.volume, rel=1e-9)
    assert file.volume == pytest.approx(n * one.volume, rel=1e-12)
    low, high = np.array(read.shape.bounds)
    np.testing.assert_allclose(high - low, 8.0 * np.array(counts), atol=1e-6)
    middle = 4.0 * (np.array(counts) - 1) + np.array(check_shape(one.wrapped).centroid)
    np.testing.assert_allclose(read.shape.centroid, middle, atol=1e-6)
    assert (file.n_copies, file.size) == (n, file.path.stat().st_size)


def test_a_thousand_cells_take_hardly_more_room_than_one(tmp_path: Path) -> None:
    one, many = (
        tpmscad.export_instances("schwarz_p", tmp_path / f"{n}.step", cells=n, verify="kernel", **REQUEST)
        for n in (1, 10)
    )
    assert many.size < one.size + 50_000
    assert many.certificate.n_faces == one.certificate.n_faces
    assert tpmscad.check_step(many.path).products == (
        "schwarz_p sheet cell",
        "schwarz_p sheet row",
        "schwarz_p sheet layer",
        "schwarz_p sheet",
    )


def test_pieces_of_a_cell_that_touch_the_next_one_are_kept(tmp_path: Path) -> None:
    options = {"cell": 10.0, "thickness": 1.0, "tol": 0.05, "phase": (0, 0, 0), "cells": (2, 1, 1)}
    file = tpmscad.export_instances("gyroid", tmp_path / "g.step", **options)
    assert file.certificate.betti[0] == 3
    assert tpmscad.check_step(file.path).shape.solids == 6


def test_the_result_says_what_it_holds(tmp_path: Path) -> None:
    file = tpmscad.export_instances("schwarz_p", tmp_path / "p.step", cells=(3, 2, 1), **REQUEST)
    assert str(file).startswith("p.step: 3 x 2 x 1 copies of one cell, volume")
    assert "\nmet\n" in str(file)
    told = file.to_dict()
    assert (told["copies"], told["cells"], told["file"]) == (6, [3, 2, 1], "p.step")
    assert told["volume"] == pytest.approx(6 * told["cell"]["volume"])


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"map": tpmscad.maps.cylinder(20)}, "under a map no cell is a copy"),
        ({"loose": "drop"}, "touches the next one: leave loose out"),
        ({"cells": (100, 100, 11)}, "100 x 100 x 11 cells are 110000 copies, more than 100000"),
        ({"schema": "ap203"}, "ap203"),
        ({"verify": "all"}, "verify"),
    ],
)
def test_what_cannot_be_placed_is_refused(options: dict[str, Any], words: str, tmp_path: Path) -> None:
    with pytest.raises(InvalidRequest, match=words):
        tpmscad.export_instances("schwarz_p", tmp_path / "p.step", **{**REQUEST, **options})
    assert not list(tmp_path.iterdir())


def test_nothing_is_written_if_the_cell_misses_the_request(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Unmet:
        met, shortfalls = False, ("a gap",)

    monkeypatch.setattr(
        lattice_instances, "make_lattice", lambda *_: type("Made", (), {"certificate": Unmet(), "name": "p"})()
    )
    with pytest.raises(NotMet, match="the cell misses the request: a gap"):
        tpmscad.export_instances("schwarz_p", tmp_path / "p.step", **REQUEST)
    assert not list(tmp_path.iterdir())
