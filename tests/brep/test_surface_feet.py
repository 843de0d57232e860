"""Feet on spline surfaces: nearest of all, through poles and seams, in any frame, beyond borders, at centres of curvature."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from tpmscad._typing import Array
from tpmscad.brep.foot_surface import tabulate_spans
from tpmscad.brep.free_form_surface import FreeFormSurface, find_smooth_seams
from tpmscad.brep.patch_pairs import unit_vectors
from tpmscad.rigid_motion import Motion
from tpmscad.splines.bspline import BSplineSurface
from tpmscad.splines.knots import greville_abscissae, restrict_surface, uniform_knots
from tpmscad.splines.spline_axis import gauss_axis
from tpmscad.splines.surface_fit import fit_surface

TURN = Rotation.from_rotvec([0.3, -1.1, 0.7]).as_matrix()
MOTIONS = {
    "turned": Motion(TURN, np.array([0.4, -7.0, 2.5])),
    "mirrored": Motion(np.diag([1.0, -1.0, 1.0]) @ TURN, np.array([1.0, 2.0, 3.0])),
}


def with_poles(make: Callable, spans: tuple[int, int], degrees: tuple[int, int]) -> BSplineSurface:
    """A surface whose poles are values of a function at the Greville abscissae."""
    knots = [uniform_knots(n, p) for n, p in zip(spans, degrees, strict=True)]
    u, v = np.meshgrid(*(greville_abscissae(t, p) for t, p in zip(knots, degrees, strict=True)), indexing="ij")
    return BSplineSurface(np.stack(make(u, v), axis=-1), *knots, *degrees)


def fitted(
    make: Callable, spans: tuple[int, int], degrees: tuple[int, int], u: tuple[float, float], v: tuple[float, float]
) -> BSplineSurface:
    """A fit to a function on u x v, with sides that are points or coincide made so to the last bit."""
    axes = [
        gauss_axis(uniform_knots(n, p, domain=domain), p) for n, p, domain in zip(spans, degrees, (u, v), strict=True)
    ]
    grid = np.meshgrid(axes[0].points, axes[1].points, indexing="ij")
    surface = fit_surface(np.stack(make(*grid), axis=-1), *axes)
    for row in (surface.poles[:, 0], surface.poles[:, -1]):
        if np.ptp(row, axis=0).max() < 1e-9:
            row[:] = row.mean(axis=0)
    if np.abs(surface.poles[0] - surface.poles[-1]).max() < 1e-9:
        surface.poles[0] = surface.poles[-1] = 0.5 * (surface.poles[0] + surface.poles[-1])
    return surface


def wave(u: Array, v: Array) -> tuple[Array, Array, Array]:
    return 3 * u, 2 * v, 0.5 * np.sin(4 * u) * np.cos(3 * v) + 0.3 * u * u


def nose(u: Array, v: Array) -> tuple[Array, Array, Array]:
    """A profile that turns about a sharp nose, extruded askew."""
    t = 2 * u - 1
    return 10 * t**2, 1.2 * np.sin(2.2 * t) + v, 12 * v


def spheroid(a: float, b: float) -> BSplineSurface:
    return fitted(
        lambda u, v: (a * np.cos(u) * np.cos(v), a * np.sin(u) * np.cos(v), b * np.sin(v)),
        (24, 12),
        (9, 8),
        (0.0, 2 * np.pi),
        (-np.pi / 2, np.pi / 2),
    )


def tube() -> BSplineSurface:
    return fitted(
        lambda u, v: ((2 + 0.3 * np.cos(3 * u)) * np.cos(u) + 0.1 * v * v, (1.5 + 0.2 * np.cos(2 * u)) * np.sin(u), v),
        (40, 3),
        (9, 4),
        (0.0, 2 * np.pi),
        (0.0, 4.0),
    )


def dome() -> BSplineSurface:
    """A pole at the end of v: S_u x S_v looks inwards."""
    return fitted(
        lambda u, v: (3 * np.cos(u) * (1 - v), 2 * np.sin(u) * (1 - v), 2 * v * (2 - v) + 0.2 * (1 - v) ** 4),
        (24, 1),
        (9, 5),
        (0.0, 2 * np.pi),
        (0.0, 1.0),
    )


SPLINES = {
    "cubic": lambda: with_poles(wave, (4, 3), (3, 2)),
    "degree 9": lambda: with_poles(wave, (3, 2), (9, 8)),
    "nose": lambda: with_poles(nose, (7, 1), (3, 1)),
    "spheroid": lambda: spheroid(3.0, 2.0),
    "tube": tube,
    "dome": dome,
}


@pytest.fixture(params=SPLINES, scope="module")
def carrier(request: pytest.FixtureRequest) -> FreeFormSurface:
    spline = SPLINES[request.param]()
    return FreeFormSurface(spline, find_smooth_seams(spline))


def points_about(carrier: FreeFormSurface, count: int, seed: int = 2) -> Array:
    poles = carrier.spline.poles.reshape(-1, 3)
    low, high = poles.min(axis=0), poles.max(axis=0)
    margin = 0.3 * np.maximum(high - low, 1.0)
    return np.random.default_rng(seed).uniform(low - margin, high + margin, (count, 3))


def beside(carrier: FreeFormSurface, count: int, seed: int = 3) -> tuple[Array, Array, Array, Array]:
    """Points at up to 0.4 of the least radius of curvature from random points: with these parameters, distances and normals."""
    rng = np.random.default_rng(seed)
    spline, uv = carrier.spline, [np.linspace(low, high, 61) for low, high in carrier.domain]
    normals = np.cross(spline.grid(*uv, 1, 0), spline.grid(*uv, 0, 1))[2:-2, 2:-2]  # without poles
    normals = normals / np.linalg.norm(normals, axis=2, keepdims=True)
    points = spline.grid(*uv)[2:-2, 2:-2]
    turns = [np.linalg.norm(np.diff(x, axis=a), axis=2) for a in (0, 1) for x in (normals, points)]
    reach = 0.3 / max((turns[0] / turns[1]).max(), (turns[2] / turns[3]).max())
    uv = np.array(
        [rng.uniform(low + 0.02 * (high - low), high - 0.02 * (high - low), count) for low, high in carrier.domain]
    )
    normal = unit_vectors(carrier.normal(*uv))
    distance = rng.uniform(-reach, reach, count)
    return carrier(*uv) + distance[:, None] * normal, uv.T, distance, normal


@pytest.mark.slow
def test_no_point_of_the_surface_is_nearer_than_the_foot(carrier: FreeFormSurface) -> None:
    points = points_about(carrier, 4000)
    found = carrier.feet(points)
    foot = carrier(*found.parameters.T)
    apart = np.linalg.norm(points - foot, axis=1)
    (u0, u1), (v0, v1) = carrier.domain
    grid = carrier.spline.grid(np.linspace(u0, u1, 401), np.linspace(v0, v1, 397)).reshape(-1, 3)
    assert (apart - cKDTree(grid).query(points)[0]).max() < 1e-12
    inner = ((found.parameters > (u0, v0)) & (found.parameters < (u1, v1))).all(axis=1)
    assert inner.mean() > 0.3
    np.testing.assert_allclose(np.abs(found.distance)[inner], apart[inner], rtol=0, atol=2e-14)
    assert (np.abs(found.distance) <= apart + 1e-14).all()
    np.testing.assert_allclose(np.linalg.norm(found.gradient, axis=1), 1.0, atol=1e-14)


def test_the_distance_from_the_foot_changes_no_faster_than_the_point_moves(carrier: FreeFormSurface) -> None:
    points = points_about(carrier, 2000, 5)
    steps = np.random.default_rng(6).normal(0.0, 0.02, points.shape)

    def apart(at: Array) -> Array:
        return np.linalg.norm(at - carrier(*carrier.parameters(at).T), axis=1)

    change = np.abs(apart(points + steps) - apart(points))
    assert (change <= np.linalg.norm(steps, axis=1) + 1e-13).all()


def test_a_step_along_the_normal_is_a_distance_of_its_length_and_sign(carrier: FreeFormSurface) -> None:
    points, uv, distance, normal = beside(carrier, 600)
    found = carrier.feet(points)
    np.testing.assert_allclose(found.distance, distance, rtol=0, atol=2e-14)
    np.testing.assert_allclose(found.gradient, normal, rtol=0, atol=2e-11)
    turns = (found.parameters - uv) / np.where(np.array(carrier.period) > 0, carrier.period, 1.0)
    turns -= np.where(np.array(carrier.period) > 0, np.round(turns), 0.0)
    np.testing.assert_allclose(turns, 0.0, atol=1e-11)


@pytest.mark.parametrize("motion", MOTIONS)
def test_what_is_moved_or_scaled_keeps_its_distances(carrier: FreeFormSurface, motion: str) -> None:
    points = points_about(carrier, 300)
    moved = carrier.moved(MOTIONS[motion])
    images = MOTIONS[motion].apply(points)
    one, other = carrier.feet(points), moved.feet(images)
    # where two feet are equally far the images may take the other one
    same = np.linalg.norm(MOTIONS[motion].apply(carrier(*one.parameters.T)) - moved(*other.parameters.T), axis=1) < 1e-6
    assert same.mean() > 0.98
    np.testing.assert_allclose(other.distance[same], one.distance[same], rtol=0, atol=1e-11)
    turned = MOTIONS[motion].apply_to_vectors(one.gradient)
    np.testing.assert_allclose(other.gradient[same], turned[same], atol=1e-7)
    larger = carrier.scaled(2.5)
    np.testing.assert_allclose(larger.distance(2.5 * points)[same], 2.5 * one.distance[same], rtol=0, atol=1e-11)


def test_a_point_alone_has_the_foot_that_it_has_among_many(carrier: FreeFormSurface) -> None:
    points = points_about(carrier, 200)
    alone = np.array([carrier.distance(point) for point in points])
    together = carrier.distance(points.reshape(10, 20, 3))
    assert together.shape == (10, 20)
    np.testing.assert_allclose(np.abs(together.ravel()), np.abs(alone), rtol=0, atol=1e-12)


def test_a_sphere_is_one_through_its_poles_and_across_its_seam() -> None:
    radius = 2.5
    ball = FreeFormSurface(spheroid(radius, radius), (True, False))
    rng = np.random.default_rng(8)
    points = rng.uniform(-4, 4, (3000, 3))
    axis = np.array([0.0, 0.0, 1.0]) * rng.uniform(0.5, 4, (40, 1)) * rng.choice([-1, 1], (40, 1))
    near = axis + rng.normal(size=(40, 3)) * 10.0 ** rng.uniform(-12, -2, (40, 1))
    seam = np.stack([rng.uniform(1, 4, 40), 1e-13 * rng.normal(size=40), rng.uniform(-2, 2, 40)], axis=1)
    points = np.concatenate([points[np.linalg.norm(points, axis=1) > 0.5], axis, near, seam])
    found = ball.feet(points)
    length = np.linalg.norm(points, axis=1)
    normal = points / length[:, None]
    np.testing.assert_allclose(found.distance, length - radius, rtol=0, atol=1e-12)  # of the fit
    np.testing.assert_allclose(found.gradient, normal, atol=3e-8)  # next to a pole S_u has eight digits


def test_across_the_seam_of_a_tube_feet_are_found_whether_it_is_told_closed_or_not() -> None:
    spline = tube()
    assert find_smooth_seams(spline) == (True, False)
    v = np.linspace(0.3, 3.7, 40)
    normal = unit_vectors(spline.normal(0 * v, v))
    tangent = unit_vectors(spline(0 * v, v, 1, 0))
    points = spline(0 * v, v) + 0.2 * normal + 1e-3 * np.linspace(-1, 1, 40)[:, None] * tangent
    closed, opened = FreeFormSurface(spline, (True, False)).feet(points), FreeFormSurface(spline).feet(points)
    np.testing.assert_allclose(closed.distance, 0.2, rtol=0, atol=1e-5)
    np.testing.assert_allclose(opened.distance, closed.distance, rtol=0, atol=1e-12)


def test_a_seam_with_a_crease_is_none() -> None:
    drop = fitted(
        lambda u, v: (2 * np.sin(u / 2), np.sin(u), 3 * v),
        (30, 1),
        (9, 1),
        (0.0, 2 * np.pi),
        (0.0, 1.0),
    )
    assert np.abs(drop.poles[0] - drop.poles[-1]).max() < 1e-9
    assert find_smooth_seams(drop) == (False, False)
    assert find_smooth_seams(dome()) == (True, False)


def test_beyond_its_border_a_surface_goes_on_by_its_polynomials_and_no_farther() -> None:
    whole = with_poles(wave, (1, 1), (3, 2))
    part = restrict_surface(whole, (0.3, 0.7), (0.4, 0.8))
    length = 0.2
    carriers = [FreeFormSurface(whole), FreeFormSurface(part, continuation=length), FreeFormSurface(part)]
    rng = np.random.default_rng(9)
    uv = rng.uniform(0.25, 0.85, (500, 2))
    normal = unit_vectors(whole.normal(*uv.T))
    points = whole(*uv.T) + rng.uniform(-0.05, 0.05, (500, 1)) * normal
    full, long, short = (carrier.feet(points) for carrier in carriers)
    inside = ((uv > (0.3, 0.4)) & (uv < (0.7, 0.8))).all(axis=1)
    np.testing.assert_allclose(short.distance[inside], full.distance[inside], rtol=0, atol=1e-13)
    low, high = tabulate_spans(part, continuation=length)[1].box.T + np.array([0.3, 0.4])
    goes_on = ((uv > low) & (uv < high)).all(axis=1)
    assert inside.sum() < goes_on.sum() < len(uv)
    assert (np.abs(long.distance - full.distance)[~goes_on] > 1e-9).mean() > 0.9
    np.testing.assert_allclose(long.distance[goes_on], full.distance[goes_on], rtol=0, atol=1e-13)
    border = np.stack([[low[0], high[0]], [low[1], high[1]]])
    for axis, at in enumerate(border):  # in space the way beyond the border is no longer than asked for
        for end, limit in zip(at, part.domain[axis], strict=True):
            t = np.linspace(*part.domain[1 - axis], 20)
            ends = [(np.full(20, x), t) if axis == 0 else (t, np.full(20, x)) for x in (end, limit)]
            apart = np.linalg.norm(whole(*ends[0]) - whole(*ends[1]), axis=1)
            assert 0.3 * length < apart.max() < 1.3 * length
    # half a span is the most
    assert np.allclose(tabulate_spans(part, continuation=1e3)[1].box, [[-0.2, 0.6], [-0.2, 0.6]])


def test_beyond_the_border_the_distance_is_that_of_the_tangent_plane_there() -> None:
    carrier = FreeFormSurface(with_poles(wave, (4, 3), (3, 2)))
    points = points_about(carrier, 500)
    found = carrier.feet(points)
    n = unit_vectors(carrier.normal(*found.parameters.T))
    plane = np.einsum("nk,nk->n", points - carrier(*found.parameters.T), n)
    np.testing.assert_allclose(found.distance, plane, rtol=0, atol=1e-14)
    on_border = ((found.parameters == 0) | (found.parameters == 1)).any(axis=1)
    assert 50 < on_border.sum() < 450


def test_the_place_of_the_surface_costs_no_more_digits_than_its_coordinates() -> None:
    carrier = FreeFormSurface(with_poles(wave, (3, 2), (9, 8)))
    points, _, distance, _ = beside(carrier, 200)
    shift = np.array([1e6, -3e6, 2e6])
    away = carrier.moved(Motion(np.eye(3), shift))
    np.testing.assert_allclose(away.distance(points + shift), distance, rtol=0, atol=4e-9)


def test_surfaces_out_of_range_are_refused() -> None:
    with pytest.raises(ValueError, match=r"\(10, 2\)"):
        tabulate_spans(with_poles(wave, (1, 3), (10, 2)))
    with pytest.raises(ValueError, match="2 dimensions"):
        tabulate_spans(with_poles(lambda u, v: (u, v), (1, 1), (1, 2)))
    with pytest.raises(ValueError, match="-1"):
        tabulate_spans(with_poles(wave, (1, 1), (1, 2)), continuation=-1.0)


def test_near_centres_of_curvature_no_second_foot_is_missed() -> None:
    carrier = FreeFormSurface(with_poles(wave, (4, 3), (3, 2)))
    u, v = np.random.default_rng(1).random((2, 20000))
    su, sv, suu, suv, svv = (carrier(u, v, *order) for order in ((1, 0), (0, 1), (2, 0), (1, 1), (0, 2)))
    normal = unit_vectors(np.cross(su, sv))
    first = np.einsum("inc,jnc->nij", [su, sv], [su, sv])
    second = np.einsum("ijnc,nc->nij", [[suu, suv], [suv, svv]], normal)
    bends = np.linalg.eigvals(np.linalg.solve(first, second)).real
    largest = np.take_along_axis(bends, np.abs(bends).argmax(axis=1)[:, None], axis=1)
    points = carrier(u, v) + np.random.default_rng(2).uniform(0.95, 1.6, (20000, 1)) / largest * normal
    points = points[np.abs(largest[:, 0]) > 0.5]
    assert len(points) > 5000
    points = points[:5000]
    found = carrier.feet(points)
    apart = np.linalg.norm(points - carrier(*found.parameters.T), axis=1)
    grid = carrier.spline.grid(np.linspace(0, 1, 81), np.linspace(0, 1, 77)).reshape(-1, 3)
    # samples of a sphere about the point are what a tree is slow for
    nearest = np.concatenate([np.sqrt(((grid - point) ** 2).sum(axis=1).min(keepdims=True)) for point in points])
    assert (apart - nearest).max() < 1e-12


def test_layers_closer_than_their_cells_are_thick_are_told_apart() -> None:
    def spiral(u: Array, v: Array) -> tuple[Array, Array, Array]:
        radius = 2 + 0.01 * u / (2 * np.pi)
        return radius * np.cos(u), radius * np.sin(u), 3 * v

    end = 4.4 * np.pi
    carrier = FreeFormSurface(fitted(spiral, (40, 1), (7, 2), (0.0, end), (0.0, 1.0)))
    rng = np.random.default_rng(1)
    u, v, distance = rng.uniform(0.3, end - 0.3, 2000), rng.uniform(0.1, 0.9, 2000), rng.uniform(-0.0045, 0.0045, 2000)
    normal = unit_vectors(carrier.normal(u, v))
    found = carrier.feet(carrier(u, v) + distance[:, None] * normal)
    np.testing.assert_allclose(found.distance, distance, rtol=0, atol=1e-13)


def test_a_long_strip_has_as_many_nodes_as_its_folds_take() -> None:
    def folds(u: Array, v: Array) -> tuple[Array, Array, Array]:
        return 100 * u, v, 3 * np.sin(50 * np.pi * u)

    carrier = FreeFormSurface(fitted(folds, (160, 1), (5, 1), (0.0, 1.0), (0.0, 1.0)))
    points = carrier(*np.random.default_rng(1).random((2, 5000)))
    np.testing.assert_allclose(carrier.distance(points), 0.0, rtol=0, atol=1e-12)


def test_a_surface_does_not_go_on_beyond_a_pole_or_a_seam() -> None:
    (u0, u1), (v0, v1) = tabulate_spans(dome(), (True, False), 0.1)[1].box
    assert (u0, u1, v1) == (0.0, 2 * np.pi, 1.0)
    assert v0 < 0
