"""Faces are split at the creases of their surfaces: every part is smooth, and the parts bound what the faces bounded."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("OCP")

import build123d as bd
from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeEdge, BRepBuilderAPI_MakeFace
from OCP.Geom import Geom_BSplineCurve
from scipy.integrate import quad
from scipy.interpolate import BSpline

from tests.shapes.misfits import volume
from tests.trimming.conftest import Cover, cover
from tpmscad.brep import connectivity
from tpmscad.kernel.body_import.body_brep import read_free_form_body
from tpmscad.kernel.measure.validity import is_brep_valid
from tpmscad.kernel.occt import convert
from tpmscad.kernel.occt.exploration import faces_of
from tpmscad.splines.bspline import BSplineCurve, BSplineSurface
from tpmscad.trimming.network_boolean import combine_networks

pytestmark = pytest.mark.kernel

__all__ = ["cover"]

TWO_ARCS = np.repeat([0.0, 1.0, 2.0], (4, 3, 4))
ROOF = 0.25 * np.array([(0, 0), (5, 9), (14, 12), (20, 8), (26, 16), (33, 8), (40, 0.0)])
DROP = 0.25 * np.array([(0, 0), (10, 14), (25, 12), (30, 0), (25, -12), (10, -14), (0, 0.0)])
VASE = 0.25 * np.array([(0, 0), (8, -1), (12, 5), (9, 10), (14, 15), (8, 22), (0, 20.0)])
HEIGHT, BORE = 5.0, 1.0


def edge(points: np.ndarray, knots: np.ndarray) -> bd.Edge:
    """The cubic through control points (n, 2) in the plane z = 0."""
    curve = convert.curve(BSplineCurve(np.pad(points, ((0, 0), (0, 1))), knots, 3))
    assert isinstance(curve, Geom_BSplineCurve)
    return bd.Edge(BRepBuilderAPI_MakeEdge(curve).Edge())


def extrude(*edges: bd.Edge) -> bd.Solid:
    return bd.extrude(bd.Face(bd.Wire(edges)), HEIGHT, dir=(0, 0, 1)).solids()[0]


def roof() -> bd.Solid:
    return extrude(edge(ROOF, TWO_ARCS), bd.Line((10, 0), (0, 0)).edge())


def bored(*places: float) -> bd.Solid:
    body = roof()
    for x in places:
        body = (body - bd.Pos(x, 2, 2.5) * bd.Rotation(90, 0, 0) * bd.Cylinder(BORE, 12)).solids()[0]
    return body


def vase(angle: float) -> bd.Solid:
    face = bd.Face(bd.Wire([edge(VASE, TWO_ARCS), bd.Line((0, 5), (0, 0)).edge()]))
    return bd.revolve(face, bd.Axis.Y, angle).solids()[0]


TILES = np.array([[6, 8, 5, 6], [7, 12, 9, 6], [6, 9, 14, 7.0]])
"""Heights over a grid of steps 2 and 3: one bilinear face with creases along both parameters."""


def tiled() -> bd.Solid:
    x, y = np.meshgrid(2.0 * np.arange(3), 3.0 * np.arange(4), indexing="ij")
    poles, knots = np.stack([x, y, TILES], axis=2), ([0.0, 0, 1, 2, 2], [0.0, 0, 1, 2, 3, 3])
    surface = convert.surface(BSplineSurface(poles, np.array(knots[0]), np.array(knots[1]), 1, 1))
    top = bd.Face(BRepBuilderAPI_MakeFace(surface, 1e-7).Face())
    deep = bd.extrude(top, dir=(0, 0, -1), amount=20).solids()[0]
    return (deep - bd.Pos(2, 4.5, -10) * bd.Box(4, 9, 20)).solids()[0]  # above z = 0


def line_integral(points: np.ndarray, knots: np.ndarray, power: int) -> float:
    """Integral of x^power dy along the cubic."""
    curve = BSpline(knots, points, 3)
    spans = np.unique(knots)
    return float(
        sum(
            quad(lambda t: curve(t)[0] ** power * curve(t, 1)[1], a, b)[0]
            for a, b in zip(spans[:-1], spans[1:], strict=True)
        )
    )


def bore_volume(place: float) -> float:
    """Of a bore along y below the roof."""
    curve = BSpline(TWO_ARCS, ROOF, 3)
    samples = np.linspace(0, 2, 4001)
    x, y = curve(samples).T

    def slice_area(at: float) -> float:
        return float(np.interp(at, x, y)) * 2 * float(np.sqrt(max(BORE**2 - (at - place) ** 2, 0.0)))

    return float(quad(slice_area, place - BORE, place + BORE, points=[5.0], limit=400)[0])


FOUR_ARCS = np.array([0.0, 0, 0, 0, 0.5, 1, 1.5, 2, 2, 2, 2])
ROOF_VOLUME = HEIGHT * abs(line_integral(ROOF, TWO_ARCS, 1))
CASES = {
    "roof": (roof, 2, ROOF_VOLUME),
    "bored at the crease": (lambda: bored(5.0), 2, ROOF_VOLUME - bore_volume(5.0)),
    "bored twice": (lambda: bored(5.0, 2.0), 2, ROOF_VOLUME - bore_volume(5.0) - bore_volume(2.0)),
    "closed, crease at the seam and opposite": (
        lambda: extrude(edge(DROP, TWO_ARCS)),
        2,
        HEIGHT * abs(line_integral(DROP, TWO_ARCS, 1)),
    ),
    "closed, crease at the seam alone": (
        lambda: extrude(edge(DROP, FOUR_ARCS)),
        2,
        HEIGHT * abs(line_integral(DROP, FOUR_ARCS, 1)),
    ),
    "whole turn, from pole to pole": (lambda: vase(360), 4, np.pi * line_integral(VASE, TWO_ARCS, 2)),
    "part of a turn": (lambda: vase(100), 2, np.radians(100) / 2 * line_integral(VASE, TWO_ARCS, 2)),
}


@pytest.mark.parametrize("name", CASES)
def test_every_part_is_smooth_and_bounds_the_same_volume(name: str) -> None:
    make, parts, expected = CASES[name]
    body = make()
    read = read_free_form_body(body, [str(i) for i in range(len(faces_of(body.wrapped)))])
    brep = read.brep
    assert connectivity.is_closed(brep)
    assert not read.carried
    assert volume(brep) == pytest.approx(expected, rel=1e-6)
    splines = [c for c in brep.carriers if isinstance(c, BSplineSurface)]
    assert len(splines) == parts
    for spline in splines:
        for knots, degree in ((spline.knots_u, spline.degree_u), (spline.knots_v, spline.degree_v)):
            assert np.unique(knots[degree + 1 : -degree - 1], return_counts=True)[1].max(initial=0) < degree
    tags = [brep.faces.tag[i] for i, c in enumerate(brep.faces.carrier) if isinstance(brep.carriers[c], BSplineSurface)]
    assert len(set(tags)) == 1, "the parts are of one face of the body"


def test_a_lattice_in_a_body_with_creases_and_what_it_leaves_make_up_the_body(cover: Cover) -> None:
    read = read_free_form_body(bd.Pos(0.3, 0.9, 2.1) * bored(5.0))
    lattice = cover("P", (2, 1, 1), (0.07, 0.11, 0.19), (-0.04, 0.04))
    parts = [
        combine_networks(read.brep, lattice, operation, is_cover=True) for operation in ("intersection", "difference")
    ]
    whole, (wall, rest) = volume(read.brep), (volume(part.brep) for part in parts)
    assert 0.05 * whole < wall < 0.6 * whole
    assert wall + rest == pytest.approx(whole, rel=1e-7)
    assert all(is_brep_valid(part.brep) for part in parts)


def test_creases_along_both_parameters_divide_a_face_into_tiles() -> None:
    body = tiled()
    read = read_free_form_body(body)
    means = 0.25 * (TILES[1:, 1:] + TILES[1:, :-1] + TILES[:-1, 1:] + TILES[:-1, :-1])
    assert connectivity.is_closed(read.brep)
    assert volume(read.brep) == pytest.approx(float((6.0 * means).sum()), rel=1e-9)
