"""Refusals of solids: lattices, maps, bodies, skins, files and pictures that cannot be made, with words of each message."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import build123d as bd
import numpy as np
import pytest

import tpmscad
from tests.meshing.test_volume_mesh import block
from tests.refusals.refused import Row, check_refusal
from tpmscad import fields, maps
from tpmscad.build123d import Tpms, TpmsInfill
from tpmscad.errors import InvalidRequest, MissingDomain
from tpmscad.kernel.build.primitive_solids import make_region_solid
from tpmscad.kernel.export.shape_file import write_solids
from tpmscad.kernel.render.viewpoints import section_planes, view_frame
from tpmscad.kernel.step.part21 import find_schema
from tpmscad.kernel.step.step_reader import read_step
from tpmscad.results.domain_results import FluidDomains
from tpmscad.simulation.permeability import permeability
from tpmscad.trimming.operands.polyhedra import box, polyhedron

pytestmark = pytest.mark.kernel

NAN, INF = float("nan"), float("inf")
P: dict[str, Any] = {"surface": "P", "cell": 10, "thickness": 1, "tol": 0.1}
GYROID = fields.tpms("gyroid", 10.0)
BOX = bd.Box(14, 13, 12)
BAR = bd.Box(10.2, 0.6, 0.5)
DISC = bd.Cylinder(5, 3).faces().sort_by(bd.Axis.Z)[0]
HOLED = (bd.Box(10, 9, 2) - bd.Cylinder(2, 2)).faces().sort_by(bd.Axis.Z)[0]
with bd.SkipClean():
    SPLIT_BOX = bd.Box(10, 10, 8) + bd.Pos(7.5, 0, 0) * bd.Box(5, 10, 8)
CRUMPLED = bd.Face.extrude(bd.Edge.make_spline([(i / 6, 0.3 * (-1) ** i, 0) for i in range(60)]), (0, 0, 5))
EXECUTOR = ThreadPoolExecutor(1)  # starts no thread before it is given work


def lattice(**changes: Any) -> Any:
    return tpmscad.lattice(**(P | changes))


def torus(x: float) -> fields.Field:
    return fields.expression(f"sqrt((sqrt((X - {x})^2 + Y^2) - 2)^2 + Z^2) - 1")


def infill(body: Any = BOX, **changes: Any) -> Any:
    return tpmscad.infill(body, **(P | changes))


@cache
def model() -> Any:
    return lattice(boundary="natural")


def homogenize(**changes: Any) -> Any:
    return tpmscad.homogenize("gyroid", volume_fraction=0.2, **changes)


class Workplane:
    """What is asked of a CadQuery workplane that holds no solid."""

    def findSolid(self) -> Any:
        raise ValueError("nothing in the chain")


def _open_solid() -> bd.Solid:
    return bd.Solid(bd.Shell(bd.Box(1, 1, 1).faces()[:5]))


def section(text: Any) -> Any:
    return section_planes(text, np.ones(3), np.zeros(3), np.ones(3))


LATTICES: dict[str, Row] = {
    "loose": (lambda: lattice(loose="perhaps"), "loose 'perhaps' is unknown"),
    "two offsets of one surface": (lambda: lattice(thickness=None, kind="skeletal", offset=(0, 1)), "one offset, not 2"),
    "infinite offset": (lambda: lattice(thickness=None, offset=(0, INF)), "must be finite"),
    "pore under a map": (lambda: lattice(cell=None, pore_size=1.0, map=lambda p: p), "without a map"),
    "wall too thick for any cell": (lambda: lattice(cell=None, thickness=40.0, pore_size=0.1), "passes its curvature"),
    "pore beside a shifted wall": (
        lambda: lattice(cell=None, thickness=None, offset=(-3.0, -2.0), pore_size=0.1),
        "no cell of the schwarz_p leaves a pore of 0.1 beside this wall: make the wall thinner",
    ),
    "bent level set": (
        lambda: lattice(surface="octo", cell=(10, 10, 12), thickness=6.0),
        "offset -3 .* passes the curvature radius of the stretched octo: offsets stay between",
    ),
    "instances of a box": (lambda: _instanced(), "instanced"),
    "properties without a fraction": (lambda: tpmscad.homogenize("gyroid"), "`volume_fraction`, `porosity`; here: none"),
    "properties with both fractions": (lambda: homogenize(porosity=0.8), "`volume_fraction`, `porosity`; here: both"),
    "porosity in percent": (lambda: tpmscad.homogenize("gyroid", porosity=70), "porosity 70 must lie below 1"),
    "porosity of a model": (lambda: tpmscad.homogenize(model(), porosity=0.8), "a model has its own porosity, kind"),
    "incompressible material": (lambda: homogenize(poisson_ratio=0.5), "poisson_ratio = 0.5: it must lie from 0 to 0.49"),
    "size of hexahedra": (lambda: homogenize(size=0.1, elements="hexahedra"), "size is that of tetrahedra: leave it out"),
    "fraction of a model": (lambda: tpmscad.homogenize(model(), volume_fraction=0.2), "a model has its own volume_fraction"),
    "permeability of a name": (lambda: tpmscad.permeability("gyroid"), "channel: a str is no model; make one by"),
    "one file for three domains": (
        lambda: FluidDomains.export(None, "a.stl"),  # type: ignore[arg-type]
        "an STL file holds one body: write the domains one by one, or as .3mf",
    ),
    "instances under a map": (
        lambda: lattice(boundary="natural", map=maps.stretching((1, 1, 1.1))).export_step("a.step", instanced=True),
        "the schwarz_p sheet has no cell that repeats: leave `instanced` out",
    ),
}  # fmt: skip


def _instanced() -> None:
    kernel_model = infill(bd.Box(11, 11, 11))
    kernel_model.export_step("never.step", instanced=True)


MAPS: dict[str, Row] = {
    "no map": (lambda: lattice(map=3.0), "map 3.0 can't be called"),
    "flat map": (lambda: lattice(map=lambda p: p[..., :2]), "as many"),
    "map that is not finite": (lambda: lattice(map=lambda p: p + NAN), "is not finite at"),
    "map that folds": (
        lambda: lattice(map=lambda p: p * (p[..., :1] - 5.1), boundary="natural"),
        "folds|flat",
    ),
    "map that squeezes": (lambda: lattice(map=lambda p: p * np.array([1, 1, 1e-9])), "flat"),
    "map that bends the box": (
        lambda: lattice(map=lambda p: p + 0.1 * np.sin(p[..., ::-1]), boundary="box"),
        "side flat and square",
    ),
    "two turns": (lambda: lattice(cells=(4, 1, 1), map=maps.cylinder(10 / np.pi)), "overlaps itself|winds"),
    "wall thicker than the bend": (
        lambda: lattice(thickness=2.4, map=maps.stretching((1, 1, 0.4))),
        "curvature radius",
    ),
    "graded wall without exact patches": (
        lambda: lattice(surface="iwp", thickness="1 + 0*x"),
        "gyroid, diamond and P only",
    ),
    "graded wall that pores are solved for": (
        lambda: lattice(cell=None, pore_size=2.0, thickness="1 + 0*x"),
        "pore_size is solved for an even wall",
    ),
    "graded wall beyond the bend": (
        lambda: lattice(thickness="1 + 0.6*x"),
        "curvature radius.*so far the wall reaches at",
    ),
    "graded fraction out of reach": (lambda: lattice(thickness=None, volume_fraction="0.3 + 0.06*x"), "out of reach"),
    "graded wall of no thickness": (lambda: lattice(thickness=lambda p: p[..., 0] - 5), "must be positive"),
    "graded wall that ends": (
        lambda: lattice(thickness=lambda p: np.where(p[..., 0] > 5, np.inf, 1.0)),
        "is not finite",
    ),
    "graded wall of vectors": (
        lambda: lattice(thickness=lambda p: p, map=maps.stretching((1, 1, 1)), boundary="natural"),
        "returns a number for each",
    ),
    "graded wall thicker than the bend": (
        lambda: lattice(
            thickness=lambda p: 1 + 0.3 * p[..., 0] ** 2, map=maps.stretching((1, 1, 1)), boundary="natural"
        ),
        "graded wall reaches beyond the curvature radius",
    ),
    "scale": (lambda: maps.grading(0, (1, -2), 10.0), "scale .* must be positive"),
    "centre": (lambda: maps.sphere(10.0, centre=(0.0, NAN)), "centre .* must be finite"),
}

BODIES: dict[str, Row] = {
    "nothing": (lambda: infill(None), "is no body"),
    "no file": (lambda: infill("no.step"), "no file"),
    "inside out": (lambda: infill(bd.Solid(BOX.solid().wrapped.Reversed())), "inside out"),
    "beyond all limits": (lambda: infill(bd.Pos(1e9, 0, 0) * BOX), "must be finite"),
    "less than a cell": (lambda: infill(bd.Box(4, 4, 4)), "less than a cell"),
    "a wall of nothing": (lambda: infill(thickness=1e-9), "thinner than"),
    "two angles": (lambda: infill(rotation=(1, 2)), "three angles in degrees"),
    "skin of text": (lambda: infill(skin="thin"), "skin 'thin'"),
    "skin around what is solid": (
        lambda: infill(BAR, thickness=None, offset=0.0, kind="skeletal", side="+", skin=0.1),
        "the lattice leaves no void within a skin of 0.1: the body would stay as it is",
    ),
    "bar in one channel": (
        lambda: tpmscad.fluid_domains(BAR, "P", cell=10, thickness=0.5, tol=0.1),
        "the body holds no .*: shift the lattice by `phase`, or use a smaller `cell`",
    ),
    "workplane without a solid": (lambda: infill(Workplane()), "the workplane holds no solid: nothing in the chain"),
    "no faces": (lambda: infill(skin=1.0, open_faces=True), "open_faces True names no faces; it takes faces"),
    "two angles and nan": (lambda: infill(rotation=(1, 2, NAN)), "rotation .* must be finite"),
    "processes for a body": (
        lambda: tpmscad.solidify(GYROID, BOX, tol=0.1, executor=EXECUTOR),
        "an executor is for boxes; a body is filled by one process: leave executor out",
    ),
    "domain of three numbers": (
        lambda: tpmscad.solidify(GYROID, range(3), tol=0.1),
        r"range\(0, 3\) must be two points",
    ),
    "print of a face": (
        lambda: tpmscad.check_print(bd.Face.make_rect(1, 1)),
        "before printing, this is a shape that holds no",
    ),
    "print of an open body": (lambda: tpmscad.check_print(_open_solid()), "this is NOT ok: .*: repair it where"),
    "empty part to fill": (lambda: infill(bd.Part()), "Part is no body: give"),
    "body for a face": (lambda: maps.between(BOX, DISC), "face_a holds 6 faces: give one face of the part"),
    "disc": (lambda: maps.between(DISC, DISC), "face_a has 1 edges: a map needs a face of 4 sides; split"),
    "face with a hole": (lambda: maps.between(HOLED, HOLED), "face_a has 1 holes: a map needs a face of four sides"),
    "crumpled face": (
        lambda: lattice(
            map=maps.between(CRUMPLED, CRUMPLED.moved(bd.Location((0, 5, 0)))), cells=(2, 2, 1), boundary="natural"
        ),
        "too rough for cells of this size: at its knot . = .* it is C2 only.* near .* in the model.* more cells along .,",
    ),
    "text for a face": (lambda: maps.between("top", HOLED), "'top' is no shape: give a model"),
    "no plane face there": (lambda: infill(bd.Sphere(8), skin=1.0, open_faces=[">Z"]), "no plane face"),
    "face of another body": (lambda: infill(skin=1.0, open_faces=[99]), "is no face of"),
    "faces in one plane": (
        lambda: infill(SPLIT_BOX, skin=1.0, open_faces=">Z"),
        "meet in one plane near .*: unite them",
    ),
    "domain of one corner": (lambda: tpmscad.solidify(GYROID, 3, tol=0.1), "domain 3 is no body; it takes two corners"),
    "domain inside out": (
        lambda: tpmscad.solidify(GYROID, ((1, 1, 1), (0, 0, 0)), tol=0.1),
        "each coordinate of the first corner must be below",
    ),
    "box beyond the data": (
        lambda: tpmscad.solidify(fields.sampled(-np.ones((5, 5, 5))), ((9,) * 3, (12,) * 3), tol=0.1),
        "no data in the box",
    ),
    "tol beyond the box": (lambda: tpmscad.solidify(GYROID, ((0,) * 3, (1,) * 3), tol=2), "below the box's shortest"),
    "no surface": (
        lambda: tpmscad.solidify(fields.sphere((9, 9, 9), 1.0), ((0,) * 3, (1,) * 3), tol=0.1),
        "no surface",
    ),
    "walls that touch": (
        lambda: tpmscad.solidify(fields.union(torus(0), torus(6)), ((-3.5, -3.5, -1.5), (9.5, 3.5, 1.5)), tol=0.05),
        r"two surfaces touch near \(3, 0, 0\): .* make them overlap",
    ),
    "table too fine": (lambda: tpmscad.body_field(BOX, spacing=1e-4), "needs .* samples, more than"),
    "infinite region": (lambda: make_region_solid(fields.box((0, 0, 0), (1, 1, INF))), "is infinite"),
    "cylinder without ends": (lambda: make_region_solid(fields.cylinder((0, 0, 0), 1.0)), "no ends"),
    "corners out of plane": (
        lambda: polyhedron([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 1)], [(0, 1, 2, 3)]),
        "do not lie in one plane",
    ),
    "open polyhedron": (lambda: polyhedron([(0, 0, 0), (1, 0, 0), (1, 1, 0)], [(0, 1, 2)]), "join two faces"),
    "infinite box": (lambda: box(np.zeros(3), np.array([1, 1, INF])), "finite corners"),
    "the body after the surface": (lambda: TpmsInfill("gyroid", BOX, cell=8), "the body comes before the surface"),
    "no surface for a part": (lambda: TpmsInfill(BOX), "no surface to fill with"),
    "no part": (lambda: TpmsInfill(surface="P", cell=10, thickness=1), "no part to fill"),
    "aligning a free lattice": (
        lambda: Tpms(**P, boundary="natural", map=maps.stretching((1, 1, 1.1)), align=bd.Align.CENTER),
        "align=None",
    ),
}

FILES: dict[str, Row] = {
    "suffix": (lambda: model().export("a.obj"), "ends in '.obj'"),
    "deviation of an exact file": (lambda: model().export("a.step", deviation=0.1), "is exact"),
    "schema of a mesh": (lambda: model().export("a.stl", schema="ap214"), "for STEP files"),
    "negative deviation": (lambda: model().export("a.stl", deviation=-1.0), "greater than 0"),
    "deviation of atoms": (lambda: model().export("a.stl", deviation=1e-16), "chords of edges; raise the deviation"),
    "schema": (lambda: model().export_step("a.step", schema="ap203"), "schema 'ap203'"),
    "no folder": (lambda: model().export_step("no/such/folder/a.step"), "does not exist"),
    "STEP suffix": (lambda: tpmscad.export_step(model(), "a.stl"), "ends in '.stl'"),
    "an edge": (
        lambda: tpmscad.export_step(bd.Edge.make_line((0, 0, 0), (1, 0, 0)), "a.step"),
        "holds no solid: make a solid",
    ),
    "no solids": (
        lambda: write_solids([], "a.step", accuracy=1.0),
        "no solid: STEP files are written of solids",
    ),
    "an empty part": (lambda: tpmscad.export_step(bd.Part(), "a.step"), "is no shape: give .* that is not empty"),
    "a picture of an empty part": (lambda: tpmscad.render(bd.Part(), "a.png"), "no face|no shape"),
    "size of metres": (lambda: model().mesh(1e-3), r"size = 0.001 makes about .* elements .*; 5e\+07 is the limit"),
    "order of elements": (lambda: model().mesh(1.0, order=3), "order = 3 is neither 1 nor 2"),
    "a missing file": (lambda: tpmscad.check_step("no.step"), "there is no file"),
    "schema by name": (lambda: find_schema("x"), "is not known"),
    "size of text": (lambda: model().render("a.png", size="big"), "two whole numbers"),
    "size of a pixel": (lambda: model().render("a.png", size=(1, 1)), "pixels for each"),
    "view": (lambda: view_frame("behind"), "view 'behind'"),
    "section": (lambda: section(3.0), "section 3.0"),
    "section across no axis": (lambda: section("w=1"), "an axis and a position"),
    "section without normal": (lambda: section(((0, 0, 0), (0, 0, 0))), "must not be zero"),
    "colouring": (lambda: model().render("a.png", color_by="mood"), "color_by 'mood'"),
    "deviation of a plain shape": (lambda: tpmscad.render(BOX, "a.png", color_by="deviation"), "only the result of"),
    "tags of a plain shape": (lambda: tpmscad.render(BOX, "a.png", color_by="tag"), "groups of faces"),
    "hidden piece": (lambda: tpmscad.render(model(), "a.png", hide="lid"), "the pieces are"),
    "envelope": (lambda: tpmscad.measure(BOX, within=((1, 1, 1), (0, 0, 0))), "two opposite corners"),
    "envelope too small": (lambda: tpmscad.measure(BOX, within=((0, 0, 0), (1, 1, 1))), "contains the solid"),
    "metrics of a face": (lambda: tpmscad.measure(bd.Face.make_rect(1, 1)), "only valid closed solids"),
}

SLOW = {"instances of a box", "wall too thick for any cell"}
TABLES = {"lattices": LATTICES, "maps": MAPS, "bodies": BODIES, "files": FILES}


@pytest.fixture(autouse=True)
def _folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


ROWS = [
    pytest.param(table, name, id=f"{table}: {name}", marks=[pytest.mark.slow] * (name in SLOW))
    for table, rows in TABLES.items()
    for name in rows
]


@pytest.mark.parametrize(("table", "name"), ROWS)
def test_what_cannot_be_a_solid_is_refused_and_leaves_no_file(table: str, name: str, tmp_path: Path) -> None:
    check_refusal(
        TABLES[table][name], tpmscad.LevelSetError if name in ("no surface", "walls that touch") else InvalidRequest
    )
    assert list(tmp_path.iterdir()) == []


def test_a_domain_that_the_kernel_does_not_find_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def reject(*operands: Any) -> Any:
        raise tpmscad.TrimmingError("the patches cannot be trimmed")

    monkeypatch.setattr("tpmscad.solids._fluid_domains._trim_domains", reject)
    with pytest.raises(MissingDomain, match=r"the body holds no .*: shift the lattice by `phase`"):
        tpmscad.fluid_domains(bd.Box(10.2, 3.6, 3.5), "P", cell=10, thickness=0.5, tol=0.1)


def test_a_mesh_that_does_not_repeat_has_no_properties(monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = replace(block("tetra10"), periodic={"y": np.zeros((0, 2), np.int64)})
    monkeypatch.setattr(tpmscad.Model, "mesh", lambda *_, **__: mesh)
    for request in (
        lambda: tpmscad.permeability(model(), size=1.0),
        lambda: tpmscad.homogenize(model(), size=1.0),
    ):
        with pytest.raises(InvalidRequest, match=r"the .* does not repeat along x, z: make a box of whole cells"):
            request()
    with pytest.raises(InvalidRequest, match=r"tetrahedra of second order, periodic: mesh\(size, 2, True\)"):
        permeability(block("tetra"))


def test_a_shape_without_a_face_cannot_be_drawn(tmp_path: Path) -> None:
    edge = bd.Edge.make_line((0, 0, 0), (1, 0, 0))
    check_refusal((lambda: tpmscad.render(edge, tmp_path / "a.png"), "no face"), InvalidRequest)
    check_refusal((lambda: read_step(_text(tmp_path)), "is not a STEP file"), InvalidRequest)


def _text(folder: Path) -> Path:
    (folder / "a.step").write_text("no")
    return folder / "a.step"
