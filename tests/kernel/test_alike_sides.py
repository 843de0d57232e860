"""Edges in opposite sides of a box are divided at the images of each other's vertices; the solid stays what it is."""

from __future__ import annotations

import build123d as bd
import numpy as np
import pytest

from tests.kernel.test_short_edges import count_shared, glue
from tpmscad.kernel.export.alike_sides import make_sides_alike
from tpmscad.kernel.measure.shape_report import check_shape
from tpmscad.kernel.occt.exploration import faces_of, vertices_of

pytestmark = pytest.mark.kernel

LOW, HIGH = np.zeros(3), np.array([4.0, 3.0, 3.0])


def make_tube(turn: float) -> bd.Solid:
    """A box with a round hole along x, whose two halves have their seams at different angles."""
    halves = [
        bd.Pos(x, 1.5, 1.5)
        * bd.Rot(X=angle)
        * bd.Rot(Y=90)
        * bd.Cylinder(0.8, 2, align=(bd.Align.CENTER,) * 2 + (bd.Align.MIN,))
        for x, angle in ((0.0, turn), (2.0, 0.0))
    ]
    box = bd.Box(*HIGH, align=bd.Align.MIN)
    return (box - halves[0] - halves[1]).solid().wrapped


def on_side(shape: object, x: float) -> np.ndarray:
    points = vertices_of(shape)
    return np.array(sorted(points[np.abs(points[:, 0] - x) < 1e-9][:, 1:].round(7).tolist()))


def test_a_vertex_without_image_divides_the_edge_of_the_other_side() -> None:
    tube = make_tube(50.0)
    near, far = on_side(tube, 0.0), on_side(tube, 4.0)
    assert np.abs(near - far).max() > 0.1
    (found,), moved = make_sides_alike([tube], LOW, HIGH, 0.01, 0.05)
    assert moved < 1e-6
    np.testing.assert_allclose(on_side(found, 0.0), on_side(found, 4.0), atol=1e-6)
    assert len(on_side(found, 0.0)) == len(near) + 2, "and once more, as both arcs would have the same vertices"
    report = check_shape(found)
    assert report.ok, str(report)
    assert report.volume == pytest.approx(check_shape(tube).volume, rel=1e-12)
    for before, after in zip(faces_of(tube), faces_of(found), strict=True):
        assert tuple(bd.Face(after).center()) == pytest.approx(tuple(bd.Face(before).center()), abs=1e-9)


def test_vertices_that_nearly_are_images_are_moved_to_them() -> None:
    tube = make_tube(0.5)
    (found,), moved = make_sides_alike([tube], LOW, HIGH, 0.1, 0.1)
    assert moved == pytest.approx(2 * 0.8 * np.sin(np.radians(0.25)), rel=1e-6)
    assert len(on_side(found, 0.0)) == len(on_side(tube, 0.0))
    np.testing.assert_allclose(on_side(found, 0.0), on_side(found, 4.0), atol=1e-12)
    assert np.abs(on_side(tube, 0.0) - on_side(tube, 4.0)).max() > 5e-3, "the solid itself is left alone"
    assert check_shape(found).ok


def test_solids_that_share_a_face_share_it_afterwards() -> None:
    tube = make_tube(50.0)
    plug = bd.Pos(0, 1.5, 1.5) * bd.Rot(Y=90) * bd.Cylinder(0.8, 4, align=(bd.Align.CENTER,) * 2 + (bd.Align.MIN,))
    solids = glue(tube, plug.solid().wrapped)
    found, _ = make_sides_alike(solids, LOW, HIGH, 0.01, 0.05)
    assert count_shared(solids) == count_shared(found) > 0
    assert all(check_shape(each).ok for each in found)
