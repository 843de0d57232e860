"""Evaluators of faces and edges give the points and first derivatives of the surface, for every kind of surface."""

from __future__ import annotations

import build123d as bd
import numpy as np
import pytest
from OCP.BRepAdaptor import BRepAdaptor_Surface

from tpmscad.kernel.occt.geometry_evaluators import (
    SplineSurfaceEvaluator,
    edge_evaluator,
    face_evaluator,
    pack_curves,
    pack_surfaces,
)
from tpmscad.splines.bspline import BSplineSurface

pytestmark = pytest.mark.kernel

STEP = 1e-6
SOLIDS = {
    "box": lambda: bd.Pos(1, 2, 3) * bd.Box(2, 3, 4),
    "cylinder": lambda: bd.Rot(20, 30, 0) * bd.Cylinder(2, 5),
    "torus": lambda: bd.Torus(4, 1),
    "cone": lambda: bd.Rot(0, 40, 10) * bd.Cone(3, 1, 4),
    "mirrored cone": lambda: bd.mirror(bd.Rot(0, 40, 10) * bd.Cone(3, 1, 4), bd.Plane.YZ),
    "ball": lambda: bd.Pos(0, 1, 0) * bd.Rot(30, 0, 50) * bd.Sphere(2),
    "oblique cylinder": lambda: bd.split(bd.Cylinder(2, 9), bd.Plane((0, 0, 0), z_dir=(1, 0, 2))),
    "spline": lambda: bd.extrude(bd.make_face(bd.Spline((0, 0), (2, 1), (3, -1), (0, 0), periodic=False)), 2),
}


def clamped(degree: int, inner: list[float]) -> np.ndarray:
    return np.concatenate([np.zeros(degree + 1), inner, np.ones(degree + 1)])


@pytest.mark.parametrize(("degree_u", "degree_v"), [(1, 2), (2, 1), (3, 5), (7, 4)])
def test_a_spline_surface_has_the_points_and_derivatives_of_its_basis(degree_u: int, degree_v: int) -> None:
    knots_u, knots_v = clamped(degree_u, [0.2, 0.45, 0.45, 0.8][: degree_u + 2]), clamped(degree_v, [0.5])
    counts = len(knots_u) - degree_u - 1, len(knots_v) - degree_v - 1
    poles = np.random.default_rng(degree_u).normal(size=(*counts, 3))
    surface = BSplineSurface(poles, knots_u, knots_v, degree_u, degree_v)
    grid = np.concatenate([np.linspace(0.0, 1.0, 12), [0.2, 0.5, 0.8]])
    uv = np.stack(np.meshgrid(grid, grid, indexing="ij"), axis=-1).reshape(-1, 2)
    found = SplineSurfaceEvaluator(surface)(uv)
    for values, order in zip(found, ((0, 0), (1, 0), (0, 1)), strict=True):
        expected = np.array([surface(u, v, *order) for u, v in uv])
        np.testing.assert_allclose(values, expected, rtol=0, atol=1e-11)


@pytest.mark.parametrize("name", SOLIDS)
def test_derivatives_of_faces_and_edges_are_those_of_differences(name: str) -> None:
    solid = SOLIDS[name]()
    for face in solid.faces():
        evaluate = face_evaluator(face.wrapped)
        adaptor = BRepAdaptor_Surface(face.wrapped)
        low = np.array([adaptor.FirstUParameter(), adaptor.FirstVParameter()])
        high = np.array([adaptor.LastUParameter(), adaptor.LastVParameter()])
        uv = low + np.random.default_rng(1).uniform(0.01, 0.99, (20, 2)) * (high - low)
        points, by_u, by_v = evaluate(uv)
        np.testing.assert_allclose(points, [adaptor.Value(u, v).Coord() for u, v in uv.tolist()], atol=1e-12)
        for axis, slope in ((0, by_u), (1, by_v)):
            step = STEP * np.eye(2)[axis]
            ahead, behind = evaluate(uv + step)[0], evaluate(uv - step)[0]
            np.testing.assert_allclose((ahead - behind) / (2 * STEP), slope, atol=1e-6)
    for edge in solid.edges():
        evaluate = edge_evaluator(edge.wrapped)
        t = np.linspace(edge.param_at(0.1), edge.param_at(0.9), 9)
        points, slope = evaluate(t)
        ahead, behind = evaluate(t + STEP)[0], evaluate(t - STEP)[0]
        np.testing.assert_allclose((ahead - behind) / (2 * STEP), slope, atol=1e-6)
        assert max(bd.Vertex(*p).distance(edge) for p in points.tolist()) < 1e-6


def test_tables_give_what_their_surfaces_and_curves_give() -> None:
    solids = [make() for make in SOLIDS.values()]
    faces = [face_evaluator(face.wrapped) for solid in solids for face in solid.faces()]
    curves = [edge_evaluator(edge.wrapped) for solid in solids for edge in solid.edges()]
    rng = np.random.default_rng(5)
    which, uv = rng.integers(0, len(faces), 400), rng.uniform(-0.1, 1.1, (400, 2))
    table = pack_surfaces(faces)
    for packed, numbers in ((table, which), (table.select(np.arange(len(faces))[::-1]), len(faces) - 1 - which)):
        for k, values in enumerate(packed(numbers, uv)):
            expected = [faces[f](at[None])[k][0] for f, at in zip(which.tolist(), uv, strict=True)]
            np.testing.assert_allclose(values, expected, atol=1e-12)
    which, t = rng.integers(0, len(curves), 300), rng.uniform(0.0, 1.0, 300)
    for k, values in enumerate(pack_curves(curves).select(np.arange(len(curves)))(which, t)):
        expected = [curves[e](at[None])[k][0] for e, at in zip(which.tolist(), t, strict=True)]
        np.testing.assert_allclose(values, expected, atol=1e-12)
