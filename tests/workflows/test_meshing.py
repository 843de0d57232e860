"""STEP files become second-order meshes in gmsh: size as asked, no element turned over, opposite sides of a cell alike."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import build123d as bd
import numpy as np
import pytest

import tpmscad

pytest.importorskip("gmsh")

pytestmark = [pytest.mark.kernel, pytest.mark.slow]

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "mesh_gmsh.py"


@pytest.fixture(scope="module")
def example() -> ModuleType:
    spec = importlib.util.spec_from_file_location("mesh_gmsh", EXAMPLE)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["mesh_gmsh"] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


def is_as_asked(found: object, size: float, volume: float) -> None:
    assert found.order == 2  # type: ignore[attr-defined]
    assert found.quality.min() > 0.0  # type: ignore[attr-defined]
    assert np.mean(found.size) == pytest.approx(size, rel=0.1)  # type: ignore[attr-defined]
    assert np.mean(np.abs(found.size / size - 1.0) < 0.3) > 0.75  # type: ignore[attr-defined]
    assert found.volume == pytest.approx(volume, rel=1e-3)  # type: ignore[attr-defined]


def exported(model: object, folder: Path) -> tuple[Path, float]:
    path = folder / "part.step"
    tpmscad.export_step(model, path)
    return path, tpmscad.check_step(path).shape.volume


@pytest.mark.parametrize("size", [0.9])
def test_a_cell_is_meshed_periodically(example: ModuleType, tmp_path: Path, size: float) -> None:
    path, volume = exported(example.cell(), tmp_path)
    found = example.mesh(path, size, periodic=True)
    is_as_asked(found, size, volume)
    assert found.periodic_nodes > 6 * (
        10.0 * 1.5 / size**2
    )  # the caps of three sides, walls of 1.5 on more than 10 each
    assert found.mismatch < 1e-6
    assert path.with_suffix(".msh").stat().st_size > 0


@pytest.mark.parametrize(
    ("surface", "size", "kind"),
    [("diamond", 0.6, {"thickness": 1.2}), ("schwarz_p", 1.0, {"volume_fraction": 0.4, "kind": "skeletal"})],
)
def test_other_cells_are_periodic_too(
    example: ModuleType, tmp_path: Path, surface: str, size: float, kind: dict[str, object]
) -> None:
    path, volume = exported(tpmscad.lattice(surface, cell=10, tol=0.02, **kind), tmp_path)
    found = example.mesh(path, size, periodic=True)
    is_as_asked(found, size, volume)
    assert found.periodic_nodes > 0
    assert found.mismatch < 1e-6


def test_an_infilled_part_is_meshed(example: ModuleType, tmp_path: Path) -> None:
    path, volume = exported(example.part(), tmp_path)
    is_as_asked(example.mesh(path, 1.0), 1.0, volume)


def test_sides_that_differ_are_not_taken_for_periodic(example: ModuleType, tmp_path: Path) -> None:
    path, _ = exported(bd.Box(4, 4, 4) - bd.Pos(0, 0, 2) * bd.Cylinder(1, 2), tmp_path)
    with pytest.raises(ValueError, match="faces at one side along z"):
        example.mesh(path, 1.0, periodic=True)
