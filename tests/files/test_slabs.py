"""A lattice in slabs: valid solids that add up to the lattice and agree in their cut faces, whoever makes them."""

from __future__ import annotations

import re
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial import cKDTree

import tpmscad
from tpmscad import surfaces
from tpmscad._typing import Array
from tpmscad.errors import InvalidRequest, NotMet
from tpmscad.files._export_slabs import SlabFiles, divide, name_files

pytestmark = pytest.mark.kernel

CELL, CELLS, TOL, STAMP = 10.0, (1, 1, 3), 0.3, "2026-01-01T00:00:00"
REQUEST: dict[str, Any] = {"cell": CELL, "cells": CELLS, "thickness": 1.0, "tol": TOL, "time_stamp": STAMP}


@pytest.fixture(scope="module")
def slabs(tmp_path_factory: pytest.TempPathFactory) -> SlabFiles:
    """Two slabs of a Schwarz P lattice of three cells: of two cells and of one."""
    return tpmscad.export_slabs("schwarz_p", tmp_path_factory.mktemp("slabs") / "p_{:02d}.step", slab=2, **REQUEST)


def points(path: Path, kind: str) -> Array:
    """The points (n, 3) of the vertices ("VERTEX_POINT") or of the curves of a file."""
    text = path.read_text()
    found = dict(re.findall(r"#(\d+)=CARTESIAN_POINT\('[^']*',\(([^)]*)\)\)", text))
    lists = re.findall(rf"={kind}\('[^']*',(?:\d+,)?\(?([#\d,]+)", text)
    used = {number for each in lists for number in re.findall(r"#(\d+)", each)}
    return np.array([[float(x) for x in found[number].split(",")] for number in used if number in found])


def test_every_slab_is_a_valid_closed_solid_of_the_volume_in_the_table(slabs: SlabFiles) -> None:
    assert [s.cells for s in slabs.slabs] == [(1, 1, 2), (1, 1, 1)]
    for path, row in zip(slabs.paths, slabs.slabs, strict=True):
        report = tpmscad.check_step(path)
        assert report.ok
        assert report.shape.volume == pytest.approx(row.volume, rel=1e-9)
        assert report.shape.faces == row.faces
        assert report.shape.bounds[0][2] == pytest.approx(row.origin[2], abs=1e-3)


def test_volumes_add_up_to_that_of_the_surface(slabs: SlabFiles) -> None:
    one_cell = surfaces.volume_fraction("schwarz_p", "minimal", -0.05, 0.05) * CELL**3
    assert slabs.volume == pytest.approx(3 * one_cell, rel=2e-3)  # what the fit to 0.3 allows
    assert slabs.slabs[0].volume == pytest.approx(2 * slabs.slabs[1].volume, rel=1e-10)


@pytest.mark.parametrize("kind", ["VERTEX_POINT", "B_SPLINE_CURVE_WITH_KNOTS"])
def test_cut_faces_of_adjacent_slabs_agree(slabs: SlabFiles, kind: str) -> None:
    below, above = (points(path, kind) for path in slabs.paths)
    top, bottom = (of[np.abs(of[:, 2] - 20) < 1e-6] for of in (below, above))
    assert len(top) >= 16
    for these, others in ((top, bottom), (bottom, top)):
        assert cKDTree(others).query(these)[0].max() < 1e-11
        assert np.abs(these[:, 2] - 20).max() < 1e-11


def test_a_second_run_keeps_whole_files_and_writes_damaged_ones_anew(tmp_path: Path) -> None:
    target = tmp_path / "p.step"
    first = tpmscad.export_slabs("schwarz_p", target, **REQUEST)
    assert tpmscad.export_slabs("schwarz_p", target, **REQUEST).reused == ("p_1.step", "p_2.step", "p_3.step")
    damaged = first.paths[1]
    text = damaged.read_bytes()
    damaged.write_bytes(text.replace(b".T.", b".F.", 1))
    after = tpmscad.export_slabs("schwarz_p", target, **REQUEST)
    assert after.reused == ("p_1.step", "p_3.step")
    assert damaged.read_bytes() == text


class Interrupted(Executor):
    """Runs tasks at once, and is interrupted at the third."""

    def __init__(self) -> None:
        self.begun = 0

    def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Future[Any]:
        self.begun += 1
        future: Future[Any] = Future()
        if self.begun == 3:
            future.set_exception(KeyboardInterrupt())
        else:
            future.set_result(fn(*args, **kwargs))
        return future


def test_an_interrupted_run_leaves_whole_files_only_and_goes_on(tmp_path: Path) -> None:
    target = tmp_path / "p.step"
    with pytest.raises(KeyboardInterrupt):
        tpmscad.export_slabs("schwarz_p", target, executor=Interrupted(), **REQUEST)
    left = {path.name for path in tmp_path.iterdir()} - {"p.slabs.json"}
    assert left <= {"p_1.step", "p_2.step", "p_3.step"}
    assert all(tpmscad.check_step(tmp_path / name).ok for name in left)
    files = tpmscad.export_slabs("schwarz_p", target, **REQUEST)
    assert len(files.slabs) == 3
    assert set(files.reused) <= left
    assert sorted(path.name for path in tmp_path.iterdir()) == ["p.slabs.json", "p_1.step", "p_2.step", "p_3.step"]


def test_a_lattice_divides_into_slabs_or_tiles_with_the_rest_last() -> None:
    assert [s.cells for s in divide((3, 3, 5), 2)] == [(3, 3, 2), (3, 3, 2), (3, 3, 1)]
    tiles = divide((3, 2, 1), (2, 2, 2))
    assert [(s.steps, s.cells) for s in tiles] == [((0, 0, 0), (2, 2, 1)), ((1, 0, 0), (1, 2, 1))]


def test_names_number_the_files() -> None:
    assert name_files(Path("a.step"), 12)[-1] == "a_12.step"
    assert name_files(Path("a_{:03d}.stp"), 2) == ["a_001.stp", "a_002.stp"]
    for name in ("a_{:d}_{}.step", "a_{x}.step", "a_{:q}.step"):
        with pytest.raises(InvalidRequest, match="does not number 2 files"):
            name_files(Path(name), 2)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"map": lambda p: p}, "no slab is a copy of another"),
        ({"boundary": "natural"}, "slabs are cut in planes"),
        ({"loose": "drop"}, "may be a part of the next one"),
        ({"slab": 0}, "slab 0"),
        ({"schema": "ap203"}, "schema 'ap203' is not known"),
    ],
)
def test_what_slabs_cannot_be_is_refused(tmp_path: Path, options: dict[str, Any], message: str) -> None:
    with pytest.raises(InvalidRequest, match=message):
        tpmscad.export_slabs("gyroid", tmp_path / "g.step", **{**REQUEST, **options})
    assert not list(tmp_path.iterdir())


def test_a_slab_that_misses_the_request_is_not_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from tpmscad.solids.matter import patch_measures

    monkeypatch.setattr(patch_measures, "MAX_GAP_CELLS", -1.0)
    with pytest.raises(NotMet, match="a slab misses the request"):
        tpmscad.export_slabs("schwarz_p", tmp_path / "p.step", **REQUEST)
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_a_process_pool_writes_the_same_bytes(slabs: SlabFiles, tmp_path: Path) -> None:
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        pooled = tpmscad.export_slabs("schwarz_p", tmp_path / "p_{:02d}.step", slab=2, executor=pool, **REQUEST)
    assert [s.sha256 for s in pooled.slabs] == [s.sha256 for s in slabs.slabs]
