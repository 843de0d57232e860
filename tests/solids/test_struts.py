"""Strut lattices by the kernel: valid, exact, combined with other fields, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import tpmscad
from tpmscad import fields, maps
from tpmscad.errors import InvalidRequest
from tpmscad.fields import Field
from tpmscad.fields.kinds.strut_graphs import StrutsField
from tpmscad.results.model import Model

pytestmark = pytest.mark.kernel


def test_a_lattice_meets_its_certificate_and_survives_step(tmp_path: Path) -> None:
    model = tpmscad.struts("bcc", cell=10, cells=(2, 1, 1), diameter=1)
    certificate = model.certificate
    assert certificate.met, certificate.shortfalls
    assert certificate.betti == (1, 3, 0)  # four paths from one centre to the other: 16 struts, 14 nodes
    assert certificate.max_deviation == 0
    model.export_step(tmp_path / "struts.step")
    found = tpmscad.check_step(tmp_path / "struts.step")
    assert found.ok
    assert found.shape.faces == certificate.n_faces
    assert found.shape.volume == pytest.approx(certificate.volume, rel=1e-9)
    model.export_step(tmp_path / "copies.step", instanced=True)
    copies = tpmscad.check_step(tmp_path / "copies.step")
    assert copies.shape.solids == 2
    assert copies.shape.volume == pytest.approx(certificate.volume, rel=1e-9)
    gmsh = pytest.importorskip("gmsh")
    gmsh.initialize()
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.model.occ.importShapes(str(tmp_path / "struts.step"))
        gmsh.model.occ.synchronize()
        ((_, solid),) = gmsh.model.getEntities(3)
        assert gmsh.model.occ.getMass(3, solid) == pytest.approx(model.volume, rel=1e-6)
    finally:
        gmsh.finalize()


@pytest.mark.parametrize(("kind", "node_radius"), [("octahedron", 0.0), ("bcc", 1.1)])
def test_the_diameter_is_solved_for(kind: str, node_radius: float) -> None:
    model = tpmscad.struts(kind, cell=(8, 9, 10), porosity=0.9, node_radius=node_radius)
    assert model.certificate.met
    assert model.volume == pytest.approx(72, rel=1e-8)


def test_struts_are_cut_by_a_body() -> None:
    body = fields.sphere((5.0, 5.2, 4.9), 4.0)
    field = fields.strut_lattice("bcc", 10.0, 1.0)
    model = tpmscad.infill(body, field, tol=0.02)
    assert model.certificate.met, model.certificate.shortfalls
    points = 10 * np.random.default_rng(2).random((400_000, 3))
    share = ((field(points) < 0) & (body(points) < 0)).mean()
    assert abs(model.volume / 1000 - share) < 4 * np.sqrt(share / 400_000)


@pytest.mark.parametrize(
    "struts",
    [
        fields.strut_lattice("bcc", 5.0, 1.0),
        fields.rotate(fields.scale(fields.strut_lattice("bcc", 5.0, 1.0), 0.9), (1, 2, 3), 20),
    ],
    ids=["in the sides", "moved"],
)
def test_a_box_is_its_part_in_struts_and_its_part_beside_them(struts: Field) -> None:
    box, around = fields.box((0, 0, 0), (5, 5, 5)), ((-1, -1, -1), (6, 6, 6))
    parts = [tpmscad.solidify(each, around, tol=0.05) for each in (box & struts, fields.difference(box, struts))]
    assert all(part.certificate.met and part.certificate.max_deviation == 0 for part in parts)
    assert sum(part.volume for part in parts) == pytest.approx(125, rel=1e-9)


def test_the_smallest_wall_of_a_cell_is_the_diameter() -> None:
    wall = tpmscad.struts("bcc", cell=10, diameter=2).check_print().findings[0]
    assert wall.value == pytest.approx(2, rel=0.02)


CORNERS = [[x, y, z] for x in (0, 8) for y in (0, 8) for z in (0, 8)]
DIAGONALS = [[corner, 8] for corner in range(8)]


def test_struts_of_two_diameters_are_cut_by_each_other() -> None:
    diameters = [1.2] * 4 + [0.8] * 4
    field = fields.struts([*CORNERS, [4, 4, 4]], DIAGONALS, diameters)
    model = tpmscad.solidify(field, ((0, 0, 0), (8, 8, 8)), tol=0.01)
    assert model.certificate.met, model.certificate.shortfalls
    assert model.certificate.betti == (1, 0, 0)
    share = (field(8 * np.random.default_rng(4).random((400_000, 3))) < 0).mean()
    assert abs(model.volume / 512 - share) < 4 * np.sqrt(share / 400_000)


@pytest.mark.parametrize(
    ("diameters", "node_radius"),
    [
        ([[1.2, 1.1], [0.8, 1.1999], [0.9, 1.15], [0.9, 1.1], [0.6, 1.1], [1.2, 0.5]], 0.0),
        ([1.2] * 3 + [0.8] * 3, 0.9),
        ([1.2, 1.2 - 1e-5, 1.1, 1.2], 0.0),
    ],
    ids=["nearly equal", "with balls", "hardly different"],
)
def test_struts_of_any_diameters_are_cut_by_each_other_without_the_kernel(
    diameters: list[object], node_radius: float
) -> None:
    field = fields.struts([*CORNERS, [4, 4, 4.5]], DIAGONALS[: len(diameters)], diameters, node_radius)
    model = tpmscad.solidify(field, ((-2, -2, -2), (10, 10, 10)), tol=0.01)
    assert model.certificate.met, model.certificate.shortfalls
    assert model.certificate.betti == (1, 0, 0)
    assert any("on the parameters of their patches" in note for note in model.certificate.notes)
    share = (field(12 * np.random.default_rng(4).random((800_000, 3)) - 2) < 0).mean()
    assert abs(model.volume / 1728 - share) < 4 * np.sqrt(share / 800_000)


def check_solid(field: StrutsField, low: float, high: float, tol: float) -> Model:
    """The solid of struts in a cube, which has their volume and no ends of pieces."""
    model = tpmscad.solidify(field, ((low,) * 3, (high,) * 3), tol=tol)
    assert model.certificate.met, model.certificate.shortfalls
    share = (field((high - low) * np.random.default_rng(4).random((800_000, 3)) + low) < 0).mean()
    assert abs(model.volume / (high - low) ** 3 - share) < 4 * np.sqrt(share / 800_000)
    return model


def test_struts_that_are_linked_and_have_two_diameters_in_a_node_are_divided() -> None:
    """The last one bounds its first node with another, which bounds that in the middle: they are one network."""
    diameters = [[1.0, 1.0], [1.2, 1.0], *[[0.8, 0.8]] * 6, [1.0, 1.1]]
    field = fields.struts([*CORNERS, [4, 4, 4]], [*DIAGONALS, [0, 1]], diameters)
    model = check_solid(field, -2, 10, 0.01)
    assert model.certificate.betti == (1, 1, 0)
    assert model.certificate.max_deviation == 0
    # nine cylinders and cones in two faces each, and eight balls in two and in four parts
    assert model.certificate.n_faces < 40


def test_struts_that_touch_outside_their_nodes_are_cut_by_each_other() -> None:
    """Two struts of one diameter pass each other at less than that; both end in a frame."""
    nodes = [[0, 0, 0], [10, 0, 0.5], [5, -5, 0.9], [5, 5, 0.6], [0, 0, 5]]
    field = fields.struts(nodes, [[0, 1], [2, 3], [0, 4], [2, 4], [1, 4], [3, 4]], 1.0)
    model = check_solid(field, -6, 12, 0.01)
    assert model.certificate.betti == (1, 3, 0)
    assert model.certificate.max_deviation == 0


def test_a_strut_that_is_nowhere_clear_of_others_is_thinner_within_the_tolerance() -> None:
    """Two struts leave a node at 12 degrees, and one of them ends in a thicker strut before they part."""
    nodes = [[0, 0, 0], [8, 0, 0], [8, 1.7, 0], [8, 1.7, 6], [-6, 0, 1]]
    field = fields.struts(nodes, [[0, 1], [0, 2], [2, 3], [0, 4]], [1.6, 1.6, 2.4, 1.6])
    model = check_solid(field, -8, 11, 0.005)
    assert model.certificate.betti == (1, 0, 0)
    assert 0 < model.certificate.max_deviation <= 0.005
    assert any("thinner by up to" in note for note in model.certificate.notes)


def test_a_net_is_a_stent_under_a_map_and_needs_one() -> None:
    model = tpmscad.struts("rhombic-net", cell=3, cells=(6, 1, 1), diameter=0.4, map=maps.cylinder(9 / np.pi))
    assert model.certificate.met, model.certificate.shortfalls
    assert model.certificate.betti == (1, 7, 0)  # 24 struts, 18 nodes
    with pytest.raises(InvalidRequest, match="lie in the plane y = 0"):
        tpmscad.struts("rhombic-net", cell=3, diameter=0.4)


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({}, "exactly one of diameter, volume_fraction and porosity, not none"),
        ({"diameter": 1, "porosity": 0.9}, "not diameter and porosity"),
        ({"diameter": 11}, "a diameter of at most 9.99"),
        ({"volume_fraction": 0.99}, "give a smaller one|a diameter of at most"),
        ({"volume_fraction": 0.001, "node_radius": 2}, "the balls fill more"),
    ],
)
def test_what_struts_cannot_be_is_refused(keywords: dict[str, float], message: str) -> None:
    with pytest.raises(InvalidRequest, match=message):
        tpmscad.struts("cubic", cell=10, **keywords)
