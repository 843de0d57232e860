"""A filled body as whole cells and cut layers: parts, volumes and places are those of the filled body, read by the kernel."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import build123d as bd
import numpy as np
import pytest

import tpmscad
from tpmscad import fields
from tpmscad.brep.winding_numbers import winding_numbers
from tpmscad.errors import InvalidRequest, KernelError
from tpmscad.files import _export_infill
from tpmscad.files.infill_parts import divide_body
from tpmscad.kernel.boolean.cell_regions import are_translates, clear_diagonals, describe_region, make_box
from tpmscad.kernel.export.solid_mesh import mesh_solids
from tpmscad.kernel.step.entity_table import read_entity_table
from tpmscad.kernel.step.joined_files import check_joined, find_part, renumber
from tpmscad.kernel.step.product_entities import MassProperties
from tpmscad.kernel.step.step_reader import read_step

pytestmark = pytest.mark.kernel

CELL: dict[str, Any] = {"cell": 1, "tol": 0.02}
WALL = CELL | {"thickness": 0.2}
CHORD_ERROR = 0.01
NO_MASS = MassProperties(1.0, 1.0, (0.0, 0.0, 0.0))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("body", "surface", "asked"),
    [
        (
            bd.Pos(0.02, 0.01, 0) * bd.Cylinder(0.85, 1.16),
            "gyroid",
            {"kind": "skeletal", "offset": 0.1, "rotation": (0, 0, 35), "phase": (0.38, 0.41, 0.44)},
        ),
        (
            bd.Box(1.6, 1.65, 2.6),
            "schwarz_p",
            {"thickness": 0.2, "skin": 0.25, "open_faces": ">Z", "phase": (0.38, 0.41, 0.04)},
        ),
    ],
    ids=["turned", "skin"],
)
def test_parts_make_up_the_filled_body(body: bd.Shape, surface: str, asked: dict[str, Any], tmp_path: Path) -> None:
    file = tpmscad.export_infill(body, surface, tmp_path / "parts.step", **CELL, **asked)
    solid = tpmscad.infill(body, surface, **CELL, **asked, loose="keep")
    read = read_step(file.path, healed=False)
    assert file.whole_cells > 0
    assert len(read.solids) == file.parts
    meshes = [mesh_solids(one, CHORD_ERROR, 0.4)[0] for one in read.solids]
    assert sum(mesh.volume for mesh in meshes) == pytest.approx(file.volume, abs=0.5 * CHORD_ERROR * file.area)
    assert file.volume == pytest.approx(solid.volume, abs=0.5 * WALL["tol"] * solid.area)
    low, high = np.array(solid.bounding_box)
    points = np.random.default_rng(3).uniform(low, high, (4000, 3))
    whole = mesh_solids(solid.wrapped, CHORD_ERROR, 0.4)
    inside = np.sum([winding_numbers(mesh.points, mesh.triangles, points) for mesh in whole], axis=0)
    counted = np.sum([winding_numbers(mesh.points, mesh.triangles, points) for mesh in meshes], axis=0)
    assert counted.max() == 1, "parts overlap"
    box = float(np.prod(high - low))
    # both lie within tol of the surface, the meshes within the chord error of both
    within_tolerances = solid.area * (WALL["tol"] + CHORD_ERROR) / box
    assert np.mean(counted != inside) < 0.5 * within_tolerances


@pytest.mark.parametrize(("core", "skin"), [("square", None), ("re-entrant", 0.7)])
def test_cells_of_a_core_reach_from_end_to_end_of_a_tilted_panel(core: str, skin: float | None, tmp_path: Path) -> None:
    axis = (1.0, 2.0, 2.0)
    body = bd.Plane((3, 4, 5), z_dir=axis).location * bd.Box(30, 26, 5)
    mirrored = fields.core(core, 6, 0.4, axis=(1, 2, -2)).move(np.diag([1.0, 1.0, -1.0]), np.zeros(3), 1.0)
    field = mirrored if core == "square" else fields.core(core, 6, 0.4, axis=axis)
    file = tpmscad.export_infill(body, field, tmp_path / "parts.step", tol=0.02, skin=skin)
    solid = tpmscad.infill(body, field, tol=0.02, skin=skin, loose="keep")
    assert file.whole_cells > 0
    assert file.volume == pytest.approx(solid.volume, rel=1e-9)
    assert len(read_step(file.path, healed=False).solids) == file.parts


def test_equal_layers_are_stored_once() -> None:
    body = bd.Cylinder(2.2, 5.3)
    layers = divide_body([body.wrapped], np.array([0.11, 0.07, 0.05]), np.ones(3), 1)
    originals = [original for _, original, _ in layers.layers]
    assert layers.axis == 2
    assert originals == [0, 1, 1, 1, 1, 5]
    assert layers.volume == pytest.approx(np.pi * 2.2**2 * 5.3, rel=1e-9)
    cone = divide_body([bd.Cone(2.2, 2.0, 5.3).wrapped], np.array([0.11, 0.07, 0.05]), np.ones(3), 1)
    assert [original for _, original, _ in cone.layers] == [0, 1, 2, 3, 4, 5]


def test_translates_are_told_from_others() -> None:
    box = describe_region([make_box(np.zeros(3), np.array([1.0, 2.0, 3.0]))])
    moved = describe_region([make_box(np.array([0.0, 0.0, 4.0]), np.array([1.0, 2.0, 7.0]))])
    other = describe_region([make_box(np.array([0.0, 0.0, 4.0]), np.array([1.0, 2.0, 7.0 + 1e-6]))])
    shift = np.array([0.0, 0.0, 4.0])
    assert are_translates(box, moved, shift)
    assert not are_translates(box, other, shift)
    assert not are_translates(box, moved, shift + 1e-6)


def test_no_two_whole_cells_touch_along_an_edge_only() -> None:
    whole = np.random.default_rng(1).random((40, 40)) < 0.5
    kept = clear_diagonals(whole)
    a, b, c, d = kept[:-1, :-1], kept[1:, :-1], kept[:-1, 1:], kept[1:, 1:]
    assert not ((a & d & ~b & ~c) | (b & c & ~a & ~d)).any()
    assert not (kept & ~whole).any()
    stairs = np.eye(4, dtype=bool) | np.eye(4, k=1, dtype=bool)
    assert np.array_equal(clear_diagonals(stairs), stairs)


def test_joined_text_is_that_of_the_parts(tmp_path: Path) -> None:
    tpmscad.lattice("P", cell=1, thickness=0.2).export_step(tmp_path / "part.step")
    part = find_part(tmp_path / "part.step", NO_MASS)
    own, joined = (tmp_path / "part.step").read_text(), "".join(renumber(part.path, 700))
    body = own[own.index("\nDATA;\n") + 7 : own.index("ENDSEC;\nEND-ISO")]
    assert joined == re.sub(r"#(\d+)", lambda found: f"#{int(found[1]) + 700}", body)
    whole = tmp_path / "joined.step"
    frame = own[: own.index("\nDATA;\n") + 7]

    def write(text: str) -> None:
        whole.write_text(f"{frame}{text}ENDSEC;\nEND-ISO-10303-21;\n")

    write(joined)
    check_joined(read_entity_table(whole), part, 700)
    for old, new in ((r"=ORIENTED_EDGE\('',\*,\*,#(\d+)", "=ORIENTED_EDGE('',*,*,#701"), (r"\((0\.\d+),", "(0.123,")):
        write(re.sub(old, new, joined, count=1))
        with pytest.raises(KernelError, match=r"part\.step"):
            check_joined(read_entity_table(whole), part, 700)


def test_of_a_large_file_the_kernel_reads_an_excerpt_with_every_solid(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(_export_infill, "KERNEL_READ_LIMIT", 0)
    file = tpmscad.export_infill(bd.Box(7, 7, 2), "square", tmp_path / "parts.step", cell=2, thickness=0.2)
    table = read_entity_table(file.path)
    with pytest.raises(KernelError, match=f"of {file.parts + 1} solids the kernel reads {file.parts}"):
        _export_infill._verify(file.path, table, volume=file.volume, parts=file.parts + 1, whole=False)


def test_refusals_name_the_remedy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    box, path = bd.Box(3, 3, 3), tmp_path / "parts.step"
    with pytest.raises(InvalidRequest, match="leave loose out"):
        tpmscad.export_infill(box, "gyroid", path, **WALL, loose="drop")
    with pytest.raises(InvalidRequest, match="step"):
        tpmscad.export_infill(box, "gyroid", tmp_path / "parts.stl", **WALL)
    for passive in ("keep", "clear"):
        with pytest.raises(InvalidRequest, match=r"export the solid, infill\(...\)\.export_step\(path\)"):
            tpmscad.export_infill(box, "gyroid", path, **WALL, **{passive: bd.Box(1, 1, 1)})
    monkeypatch.setattr(_export_infill, "MAX_COPIES", 3)
    with pytest.raises(InvalidRequest, match=r"more than the 3 parts that .*infill_layers"):
        tpmscad.export_infill(box, "gyroid", path, **WALL)
    assert not list(tmp_path.iterdir())


def test_what_has_no_copies_of_cells_is_refused(tmp_path: Path) -> None:
    asked: dict[str, Any] = {"path": tmp_path / "part.step"}
    with pytest.raises(InvalidRequest, match=r"no cell is a copy.*infill_triangles"):
        tpmscad.export_infill(bd.Box(3, 3, 3), "P", cell=1, thickness=lambda p: 0.1 + 0.01 * p[..., 0], **asked)
    with pytest.raises(InvalidRequest, match=r"made of copies.*infill_triangles"):
        tpmscad.export_infill(bd.Box(3, 3, 3), fields.sphere((0, 0, 0), 1), tol=0.01, **asked)
    for body in (bd.Sphere(20), bd.Box(20, 20, 6) + bd.Pos(5, 0, 5) * bd.Cylinder(2, 6)):
        with pytest.raises(InvalidRequest, match=r"no cell of the square core ends in two planes.*infill_layers"):
            tpmscad.export_infill(body, "square", cell=4, thickness=0.4, **asked)
