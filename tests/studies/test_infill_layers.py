"""Layers of a filled body without its solid are those of the solid."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import build123d as bd
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import tpmscad
from tests.cli.test_cli import run
from tpmscad.brep.sections.polygon_regions import combine_regions
from tpmscad.sources.catalogue_sources import lattice_source

pytest.importorskip("manifold3d")
pytestmark = pytest.mark.kernel

CHORD_ERROR = 0.005


def signed_area(contours: Any) -> float:
    return float(sum(0.5 * (x @ np.roll(y, -1) - y @ np.roll(x, -1)) for x, y in (c.T for c in contours)))


BOSS = bd.Pos(1.2, 0.3, 0) * bd.Cylinder(0.8, 2.8)
BOLTS = bd.Compound([bd.Pos(1.1, 0.2, 0) * bd.Cylinder(0.3, 3), bd.Pos(0.6, 0.1, 0) * bd.Cylinder(0.4, 3.2)])

CASES: dict[str, tuple[bd.Shape, str, dict[str, Any]]] = {
    "cone": (bd.Cone(2.4, 1.3, 2), "gyroid", {"cell": 2, "thickness": 0.3, "tol": 0.01}),
    "turned": (
        bd.Pos(0.3, 0.5, 0) * bd.Box(2.9, 2.1, 1.7),
        "P",
        {"cell": 2, "thickness": 0.3, "tol": 0.01, "rotation": (0, 0, 25)},
    ),
    "rods": (bd.Box(2.1, 1.9, 1.2), "diamond", {"cell": 2, "kind": "skeletal", "volume_fraction": 0.3, "tol": 0.01}),
    "skin": (
        bd.Cylinder(1.5, 1.5) - bd.Cylinder(0.5, 1.5),
        "gyroid",
        {"cell": 2, "thickness": 0.3, "tol": 0.01, "skin": 0.2},
    ),
    "open": (
        bd.Box(2, 2.2, 1.5),
        "gyroid",
        {"cell": 2, "thickness": 0.3, "tol": 0.01, "skin": 0.2, "open_faces": "<X"},
    ),
    "boss": (bd.Cylinder(1.6, 2), "P", {"cell": 2, "thickness": 0.3, "tol": 0.01, "keep": BOSS, "clear": BOLTS}),
    "within": (
        bd.Box(3.3, 2.5, 2),
        "gyroid",
        {
            "cell": 2,
            "thickness": 0.3,
            "tol": 0.01,
            "skin": 0.2,
            "keep": bd.Pos(0.3, 0.2, 0) * bd.Cylinder(0.8, 2),
            "clear": BOLTS,
        },
    ),
    "bosses": (
        bd.Box(3.1, 2.5, 1.4) - bd.Pos(0.6, 0.2, 0) * bd.Cylinder(0.3, 3),
        "gyroid",
        {"cell": 2, "thickness": 0.3, "tol": 0.01, "keep": ("bosses", 0.4)},
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_layers_are_those_of_the_solid(name: str) -> None:
    body, surface, asked = CASES[name]
    height = 0.1 if "skin" in asked else 0.2  # layers that a skin ends in are cut once
    layers = tpmscad.infill_layers(body, surface, height=height, chord_error=CHORD_ERROR, **asked)
    solid = tpmscad.infill(body, surface, loose="keep", **asked)
    expected = solid.slices(height, CHORD_ERROR)
    assert len(layers) == len(expected)
    assert layers.n_points < expected.n_points
    for own, other in zip(layers, expected, strict=True):
        assert (own.bottom, own.top) == pytest.approx((other.bottom, other.top), abs=1e-7)
        # exact areas on both sides; the share of chords along the outline is that of the mean cell
        assert own.area == pytest.approx(other.area, abs=0.1 * CHORD_ERROR * other.perimeter)
        assert own.perimeter == pytest.approx(other.perimeter, rel=0.01)
        assert signed_area(own.contours) == pytest.approx(own.area, abs=CHORD_ERROR * own.perimeter)
    assert layers.volume == pytest.approx(solid.volume, rel=2e-3)


def test_what_is_kept_is_whole_and_what_is_cleared_is_empty() -> None:
    """A boss with a hole stands on a plate: above it the layers are a ring, within it they hold one."""
    boss, bolt = (bd.Pos(0.1, 0.2, 0.5) * bd.Cylinder(radius, height) for radius, height in ((0.6, 2), (0.3, 4)))
    layers = tpmscad.infill_layers(
        bd.Box(2, 2, 1), "P", cell=2, thickness=0.3, height=0.25, chord_error=CHORD_ERROR, keep=boss, clear=bolt
    )
    turns = np.linspace(0, 2 * np.pi, 65)[:-1]
    circle = np.stack([np.cos(turns), np.sin(turns)], axis=1)
    ring, hole = [0.59 * circle + (0.1, 0.2), 0.31 * circle[::-1] + (0.1, 0.2)], [0.29 * circle + (0.1, 0.2)]
    assert len(layers) == 8
    for layer in layers:
        contours = list(layer.contours)
        if layer.bottom >= 0.5:
            assert layer.area == pytest.approx(np.pi * (0.6**2 - 0.3**2), rel=1e-4)
        assert signed_area(combine_regions(ring, contours, "difference")) == 0.0
        assert signed_area(combine_regions(hole, contours, "intersection")) == 0.0


def test_a_cavity_between_two_planes_leaves_their_layers_whole() -> None:
    layers = tpmscad.infill_layers(bd.Box(4, 4, 2), "P", cell=2, thickness=0.3, skin=0.95, height=0.25)
    assert [layer.area for layer in layers] == pytest.approx([16.0] * 8)


def test_the_volume_of_a_layer_is_right_where_a_lid_ends_within_it() -> None:
    """The lids of a skin of .2 end within layers of .25, and between layers of .05."""
    asked: dict[str, Any] = {"cell": 2, "thickness": 0.3, "skin": 0.2, "chord_error": 0.01}
    coarse, fine = (
        np.array([layer.volume for layer in tpmscad.infill_layers(bd.Box(4, 4, 2), "P", height=height, **asked)])
        for height in (0.25, 0.05)
    )
    np.testing.assert_allclose(coarse[[0, -1]], fine.reshape(8, 5).sum(axis=1)[[0, -1]], rtol=1e-3)


def test_a_box_of_many_cells_has_the_volume_of_its_cells() -> None:
    """8 x 8 whole cells: the volume fraction is that of one cell, which the certificate of a lattice states."""
    layers = tpmscad.infill_layers(
        bd.Pos(8, 8, 1) * bd.Box(16, 16, 2), "P", cell=2, thickness=0.3, height=0.066, chord_error=0.02
    )
    cell = tpmscad.lattice("P", cell=2, thickness=0.3, phase=(0, 0, 0))
    assert layers.volume == pytest.approx(64 * cell.volume, rel=2e-5)
    assert len(layers) == 31


def test_layers_of_a_graded_wall_follow_its_thickness() -> None:
    """A function that is constant gives the layers of the number; another one its walls, in cells that are tilted, too."""
    body = bd.Cylinder(1.6, 1.7)
    asked: dict[str, Any] = {"cell": 1.2, "height": 0.17, "chord_error": 0.01, "skin": 0.2}
    even = tpmscad.infill_layers(body, "gyroid", thickness=0.2, **asked)
    graded = tpmscad.infill_layers(body, "gyroid", thickness=lambda p: 0.2 + 0 * p[..., 0], **asked)
    for own, other in zip(graded, even, strict=True):
        assert own.area == pytest.approx(other.area, abs=0.5 * 0.01 * other.perimeter)
        assert own.perimeter == pytest.approx(other.perimeter, rel=0.02)
        assert signed_area(own.contours) == pytest.approx(own.area, abs=0.01 * own.perimeter)

    def thickness(points: Any) -> Any:
        return 0.15 + 0.05 * points[..., 2] + 0.02 * points[..., 0]

    del asked["skin"]
    turn = Rotation.from_euler("XYZ", (10, 20, 0), degrees=True).as_matrix()
    tilted = tpmscad.infill_layers(body, "gyroid", thickness=thickness, rotation=(10, 20, 0), **asked)
    mid = lattice_source("gyroid", "minimal").mid_surface((1.2,) * 3, (1, 1, 1), np.zeros(3), None)
    middles = [(0.5 * (layer.bottom + layer.top), np.concatenate(layer.contours)) for layer in tilted]
    points = np.concatenate([np.insert(at, 2, z, axis=1) for z, at in middles])
    points = points[(np.hypot(*points.T[:2]) < 1.5) & (np.abs(points[:, 2]) < 0.8)][::23]
    cell = np.floor(points @ turn / 1.2) * 1.2
    distance, foot = mid.distance_and_foot(points @ turn - cell)
    assert len(points) > 100
    assert np.abs(np.abs(distance) - 0.5 * thickness((foot + cell) @ turn.T)).max() < 0.01
    triangles = tpmscad.infill_triangles(
        body, "gyroid", cell=1.2, thickness=thickness, rotation=(10, 20, 0), deviation=0.005, loose="keep"
    )
    assert tilted.volume == pytest.approx(
        triangles.volume, rel=1e-3
    )  # a quadrature over layers a seventh of a cell high


def test_what_has_no_equal_cells_in_its_layers_is_refused() -> None:
    box = bd.Box(3, 3, 3)
    asked: dict[str, Any] = {"cell": 2, "thickness": 0.3, "height": 0.1}
    with pytest.raises(tpmscad.InvalidRequest, match="rotate about z only"):
        tpmscad.infill_layers(box, "P", rotation=(10, 0, 0), **asked)
    with pytest.raises(tpmscad.InvalidRequest, match="slice the solid"):
        tpmscad.infill_layers(box, "P", map=lambda p: p, **asked)
    with pytest.raises(tpmscad.InvalidRequest, match="give skin="):
        tpmscad.infill_layers(box, "P", open_faces=">Z", **asked)
    with pytest.raises(tpmscad.InvalidRequest, match="heights are in mm"):
        tpmscad.infill_layers(box, "P", **(asked | {"height": 1e-6}))


def test_the_command_writes_layers(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    part, layers, report = (tmp_path / name for name in ("part.step", "part.cli", "part.json"))
    bd.export_step(bd.Box(4, 4, 1), part)
    bd.export_step(bd.Pos(0.2, 0.1, 0.25) * bd.Box(1, 1, 1.5), tmp_path / "boss.step")
    line = f"infill {part} P --cell 2 --thickness 0.3"
    assert run(f"{line} --layer 0.25 --keep {tmp_path / 'boss.step'} -o {tmp_path / 'kept.svg'}") == 0
    assert "6 layers" in capsys.readouterr().out
    assert run(f"{line} --layer 0.25 -o {layers} --report {report}") == 0
    assert "4 layers" in capsys.readouterr().out
    assert json.loads(report.read_text())["layers"] == layers.read_text().count("$$LAYER/") == 4
    assert run(f"{line} -o {layers}") == 2
    assert "--layer" in capsys.readouterr().err
    assert run(f"{line} --layer 0.25 -o {tmp_path / 'part.step'}") == 2
