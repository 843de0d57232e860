"""Lattices and struts under maps in bodies: volumes by points, ends in the faces of the body, rings that close, refusals."""

from __future__ import annotations

from typing import Any

import build123d as bd
import numpy as np
import pytest

import tpmscad
from tpmscad import fields, maps
from tpmscad.errors import InvalidRequest

pytestmark = [pytest.mark.kernel, pytest.mark.slow]

CELL = 5.0
RADIUS = 12 * CELL / (2 * np.pi)
WALL: dict[str, Any] = {"surface": "gyroid", "cell": CELL, "thickness": 0.6, "tol": 0.05, "progress": False}


def tube(low: float, high: float, height: float) -> Any:
    return bd.Cylinder(high, height) - bd.Cylinder(low, 2 * height)


def test_a_sector_of_a_jar_ends_in_the_faces_of_its_body_and_has_the_volume_of_the_bent_wall() -> None:
    body = tube(RADIUS - 1.3, RADIUS + 1.4, 6) & bd.Pos(9, 9, 0) * bd.Box(17, 17, 30)
    model = tpmscad.infill(body, **WALL, map=maps.cylinder(RADIUS))
    assert model.certificate.met
    assert model.trimmed_by == "patches"
    labels = {label for label in model.named_solids()[0].labels if label.startswith("body")}
    assert len(labels) == len(body.faces())
    rng = np.random.default_rng(3)
    angle, height = rng.uniform(0, np.pi / 2, 60_000), rng.uniform(-3, 3, 60_000)
    radius = np.sqrt(rng.uniform((RADIUS - 1.3) ** 2, (RADIUS + 1.4) ** 2, 60_000))
    points = np.column_stack([radius * np.sin(angle), radius * np.cos(angle), height])
    points = points[(points[:, :2] > 0.5).all(axis=1)]
    at = np.column_stack(
        [RADIUS * np.arctan2(points[:, 0], points[:, 1]), np.hypot(*points.T[:2]) - RADIUS, points[:, 2]]
    )
    distance = fields.normal_distance(fields.tpms("gyroid", CELL, reference="minimal"))
    share = float((np.abs(distance(at)) < 0.3).mean())
    assert model.volume / body.volume == pytest.approx(share, rel=0.03)  # a bent wall is measured along its own normal


def test_cells_that_lie_on_each_other_are_refused_with_the_radius_that_closes() -> None:
    with pytest.raises(InvalidRequest, match=r"lie on each other near .*radius = N \* cell / \(2 pi\)"):
        tpmscad.infill(tube(RADIUS - 1, RADIUS + 1, 4), **{**WALL, "cell": 5.3}, map=maps.cylinder(RADIUS))
    with pytest.raises(InvalidRequest, match="brings no cell within 20 cells of its origin near the body"):
        tpmscad.infill(bd.Pos(900, 0, 0) * bd.Box(9, 9, 9), **WALL, map=maps.cylinder(RADIUS))


def test_a_ring_of_struts_closes_and_a_tube_cuts_it() -> None:
    """Six cells: those at both ends share their nodes, so that the ring has one hole more than a row of six cells."""
    radius = 6 * 4 / (2 * np.pi)
    row, ring = (
        tpmscad.struts("cubic", cell=4, cells=(6, 1, 1), diameter=0.5, map=given, progress=False)
        for given in (maps.stretching((1, 1, 1)), maps.cylinder(radius))
    )
    assert row.certificate.betti == (1, 7 * 4 * 1 + 6 * 4 - 7 * 4 + 1, 0)
    assert ring.certificate.betti == (1, 6 * 4 + 6 * 4 - 6 * 4 + 1, 0)
    struts = fields.strut_lattice("cubic", 4, 0.5, cells=(6, 1, 1))
    body = bd.Pos(0, 0, 2) * tube(radius - 0.9, radius + 4.2, 4.1)
    cut = tpmscad.infill(body, struts, tol=0.02, map=maps.cylinder(radius), progress=False)
    assert cut.certificate.met
    assert cut.volume < ring.volume
    with pytest.raises(InvalidRequest, match=r"solidify\(field, map\)"):
        tpmscad.infill(body, fields.rod(fields.tpms("gyroid", 4), 0), tol=0.1, map=maps.cylinder(radius))


def test_whole_cells_between_two_faces_tell_how_far_they_leave_them() -> None:
    faces = bd.Box(10, 10, 5).faces().sort_by(bd.Axis.Z)
    between = maps.between(faces[0], faces[-1])
    assert "10 x 10 x 5 mm along its axes" in repr(between)
    assert "cells=(2, 2, 1)" in repr(between)
    whole = tpmscad.lattice(**WALL, cells=(2, 2, 1), boundary="natural", map=between)
    assert any("mm beyond the ends of the map" in note for note in whole.certificate.notes)
    panel = tpmscad.infill(bd.Box(10, 10, 5), **WALL, map=between)
    assert panel.certificate.met
    assert np.allclose(panel.bounding_box, [(-5, -5, -2.5), (5, 5, 2.5)], atol=1e-6)


def test_what_is_kept_of_an_exchanger_is_wall_and_what_is_cleared_no_part_of_it() -> None:
    boss, bolt = bd.Pos(1, 1, 0) * bd.Cylinder(2.5, 10), bd.Pos(1, 1, 0) * bd.Cylinder(1.2, 20)
    parts = tpmscad.fluid_domains(
        bd.Box(14, 12, 10), "gyroid", cell=8, thickness=1, tol=0.05, keep=boss, clear=bolt, progress=False
    )
    assert parts.certificate.met
    total = sum(part.volume for part in (parts.wall, parts.plus, parts.minus))
    assert total == pytest.approx(14 * 12 * 10 - np.pi * 1.2**2 * 10, rel=1e-9)
    assert (parts.wall.solid & boss).volume == pytest.approx(np.pi * (2.5**2 - 1.2**2) * 10, rel=1e-7)
    assert any(label.startswith("kept") for solid in parts.wall.named_solids() for label in solid.labels)
