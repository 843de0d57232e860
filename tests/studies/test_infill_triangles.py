"""Triangles of filled bodies without their solid are those of the solid, within the deviation asked."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import build123d as bd
import numpy as np
import pytest

import tpmscad
from tests.cli.test_cli import run
from tpmscad.brep.triangles.closed_mesh import SolidMesh, join_meshes
from tpmscad.brep.winding_numbers import winding_numbers
from tpmscad.errors import OutOfMemory
from tpmscad.kernel.export.solid_mesh import mesh_solids
from tpmscad.sources.catalogue_sources import lattice_source
from tpmscad.studies._infill_triangles import _drop_loose_pieces

pytest.importorskip("manifold3d")
trimesh = pytest.importorskip("trimesh")
pytestmark = pytest.mark.kernel

DEVIATION = 0.02

IN_A_CELL = bd.Pos(0.93, 0.88, 0.84)  # the middle of a cell of 1.5

CASES: dict[str, tuple[bd.Shape, str, dict[str, Any]]] = {
    "cone": (IN_A_CELL * bd.Cone(1.6, 1.3, 1.9), "gyroid", {"cell": 1.5, "thickness": 0.25, "tol": 0.01}),
    "turned": (
        bd.Pos(0.3, 0.5, 0) * bd.Box(2.9, 1.9, 1.8),
        "P",
        {"cell": 1.7, "thickness": 0.25, "tol": 0.01, "rotation": (15, 0, 25)},
    ),
    "rods": (
        IN_A_CELL * bd.Box(1.9, 1.8, 1.7),
        "diamond",
        {"cell": 1.5, "kind": "skeletal", "offset": -0.05, "tol": 0.01},
    ),
    "skin": (
        bd.Cylinder(1.7, 2) - bd.Cylinder(0.5, 2),
        "gyroid",
        {"cell": 1.5, "thickness": 0.25, "tol": 0.01, "skin": 0.2},
    ),
    "open": (
        IN_A_CELL * bd.Box(2.2, 2.3, 2.1),
        "gyroid",
        {"cell": 1.5, "thickness": 0.25, "tol": 0.01, "skin": 0.2, "open_faces": "<X,>Z"},
    ),
    "boss": (
        bd.Pos(2.45, 0.88, 0.84) * bd.Box(5.2, 2.3, 2.1),
        "P",
        {
            "cell": 1.5,
            "thickness": 0.25,
            "tol": 0.01,
            "keep": bd.Pos(3.9, 0.9, 0.8) * bd.Box(2, 2, 3),  # which holds a whole cell
            "clear": bd.Pos(2.75, 0.5, 0) * bd.Cylinder(0.35, 5),
        },
    ),
    "within": (
        IN_A_CELL * bd.Box(2.2, 2.3, 2.1),
        "gyroid",
        {
            "cell": 1.5,
            "thickness": 0.25,
            "tol": 0.01,
            "skin": 0.2,
            "keep": IN_A_CELL * bd.Cylinder(0.6, 2.1),
            "clear": IN_A_CELL * bd.Cylinder(0.3, 3),
        },
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_triangles_are_those_of_the_solid(name: str, tmp_path: Path) -> None:
    body, surface, asked = CASES[name]
    part = tpmscad.infill_triangles(body, surface, deviation=DEVIATION, **asked)
    solid = tpmscad.infill(body, surface, **asked)
    assert (part.whole_cells > 0) == (name in ("cone", "rods", "open", "boss"))
    part.write(tmp_path / "part.stl")
    read = trimesh.load(tmp_path / "part.stl")
    assert read.is_watertight
    assert read.is_winding_consistent
    assert read.volume == pytest.approx(part.volume, rel=1e-5)
    assert abs(part.volume - solid.volume) < 0.6 * DEVIATION * solid.area
    assert part.n_pieces == len(solid.certificate.pieces)
    assert np.allclose(part.bounding_box, solid.bounding_box, atol=DEVIATION)
    expected = join_meshes(list(mesh_solids(solid.wrapped, 0.2 * DEVIATION, 0.3)))
    assert np.allclose(part.center_of_mass, expected.center_of_mass, atol=2 * DEVIATION)


def test_what_is_kept_is_whole_and_what_is_cleared_is_empty() -> None:
    """A boss that several cells lie in, with a hole."""
    asked: dict[str, Any] = {"cell": 1, "thickness": 0.15, "rotation": (0, 0, 20), "deviation": DEVIATION}
    boss, bolt = (bd.Pos(1.2, 0, 0) * bd.Cylinder(radius, height) for radius, height in ((1.6, 3.6), (0.3, 5)))
    part = tpmscad.infill_triangles(bd.Box(6.2, 4.3, 3.1), "P", **asked, keep=boss, clear=bolt)
    points = np.random.default_rng(5).uniform((-0.4, -1.6, -1.8), (2.8, 1.6, 1.8), (2000, 3))
    radius = np.hypot(points[:, 0] - 1.2, points[:, 1])
    found = winding_numbers(part.points, part.triangles, points)
    assert part.whole_cells > 4
    assert (found[(radius > 0.3) & (radius < 1.6 - DEVIATION)] == 1).all()
    assert (found[radius < 0.3 - DEVIATION] == 0).all()
    with pytest.raises(tpmscad.InvalidRequest, match=r"what is kept lies in loose pieces of 0\.001 mm3 at most"):
        tpmscad.infill_triangles(bd.Box(3, 2, 2), "P", **asked, keep=bd.Pos(5, 0, 0) * bd.Box(0.1, 0.1, 0.1))


def test_triangles_lie_on_the_surface(tmp_path: Path) -> None:
    """Corners lie on the offset surfaces, within the lattice's tolerance, and middles within the deviation of them."""
    wall, tol = 0.3, 2e-3
    body = bd.Box(6.2, 6.1, 6.3)
    part = tpmscad.infill_triangles(body, "P", cell=2, thickness=wall, tol=tol, deviation=DEVIATION)
    assert part.whole_cells > 0
    lattice = part.mesh.select(part.face == 0)
    field = tpmscad.fields.tpms("P", period=2)
    surface = tpmscad.lattice("P", cell=2, thickness=wall, tol=tol)
    centres = lattice.points[lattice.triangles].mean(axis=1)[::7]
    whole = np.round(centres / 2) * 2
    distance = surface.distance_to_reference(centres - whole + 0.0)
    assert np.nanmax(np.abs(field(lattice.points))) < 1.5
    assert np.nanmax(distance) <= DEVIATION + tol


def test_a_graded_wall_has_its_thickness_everywhere(tmp_path: Path) -> None:
    """Corners and middles of the triangles lie half the thickness from the mid surface, which is asked in the body only."""

    def thickness(points: Any) -> Any:
        return 0.2 + 0.06 * points[..., 2] + 0.04 * np.sin(points[..., 0])

    turn, middle = (0, 0, 30), np.array([0.2745, 1.0245])  # the middle of a column of cells
    for cell in (1.5, (1.5, 1.5, 1.9)):
        part = tpmscad.infill_triangles(
            bd.Pos(*middle) * bd.Cylinder(1.25, 4.2),
            "gyroid",
            cell=cell,
            thickness=thickness,
            rotation=turn,
            deviation=DEVIATION,
        )
        assert part.whole_cells > 1
        part.write(tmp_path / "part.stl")
        assert trimesh.load(tmp_path / "part.stl").is_watertight
        lattice = part.mesh.select(part.face == 0)
        c, s = np.cos(np.pi / 6), np.sin(np.pi / 6)
        turned = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        edges = np.ones(3) * cell
        mid = lattice_source("gyroid", "minimal").mid_surface(tuple(edges), (1, 1, 1), np.zeros(3), None)
        for points, allowed in ((lattice.points, 1e-6), (lattice.points[lattice.triangles].mean(axis=1), DEVIATION)):
            inside = (
                points[(np.hypot(*(points[:, :2] - middle).T) < 1.2) & (np.abs(points[:, 2]) < 2.05)][::29] @ turned
            )
            distance, foot = mid.distance_and_foot(inside - np.floor(inside / edges) * edges)
            foot = (foot + np.floor(inside / edges) * edges) @ turned.T
            assert np.abs(np.abs(distance) - 0.5 * thickness(foot)).max() < allowed
        assert part.deviation <= DEVIATION
    with pytest.raises(tpmscad.InvalidRequest, match="curvature"):
        tpmscad.infill_triangles(bd.Box(3, 3, 3), "gyroid", cell=1, thickness=lambda p: 0.6 + 0 * p[..., 0])


@pytest.mark.parametrize(
    ("field", "skin"),
    [
        (tpmscad.fields.strut_lattice("bcc", 1.7, 0.3, cells=2), 0.15),
        (tpmscad.fields.plate_lattice("bcc", cell=2.1, thickness=0.2), None),
    ],
)
def test_struts_and_plates_have_triangles_and_layers(field: Any, skin: float | None, tmp_path: Path) -> None:
    body = bd.Pos(1.7, 1.73, 1.7) * bd.Cylinder(1.1, 2.3)
    solid = tpmscad.infill(body, field, tol=0.01, skin=skin, loose="keep")
    part = tpmscad.infill_triangles(body, field, tol=0.01, skin=skin, deviation=0.01, loose="keep")
    part.write(tmp_path / "part.stl")
    assert trimesh.load(tmp_path / "part.stl").is_watertight
    assert abs(part.volume - solid.volume) < 0.01 * solid.area
    assert np.allclose(part.bounding_box, solid.bounding_box, atol=0.01)
    layers = tpmscad.infill_layers(body, field, tol=0.01, skin=skin, height=0.11, chord_error=0.02)
    assert abs(layers.volume - solid.volume) < 0.01 * solid.area
    for own, other in zip(layers, solid.slices(0.11, 0.02), strict=True):
        assert own.area == pytest.approx(other.area, abs=0.02 * other.perimeter)


def test_a_mesh_is_filled_as_it_is(tmp_path: Path) -> None:
    sphere = trimesh.creation.icosphere(2, 1.9)
    part = tpmscad.infill_triangles(sphere, "gyroid", cell=1.5, thickness=0.25, deviation=DEVIATION)
    outer = part.points[np.unique(part.triangles[part.face > 0])]
    planes = (
        sphere.face_normals @ outer[::5].T - np.einsum("fd,fd->f", sphere.face_normals, sphere.triangles[:, 0])[:, None]
    )
    assert np.abs(planes.max(axis=0)).max() < 1e-9  # the ball is convex
    part.render(tmp_path / "part.png", section="z", size=(200, 150))
    assert (tmp_path / "part.png").stat().st_size > 2000
    part.write(tmp_path / "part.3mf")
    assert trimesh.load(tmp_path / "part.3mf", force="mesh").volume == pytest.approx(part.volume, rel=1e-6)
    assert "1 piece" in repr(part)


def test_loose_pieces_are_left_out_and_told() -> None:
    large, small, void = (
        trimesh.creation.icosphere(2, radius).apply_translation((x, 0, 0))
        for radius, x in ((3.0, 0.0), (0.4, 5.0), (1.0, 0.0))
    )
    void.invert()
    parts = [SolidMesh(m.vertices, m.faces, np.zeros(len(m.faces), int)) for m in (large, small, void)]
    whole = join_meshes(parts)
    kept, notes = _drop_loose_pieces(whole, "drop", 1)
    assert kept.volume == pytest.approx(parts[0].volume + parts[2].volume)
    assert len(notes) == 1
    assert "1 loose piece" in notes[0]
    assert _drop_loose_pieces(whole, "keep", 1) == (whole, ())


def test_requests_that_cannot_be_met_are_told() -> None:
    field = tpmscad.fields.sphere((0, 0, 0), 1)
    with pytest.raises(tpmscad.InvalidRequest, match="needs tol="):
        tpmscad.infill_triangles(bd.Box(3, 3, 3), field)
    with pytest.raises(tpmscad.InvalidRequest, match="leave cell out"):
        tpmscad.infill_triangles(bd.Box(3, 3, 3), field, cell=1, tol=0.01)
    with pytest.raises(tpmscad.InvalidRequest, match="under a map"):
        tpmscad.infill_triangles(bd.Box(3, 3, 3), "gyroid", cell=1, thickness=0.1, map=lambda p: p)
    with pytest.raises(tpmscad.InvalidRequest, match="no cell is a copy"):
        tpmscad.infill_triangles(bd.Box(3, 3, 3), "P", cell=1, kind="skeletal", offset=lambda p: 0.01 * p[..., 0])
    with pytest.raises(OutOfMemory, match=r"cells around the body.*larger cells"):
        tpmscad.infill_triangles(bd.Box(900, 900, 900), "P", cell=1, thickness=0.1, deviation=0.005)

    for make in (tpmscad.infill, tpmscad.fluid_domains):
        with pytest.raises(OutOfMemory, match=r"27000000 cells.*infill_layers.*infill_triangles"):
            make(bd.Box(300, 300, 300), "P", cell=1, thickness=0.1)


def test_the_command_writes_triangles(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    body, out = tmp_path / "body.step", tmp_path / "part.stl"
    bd.export_step(bd.Box(3.3, 3.3, 3.3), str(body))
    bd.export_step(bd.Box(1, 1, 4), str(tmp_path / "boss.step"))
    line = f"infill {body} P --cell 1.5 --thickness 0.25 --triangles --deviation 0.03 -o {out}"
    assert run(f"{line} --keep {tmp_path / 'boss.step'}") == 0
    read = trimesh.load(out)
    assert read.is_watertight
    assert np.ptp(read.bounds[:, 2]) == pytest.approx(4)
    assert "triangles" in capsys.readouterr().out
    assert run(line.replace("part.stl", "part.step").replace(" --deviation 0.03", "")) == 2
    assert "triangles" in capsys.readouterr().err
