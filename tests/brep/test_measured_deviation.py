"""Bounds on the distance of chords and triangles hold, are near what they bound, and are kept by halving."""

from __future__ import annotations

import numpy as np
import pytest

from tpmscad.brep.orthogonal_projection import project_to_patch
from tpmscad.brep.triangles.height_extrema import divide_at_extrema
from tpmscad.brep.triangles.measured_deviation import (
    FaceTriangles,
    bound_chords,
    bound_triangles,
    choose_apart,
    divide_curves,
    pair_sides,
    refine_triangles,
    split_sides,
    split_triangles,
)
from tpmscad.errors import OutOfMemory
from tpmscad.splines import BSplineSurface, bezier_knots

RADIUS = 2.0


def cylinder(_: np.ndarray, uv: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A cylinder whose angle is not proportional to u."""
    angle, rate = uv[:, 0] + 0.2 * uv[:, 0] ** 2, 1.0 + 0.4 * uv[:, 0]
    zero = np.zeros(len(uv))
    point = np.stack([RADIUS * np.cos(angle), RADIUS * np.sin(angle), uv[:, 1]], axis=1)
    along = RADIUS * rate[:, None] * np.stack([-np.sin(angle), np.cos(angle), zero], axis=1)
    return point, along, np.stack([zero, zero, zero + 1.0], axis=1)


def circle(_: np.ndarray, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return cylinder(_, np.stack([t, np.zeros(len(t))], axis=1))[:2]


def grid_mesh(n: int, m: int) -> FaceTriangles:
    u, v = np.meshgrid(np.linspace(0, 1.5, n + 1), np.linspace(0, 3.0, m + 1), indexing="ij")
    uv = np.stack([u.ravel(), v.ravel()], axis=1)
    i, j = (a.ravel() for a in np.meshgrid(np.arange(n), np.arange(m), indexing="ij"))
    a = i * (m + 1) + j
    b, c, d = a + m + 1, a + m + 2, a + 1
    triangles = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    points = cylinder(np.zeros(len(uv)), uv)[0]
    return FaceTriangles(points, uv, triangles, np.zeros(len(triangles), np.int64), pair_sides(triangles, len(uv)))


def test_a_chord_is_as_far_from_a_circle_as_its_sagitta() -> None:
    ends = np.array([[0.0, 0.3], [0.4, 1.1]])
    points = circle(np.zeros(4), ends.ravel())[0].reshape(2, 2, 3)
    sagitta = RADIUS - np.linalg.norm(points.mean(axis=1)[:, :2], axis=1)
    found = bound_chords(circle, np.zeros(2, np.int64), ends, points)
    assert (found >= sagitta).all()
    assert found == pytest.approx(sagitta, rel=0.1)


def test_curves_are_divided_into_few_chords_that_keep_the_deviation() -> None:
    deviation, span = np.array([1e-3]), np.array([[0.0, 1.5]])
    (shares,) = divide_curves(circle, span, deviation, 1.0, np.array([1]), np.array([False]))
    t = 1.5 * shares
    turn = np.diff(t + 0.2 * t**2)
    assert (RADIUS * (1 - np.cos(turn / 2)) <= deviation).all()
    least = (t[-1] + 0.2 * t[-1] ** 2) / (2 * np.arccos(1 - deviation[0] / RADIUS))
    assert len(turn) <= 1.15 * least + 1
    (even,) = divide_curves(circle, span, deviation, 1.0, np.array([1]), np.array([True]))
    assert np.allclose(even, 1 - even[::-1], atol=1e-15)
    with pytest.raises(OutOfMemory, match="raise the deviation"):
        divide_curves(circle, span, np.array([1e-30]), 1.0, np.array([1]), np.array([False]))


def test_triangles_are_bounded_whatever_the_parametrisation() -> None:
    """On a cylinder the distance of a flat triangle is that of its point nearest to the axis."""
    mesh = grid_mesh(3, 2)
    limits = np.array([[[0.0, 0.0], [1.5, 3.0]]])
    corners = mesh.points[mesh.triangles]
    bound, _ = bound_triangles(cylinder, mesh.face, corners, mesh.uv[mesh.triangles], limits, 0.1)
    w = np.random.default_rng(3).dirichlet((1, 1, 1), 4000)
    w = np.concatenate([w, [[0.5, 0.5, 0], [0, 0.5, 0.5], [0.5, 0, 0.5]]])
    true = RADIUS - np.linalg.norm((w @ corners)[..., :2], axis=2).min(axis=1)
    assert (bound >= true).all()
    assert (bound <= 1.12 * true).all()


def test_triangles_are_halved_until_they_keep_the_deviation() -> None:
    deviation = 4e-3
    fine, reached = refine_triangles(grid_mesh(24, 1), cylinder, 1, deviation)
    coarse, missed = refine_triangles(grid_mesh(1, 1), cylinder, 1, deviation)
    assert reached[0] <= deviation < missed[0]  # sides on edges stay, and are too long in the second
    for found in (fine, coarse):
        assert np.array_equal(found.twin, pair_sides(found.triangles, len(found.points)))
        a, b = (found.uv[found.triangles[:, k]] - found.uv[found.triangles[:, 0]] for k in (1, 2))
        area = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
        assert (area > 0).all()
        assert area.sum() / 2 == pytest.approx(1.5 * 3.0)
    assert ((fine.twin < 0).sum(), (coarse.twin < 0).sum()) == (50, 4)


def test_a_saddle_is_followed_within_the_deviation() -> None:
    knots = bezier_knots(1)
    saddle = BSplineSurface(np.array([[[0.0, 0, 0], [0, 1, 0]], [[1, 0, 0], [1, 1, 1.0]]]), knots, knots, 1, 1)
    uv = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
    triangles = np.array([[0, 1, 2], [0, 2, 3]])
    mesh = FaceTriangles(saddle(*uv.T), uv, triangles, np.zeros(2, np.int64), pair_sides(triangles, 4))

    def surface(_: np.ndarray, at: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return saddle.jet(*at.T)

    found, reached = refine_triangles(mesh, surface, 1, 0.02)
    w = np.random.default_rng(5).dirichlet((1, 1, 1), 200)
    points = (w @ found.points[found.triangles]).reshape(-1, 3)
    at = (w @ found.uv[found.triangles]).reshape(-1, 2)
    true = project_to_patch(saddle, points, *at.T)[0].max()
    assert true <= reached[0] <= 0.02
    assert reached[0] <= 1.3 * true


def test_split_sides_and_triangles_know_their_neighbours() -> None:
    mesh = grid_mesh(4, 5)
    side = np.flatnonzero((mesh.twin.ravel() > np.arange(mesh.twin.size)) & (np.arange(mesh.twin.size) % 7 < 3))
    side = side[choose_apart(mesh, side, np.random.default_rng(1).random(len(side)))]
    split, changed = split_sides(mesh, cylinder, side, np.linspace(0.2, 0.7, len(side)))
    assert len(side) >= 5
    assert len(split.triangles) == len(mesh.triangles) + 2 * len(side)
    assert np.array_equal(split.twin, pair_sides(split.triangles, len(split.points)))
    which = np.arange(0, len(split.triangles), 2)
    divided, _ = split_triangles(split, cylinder, which, split.uv[split.triangles[which]].mean(axis=1))
    assert len(divided.triangles) == len(split.triangles) + 2 * len(which)
    assert np.array_equal(divided.twin, pair_sides(divided.triangles, len(divided.points)))
    np.testing.assert_allclose(divided.points, cylinder(np.zeros(0), divided.uv)[0])
    untouched = np.setdiff1d(np.arange(len(mesh.triangles)), changed)
    assert np.array_equal(split.triangles[untouched], mesh.triangles[untouched])


def test_curves_are_divided_where_they_are_highest_and_lowest() -> None:
    def wave(_: np.ndarray, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.stack([t, 0 * t, np.sin(t)], axis=1), np.stack([1 + 0 * t, 0 * t, np.cos(t)], axis=1)

    shares = [np.array([0.0, 0.5, 1.0]), np.array([0.0, 1.0])]
    found = divide_at_extrema(wave, np.array([[0.1, 4.9], [2.0, 4.0]]), shares, 1e-9)
    assert 0.1 + 4.8 * found[0] == pytest.approx([0.1, np.pi / 2, 2.5, 3 * np.pi / 2, 4.9], abs=1e-7)
    assert np.array_equal(found[1], shares[1])
