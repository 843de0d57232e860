"""Fields whose level sets cross, as solids with exact edges: in boxes, in bodies, from recipes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import build123d as bd
import numpy as np
import pytest

import tpmscad
from tpmscad import fields
from tpmscad.brep.deviation import Deviation
from tpmscad.brep.edge_continuity import EdgeContinuity
from tpmscad.errors import LevelSetError
from tpmscad.fields.analysis.crease_network import trace_creases
from tpmscad.kernel.measure.creases import SolidCreases
from tpmscad.results.certificate import PatchMeasures
from tpmscad.solids.matter.crossing_measures import compare_creases

pytestmark = [pytest.mark.kernel, pytest.mark.slow]

BOX = ((0, 0, 0), (10, 10, 10))
DIAGONALS = ((1, 1, 1), (1, -1, 1), (-1, 1, 1), (1, 1, -1))


def sample_volume(field: fields.Field, n: int = 120) -> float:
    """Volume in BOX by one random point in each of n^3 cells."""
    grid = np.stack(np.meshgrid(*(np.arange(n),) * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    points = (grid + np.random.default_rng(0).random(grid.shape)) * (10 / n)
    return float((field(points) < 0).mean() * 1000)


def test_four_struts_meet_in_a_node_of_exact_cylinders(tmp_path: Path) -> None:
    struts = fields.union(*(fields.cylinder((5, 5, 5), 1.0, axis) for axis in DIAGONALS))
    model = tpmscad.solidify(struts, BOX, tol=0.02)
    certificate = model.certificate
    assert certificate.met
    assert certificate.max_deviation == 0
    assert certificate.betti == (1, 0, 0)
    assert certificate.n_faces == 32
    assert certificate.figures["least wedge in degrees"] > 0
    assert model.volume == pytest.approx(sample_volume(struts), rel=2e-3)
    model.export_step(tmp_path / "node.step")
    assert tpmscad.check_step(tmp_path / "node.step").ok
    assert bd.import_step(tmp_path / "node.step").volume == pytest.approx(model.volume, rel=1e-3)


def test_a_sheet_within_a_ball_keeps_its_deviation_and_ends_in_edges() -> None:
    sheet = fields.sheet(fields.tpms("schwarz_p", 10.0), -0.3, 0.3)
    field = sheet & fields.sphere((5.1, 5.2, 4.9), 4.0)
    model = tpmscad.solidify(field, BOX, tol=0.05)
    assert model.certificate.met
    assert 0 < model.certificate.max_deviation <= 0.05
    assert model.volume == pytest.approx(sample_volume(field), rel=5e-3)
    assert set(model.named_solids()[0].labels) == {"surface"}
    assert any("on the parameters of their patches" in note for note in model.certificate.notes)
    figures = model.certificate.figures
    # the ball is exact: the deviation is that of the sheet alone
    assert figures["deviation of operand 1"] == model.certificate.max_deviation
    assert "deviation of operand 2" not in figures
    assert figures["creases within the box"] == figures["creases of the field"] > 0
    assert figures["length of the creases within the box"] == pytest.approx(
        figures["length of the field's creases"], rel=1e-3
    )
    assert not any("creases" in note for note in model.certificate.notes)
    low, high = np.array(model.bounding_box)
    assert (low > 0.899).all()
    assert (high < 9.201).all()
    tall = tpmscad.infill(bd.Pos(5.1, 5.2, 4.9) * bd.Sphere(4), sheet, tol=0.05)
    assert model.volume == pytest.approx(tall.volume, rel=1e-3)


def test_creases_that_differ_from_those_of_the_field_are_noted() -> None:
    pair = fields.cylinder((0, 0, 0), 0.5, "x") | fields.cylinder((0, 0, 0), 0.5, "y")
    expected = trace_creases(pair, np.full(3, -1.0), np.full(3, 1.0))
    own = SolidCreases(4, 8.0, 1.0, 200.0, expected.n_curves, expected.length)
    measures = PatchMeasures(0.02, Deviation(0, 0, 0, 0), "field", EdgeContinuity(0, 0, 0, 0))
    assert len(compare_creases(measures, own, expected).notes) == 1  # of the two places where they touch
    lost = replace(own, inner_curves=3, inner_length=0.75 * expected.length)
    notes = compare_creases(measures, lost, expected).notes
    assert notes[0].startswith("the solid has 3 creases")
    assert "not proved to be all" in notes[0]
    assert "touch or coincide near" in notes[1]


def test_the_complement_of_a_union_has_a_cavity_with_an_edge() -> None:
    pair = fields.sphere((4, 5, 5), 2.0) | fields.sphere((6, 5, 5), 2.2)
    model = tpmscad.solidify(~pair, BOX, tol=0.02)
    assert model.certificate.met
    assert model.certificate.betti == (1, 0, 1)
    outside = tpmscad.solidify(pair, BOX, tol=0.02)
    assert model.volume + outside.volume == pytest.approx(1000, rel=1e-9)
    labels = model.named_solids()[0].labels
    assert sorted(set(labels)) == ["cap X+", "cap X-", "cap Y+", "cap Y-", "cap Z+", "cap Z-", "surface"]


def test_a_box_and_a_finite_cylinder_are_trees_of_their_sides() -> None:
    model = tpmscad.solidify(fields.cylinder((5, 5, 5), 2.0, "z", 6.0), BOX, tol=0.02)
    assert model.volume == pytest.approx(24 * np.pi, rel=1e-9)
    block = tpmscad.solidify(fields.box((1, 2, 3), (8, 7, 9)), BOX, tol=0.02)
    assert block.volume == pytest.approx(7 * 5 * 6, rel=1e-9)
    assert block.certificate.n_faces == 6


def test_crossing_fields_fill_a_body() -> None:
    struts = fields.union(*(fields.cylinder((5, 5, 5), 1.0, axis) for axis in DIAGONALS[:2]))
    body = bd.Pos(5, 5, 5) * bd.Cylinder(4, 6)
    model = tpmscad.infill(body, struts, tol=0.02)
    assert model.certificate.met
    rng = np.random.default_rng(1)
    points = rng.uniform(0, 10, (400_000, 3))
    inside = (np.hypot(points[:, 0] - 5, points[:, 1] - 5) < 4) & (np.abs(points[:, 2] - 5) < 3) & (struts(points) < 0)
    assert model.volume == pytest.approx(1000 * inside.mean(), rel=0.02)
    labels = set(model.named_solids()[0].labels)
    assert "surface" in labels
    assert any(label.startswith("body") for label in labels)
    within = tpmscad.infill(body, struts, tol=0.02, skin=0.5)
    assert within.certificate.met
    deep = (np.hypot(points[:, 0] - 5, points[:, 1] - 5) < 3.5) & (np.abs(points[:, 2] - 5) < 2.5)
    void = 1000 * (deep & (struts(points) > 0)).mean()
    assert within.volume == pytest.approx(np.pi * 16 * 6 - void, rel=0.01)


def test_patches_quadrics_and_a_body_are_cut_by_each_other() -> None:
    """A rod of a field, and all but a strut, in a half ball: the kernel combines only what is exact."""
    field = fields.rod(fields.tpms("schwarz_p", 10.0), -0.6) | ~fields.cylinder((5, 5, 5), 1.2, (1, 2, 3))
    body = bd.Pos(5, 5, 5) * bd.Rot(11, 23, 37) * (bd.Sphere(4) & bd.Pos(0, 0, 4.5) * bd.Box(9, 9, 9))
    model = tpmscad.infill(body, field, tol=0.05)
    assert model.certificate.met
    assert model.trimmed_by == "patches"
    labels = set(model.named_solids()[0].labels)
    assert "surface" in labels
    assert any(label.startswith("body") for label in labels)
    rest = tpmscad.infill(body, ~field, tol=0.05)
    assert model.volume + rest.volume == pytest.approx(body.volume, rel=1e-6)


def test_leaves_that_do_not_reach_the_box_are_left_out() -> None:
    ball, far = fields.sphere((5, 5, 5), 2.0), fields.tpms("gyroid", 10.0) + 5.0
    crossing = ball & fields.halfspace((5, 5, 5), "z")
    assert tpmscad.solidify(crossing | far, BOX, tol=0.02).volume == pytest.approx(16 / 3 * np.pi, rel=1e-9)
    assert tpmscad.solidify(crossing & ~far, BOX, tol=0.02).volume == pytest.approx(16 / 3 * np.pi, rel=1e-9)
    with pytest.raises(LevelSetError, match="no surface inside the box"):
        tpmscad.solidify((crossing & far) | far, BOX, tol=0.02)


def test_a_wall_thinner_than_the_tolerance_is_still_refused() -> None:
    thin = fields.sheet(fields.tpms("gyroid", 10.0), -0.002, 0.002) & fields.sphere((5, 5, 5), 4.0)
    with pytest.raises(LevelSetError, match="too thin"):
        tpmscad.solidify(thin, BOX, tol=0.05)


def test_a_lattice_of_struts_is_counted_and_measured_cell_by_cell() -> None:
    """Body-centred cells, two along each axis: 28 lines through 35 nodes, with 64 struts between them."""
    middles = np.stack(np.meshgrid(*(np.array([2.5, 7.5]),) * 3), axis=-1).reshape(-1, 3)
    lines = {}
    for middle in middles:
        for axis in np.array(DIAGONALS, float):
            foot = middle - axis * (middle @ axis) / 3
            lines[(*axis, *np.round(foot, 6))] = foot, axis
    struts = fields.union(*(fields.cylinder(foot, 0.5, axis) for foot, axis in lines.values()))
    assert len(lines) == 28
    model = tpmscad.solidify(struts, BOX, tol=0.02)
    certificate = model.certificate
    assert certificate.met
    assert certificate.n_faces == 118
    assert certificate.betti == (1, 64 - 35 + 1, 0)
    assert not any("Betti" in note for note in certificate.notes)
    assert any("stratified sample" in note for note in certificate.notes)
    figures = certificate.figures
    assert (
        abs(figures["volume of the field"] - model.volume)
        <= figures["uncertainty of that volume"]
        < 1e-3 * model.volume
    )
    assert figures["least wedge in degrees"] == pytest.approx(90)
