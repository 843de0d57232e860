"""Lattices from request to STEP file and back: the promises of the public function, measured on its results."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tpmscad
from tpmscad import maps, surfaces
from tpmscad.brep.boundary_representation import Brep
from tpmscad.errors import TrimmingError
from tpmscad.solids.matter.lattice_block import (
    BOX_TRIM_ROUND_OFF_CELLS,
    BOX_TRIM_TOL_CELLS,
    MAX_BOX_TRIM_TOL,
    find_trim_tolerance,
)
from tpmscad.trimming.network_boolean import NetworkResult, combine_networks

pytestmark = pytest.mark.kernel

CELL = 8.0


def closed_form(name: str, lower: float, upper: float, reference: str = "minimal") -> float:
    """Volume of a sheet per cell, by Steiner's formula."""
    return CELL**3 * surfaces.volume_fraction(name, reference, lower / CELL, upper / CELL)


def test_cuts_are_as_exact_as_the_cell_allows_and_never_below_round_off() -> None:
    assert find_trim_tolerance(0.002) == pytest.approx(0.002 * BOX_TRIM_TOL_CELLS)
    assert find_trim_tolerance(20.0) == pytest.approx(20.0 * BOX_TRIM_TOL_CELLS)
    assert find_trim_tolerance(500.0) == MAX_BOX_TRIM_TOL
    assert find_trim_tolerance(1e6) == pytest.approx(1e6 * BOX_TRIM_ROUND_OFF_CELLS)


@pytest.mark.slow
def test_a_sheet_in_a_box_has_the_volume_that_theory_gives_in_memory_and_in_its_file(tmp_path: Path) -> None:
    model = tpmscad.lattice("gyroid", cell=CELL, offset=(-0.3, 0.5), phase=(0.31, 0.07, 0.77), loose="keep", tol=1e-4)
    assert model.certificate.met, model.certificate.shortfalls
    assert model.certificate.volume == pytest.approx(closed_form("gyroid", -0.3, 0.5), rel=1e-5)
    model.export_step(tmp_path / "sheet.step")
    assert "faces" not in vars(model.built)  # it is certified, written and verified without the kernel's solid
    read = tpmscad.check_step(tmp_path / "sheet.step")
    assert read.ok
    assert read.shape.volume == pytest.approx(model.certificate.volume, rel=1e-9)
    assert read.shape.faces == model.certificate.n_faces == len(model.built.faces)
    assert read.shape.solids == len(model.certificate.pieces)
    np.testing.assert_allclose(read.shape.bounds, [[0, 0, 0], [CELL] * 3], rtol=0, atol=1e-6)
    assert model.solid.is_valid


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "reference", "phase"),
    [("diamond", "minimal", (0, 0, 0)), ("schwarz_p", "nodal", (0, 0, 0)), ("frd", "nodal", None)],
)
def test_the_two_sides_of_a_surface_fill_the_box(name: str, reference: str, phase: Any) -> None:
    same: dict[str, Any] = {"cell": CELL, "kind": "skeletal", "reference": reference, "phase": phase, "loose": "keep"}
    halves = [tpmscad.lattice(name, side=s, offset=0.1, tol=1e-3, **same) for s in "-+"]
    assert all(half.certificate.met for half in halves)
    assert sum(half.certificate.volume for half in halves) == pytest.approx(CELL**3, rel=1e-8)
    for half, side in zip(halves, "-+", strict=True):
        expected = CELL**3 * surfaces.skeletal_volume_fraction(name, reference, 0.1 / CELL, side)
        assert half.certificate.volume == pytest.approx(expected, rel=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "cells", "boundary", "phase"),
    [("iwp", (2, 1, 1), "natural", (0.1, 0.2, 0.3)), ("neovius", (1, 1, 1), "box", (0.13, 0.21, -0.34))],
)
def test_a_mirrored_sheet_is_certified(
    name: str, cells: tuple[int, int, int], boundary: str, phase: tuple[float, float, float]
) -> None:
    where: dict[str, Any] = {"cells": cells, "boundary": boundary, "phase": phase}
    model = tpmscad.lattice(name, cell=CELL, offset=(-0.2, 0.15), loose="keep", tol=1e-3, **where)
    certificate = model.certificate
    assert certificate.met, certificate.shortfalls
    expected = np.prod(cells) * closed_form(name, -0.2, 0.15, "nodal")
    assert certificate.volume == pytest.approx(expected, rel=1e-4)
    assert certificate.reference == f"nodal {name} surface"
    low = CELL * np.array(phase) if boundary == "natural" else np.zeros(3)
    np.testing.assert_allclose(model.bounding_box, [low, low + CELL * np.array(cells)], rtol=0, atol=1e-6)


@pytest.mark.slow
def test_patches_whose_cuts_cannot_be_traced_are_fitted_closer_and_it_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: dict[str, Any] = {"cell": 2.0, "thickness": 0.2, "phase": (0.1, 0.2, 0.3), "tol": 9e-3}
    coarse = tpmscad.lattice("gyroid", **asked).certificate

    def cut_in_part(first: Brep, second: Brep, *args: Any, **options: Any) -> NetworkResult:
        failed.append(1)
        if len(failed) == 1:
            raise TrimmingError("not today")
        return combine_networks(first, second, *args, **options)

    failed: list[int] = []
    monkeypatch.setattr("tpmscad.solids._lattice.combine_networks", cut_in_part)
    certificate = tpmscad.lattice("gyroid", **asked).certificate
    assert certificate.met
    assert certificate.max_deviation < coarse.max_deviation
    assert "fitted to 0.0009: the cuts of coarser patches could not be traced" in certificate.notes


@pytest.mark.slow
def test_a_cell_of_a_metre_is_written_as_a_valid_solid(tmp_path: Path) -> None:
    options: dict[str, Any] = {"volume_fraction": 0.153, "phase": (-0.0883, 0.794, -0.636)}
    model = tpmscad.lattice("schwarz_p", cell=1000, tol=5.24, **options)
    model.export_step(tmp_path / "metre.step")
    assert model.volume == pytest.approx(0.153e9, rel=5e-3)


@pytest.mark.parametrize(
    ("name", "asked"),
    [
        ("gyroid", {"reference": "nodal", "boundary": "natural"}),
        ("diamond", {"reference": "minimal", "boundary": "natural"}),
        ("iwp", {"cells": (2, 1, 1), "phase": (0, 0, 0)}),
        ("iwp", {"cells": (2, 1, 1), "phase": (0, 0, 0), "kind": "skeletal"}),
    ],
)
def test_a_volume_fraction_is_met(name: str, asked: dict[str, Any]) -> None:
    certificate = tpmscad.lattice(name, cell=CELL, volume_fraction=0.2, tol=1e-3, **asked).certificate
    assert certificate.met
    assert certificate.volume == pytest.approx(0.2 * np.prod(asked.get("cells", 1)) * CELL**3, rel=1e-4)
    if "phase" in asked:
        assert certificate.gap < 1e-12  # in the planes of its mirrors nothing is cut


def test_volume_and_topology_grow_with_the_block() -> None:
    cells = (1, 3, 2)
    one = tpmscad.lattice("gyroid", cell=CELL, thickness=0.8, tol=1e-2).certificate
    many = tpmscad.lattice("gyroid", cell=CELL, cells=cells, thickness=0.8, tol=1e-2).certificate
    assert many.met
    assert many.volume == pytest.approx(np.prod(cells) * one.volume, rel=1e-7)
    assert many.n_primitives == one.n_primitives


@pytest.mark.slow
@pytest.mark.parametrize("boundary", ["box", "natural"])
def test_an_instanced_file_places_one_cell_many_times(boundary: str, tmp_path: Path) -> None:
    model = tpmscad.lattice(
        "schwarz_p", cell=CELL, cells=(2, 1, 2), thickness=0.8, tol=0.1, boundary=boundary, phase=(0.125, 0.25, 0)
    )
    model.export_step(tmp_path / "cells.step", instanced=True)
    found = tpmscad.check_step(tmp_path / "cells.step")
    assert found.ok
    assert found.shape.solids == 4
    assert found.shape.volume == pytest.approx(model.volume, rel=1e-7)
    np.testing.assert_allclose(found.shape.bounds, model.bounding_box, rtol=0, atol=1e-6)
    assert (tmp_path / "cells.step").read_text().count("MANIFOLD_SOLID_BREP(") == 1


def bar(p: np.ndarray) -> np.ndarray:
    return np.stack([p[..., 0], p[..., 1], p[..., 2] + 2 * np.sin(2 * np.pi * p[..., 0] / (2 * CELL))], axis=-1)


MAPPED: dict[str, dict[str, Any]] = {
    "anisotropic": {"cell": (8, 8, 11)},
    "graded": {"cell": CELL, "map": maps.grading(0, (1.0, 2.0), CELL)},
    "sine-bent": {"cell": CELL, "cells": (2, 1, 1), "map": bar, "boundary": "natural"},
}


@pytest.mark.slow
@pytest.mark.parametrize("case", MAPPED)
def test_mapped_lattices_are_certified_and_written(case: str, tmp_path: Path) -> None:
    model = tpmscad.lattice("schwarz_p", thickness=0.6, tol=0.02, **MAPPED[case])
    assert model.certificate.met, model.certificate.shortfalls
    assert model.certificate.tangent_jump_deg < 1e-5
    model.export_step(tmp_path / "mapped.step")  # which reads it back


def test_a_result_that_misses_its_tolerance_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    from tpmscad.lattices import primitive

    monkeypatch.setattr(primitive, "DEGREES", (5,))
    primitive.fit_primitive.cache_clear()
    certificate = tpmscad.lattice("gyroid", cell=CELL, thickness=0.8, tol=1e-3, boundary="natural").certificate
    primitive.fit_primitive.cache_clear()
    assert not certificate.met
    assert "deviation" in certificate.shortfalls[0]
