"""Minimal surfaces as zero sets of series: curvature, place and topology, by routes other than the fit of the coefficients."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

from tests.surfaces.test_mirrors import check_genus
from tpmscad import fields, surfaces
from tpmscad._typing import Array
from tpmscad.errors import InvalidRequest
from tpmscad.fields.analysis.slope_bounds import bound_slope
from tpmscad.lattices.mirror_fit import fit_mirror_piece
from tpmscad.minimal_series import GENERATORS, MINIMAL_SERIES, generate_group, read_operation
from tpmscad.surfaces.curvature_integrals import measure_mirror_surface
from tpmscad.surfaces.plane_waves import level_set_waves

NAMES = tuple(MINIMAL_SERIES)
EXACT = tuple(name for name in NAMES if surfaces.CATALOGUE[name].primitives == "exact")
MIRRORED = tuple(name for name in NAMES if surfaces.CATALOGUE[name].primitives == "mirrored")
POINTS = np.random.default_rng(3).random((40, 3))
COUNT = 400
NORMAL_STEP = 2e-4
ROUND_OFF = 2e-10
"""Differences of unit normals over the step above have this error, 1 / period."""


def find_feet(field: fields.Field, points: Array, steps: int = 30) -> Array:
    """The points that reach the zero set along the gradient."""
    for _ in range(steps):
        value, gradient = field.value_and_gradient(points)
        points = points - (value / (gradient**2).sum(axis=1))[:, None] * gradient
    value, gradient = field.value_and_gradient(points)
    return points[np.abs(value) < 1e-12 * np.linalg.norm(gradient, axis=1)]


@cache
def surface_points(name: str) -> Array:
    return find_feet(fields.tpms(name, 1.0, reference="minimal"), np.random.default_rng(9).random((COUNT, 3)))


def measure_mean_curvature(field: fields.Field, points: Array) -> Array:
    """Half the divergence of the unit normal, by differences of the fourth order."""

    def normal(x: Array) -> Array:
        gradient = field.gradient(x)
        return np.asarray(gradient / np.linalg.norm(gradient, axis=1, keepdims=True))

    total = np.zeros(len(points))
    for axis, step in enumerate(NORMAL_STEP * np.eye(3)):
        near, far = ((normal(points + s * step) - normal(points - s * step))[:, axis] for s in (1, 2))
        total += (8 * near - far) / (12 * NORMAL_STEP)
    return total / 2


def distances_from_nodal(name: str, points: Array) -> Array:
    """Orthogonal distances of points from the nodal surface, by alternating projections."""
    nodal = fields.tpms(name, 1.0)
    foot = points
    for _ in range(40):
        value, gradient = nodal.value_and_gradient(foot)
        unit = gradient / np.linalg.norm(gradient, axis=1, keepdims=True)
        foot = points - ((points - foot) * unit).sum(axis=1, keepdims=True) * unit
        value, gradient = nodal.value_and_gradient(foot)
        foot = foot - (value / (gradient**2).sum(axis=1))[:, None] * gradient
    return np.asarray(np.linalg.norm(points - foot, axis=1))


@pytest.mark.parametrize("name", NAMES)
def test_the_mean_curvature_is_at_most_the_stated_residual(name: str) -> None:
    points = surface_points(name)
    assert len(points) > 0.8 * COUNT
    greatest = np.abs(measure_mean_curvature(fields.tpms(name, 1.0, reference="minimal"), points)).max()
    assert greatest <= 1.1 * MINIMAL_SERIES[name].mean_curvature + ROUND_OFF
    assert MINIMAL_SERIES[name].mean_curvature < 1e-5


@pytest.mark.parametrize("name", NAMES)
def test_the_distance_from_the_nodal_surface_is_the_stated_one(name: str) -> None:
    greatest, stated = distances_from_nodal(name, surface_points(name)).max(), MINIMAL_SERIES[name].nodal_distance
    assert 0.95 * stated < greatest < 1.001 * stated


@pytest.mark.parametrize("name", EXACT)
def test_the_series_vanishes_on_the_surface_of_the_weierstrass_integrals(name: str) -> None:
    t = np.linspace(0.0, 1.0, 9)
    points = surfaces.primitive_patch(name, "minimal").jet(t[:, None], t).position.reshape(-1, 3)
    value, gradient = fields.tpms(name, 1.0, reference="minimal").value_and_gradient(points)
    assert (np.abs(value) / np.linalg.norm(gradient, axis=1)).max() < 1e-11
    copies = surfaces.patch_symmetry(name).cell_motions[:, None].apply(points)
    normal = surfaces.primitive_patch(name, "minimal").mid_and_normal(t[:, None], t[None, :] + 0 * t[:, None])[1][0]
    assert (np.einsum("ni,ni->n", normal.reshape(-1, 3), gradient) > 0).all()  # the same side is solid
    assert np.abs(fields.tpms(name, 1.0, reference="minimal")(copies)).max() < 1e-9


@pytest.mark.parametrize("name", NAMES)
def test_the_genus_is_that_of_the_nodal_surface(name: str) -> None:
    """A series with further zeros would have other components."""
    check_genus(fields.tpms(name, 1.0, reference="minimal"), surfaces.CATALOGUE[name])


@pytest.mark.parametrize("name", NAMES)
def test_products_and_plane_waves_are_one_function(name: str) -> None:
    field, waves = fields.tpms(name, 1.0, reference="minimal"), level_set_waves(name, "minimal")
    np.testing.assert_allclose(field(POINTS), waves.value(POINTS), rtol=0, atol=1e-12)
    np.testing.assert_allclose(field.gradient(POINTS), waves.gradient(POINTS), rtol=0, atol=1e-10)
    assert bound_slope(field, np.zeros(3), np.ones(3)) > np.linalg.norm(field.gradient(POINTS), axis=1).max()


@pytest.mark.parametrize("name", NAMES)
def test_nodal_and_minimal_functions_have_the_stated_symmetries(name: str) -> None:
    for reference in ("nodal", "minimal"):
        field = fields.tpms(name, 1.0, reference=reference)
        for rotation, translation, sign in map(read_operation, GENERATORS[name]):
            np.testing.assert_allclose(field(POINTS @ rotation.T + translation), sign * field(POINTS), atol=1e-12)
    orders = {"P": 48, "I": 96, "F": 192}
    keep = [placement for placement in generate_group(GENERATORS[name]) if placement[2] > 0]
    assert len(keep) == orders[surfaces.CATALOGUE[name].space_group[0]] // (1 + (name in ("gyroid", "fischer_koch_s")))


@pytest.mark.parametrize("name", NAMES)
def test_the_range_is_that_of_the_values(name: str) -> None:
    t = np.arange(48) / 48
    values = fields.tpms(name, 1.0, reference="minimal").on_grid(t, t, t)
    low, high = MINIMAL_SERIES[name].value_range
    assert low - 1e-12 <= values.min() < low + 0.01 * (high - low)
    assert high + 1e-12 >= values.max() > high - 0.01 * (high - low)
    with pytest.raises(InvalidRequest, match=r"everything solid|nothing solid"):
        fields.rod(fields.tpms(name, 1.0, reference="minimal"), high + 0.01)


@pytest.mark.parametrize("name", MIRRORED)
@pytest.mark.slow
def test_the_minimal_piece_has_less_area_and_no_mean_curvature(name: str) -> None:
    """A minimal surface is the critical one; its Gauss curvature is the nodal one's, by the theorem of Gauss and Bonnet."""
    minimal, nodal = (measure_mirror_surface(name, reference) for reference in ("minimal", "nodal"))
    assert minimal.area < nodal.area
    assert abs(minimal.mean_curvature_integral) < 10 * MINIMAL_SERIES[name].mean_curvature
    assert minimal.gauss_curvature_integral == pytest.approx(nodal.gauss_curvature_integral, abs=1e-9)
    assert minimal.max_offset == pytest.approx(-minimal.min_offset, rel=1e-4)  # both curvatures are opposite everywhere


@pytest.mark.slow
def test_the_patch_fitted_to_a_minimal_piece_has_no_mean_curvature() -> None:
    """By the fundamental forms of the B-spline patch, without the series."""
    patch = fit_mirror_piece("iwp", 0.0, 1e-5, "minimal").patch
    nodal = fit_mirror_piece("iwp", 0.0, 1e-5).patch
    t, step = np.linspace(0.1, 0.9, 7), 1e-3
    u, v = (a.ravel() for a in np.meshgrid(t, t))

    def mean(of: Any) -> Array:
        def at(a: float, b: float) -> Array:
            return np.asarray(of(u + a * step, v + b * step))

        du, dv = (at(1, 0) - at(-1, 0)) / (2 * step), (at(0, 1) - at(0, -1)) / (2 * step)
        duu, dvv = ((at(1, 0) + at(-1, 0) - 2 * at(0, 0)) / step**2, (at(0, 1) + at(0, -1) - 2 * at(0, 0)) / step**2)
        duv = (at(1, 1) - at(1, -1) - at(-1, 1) + at(-1, -1)) / (4 * step**2)
        normal = np.cross(du, dv)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)

        def dot(a: Array, b: Array) -> Array:
            return np.asarray((a * b).sum(axis=1))

        e, f, g = dot(du, du), dot(du, dv), dot(dv, dv)
        left, middle, right = dot(duu, normal), dot(duv, normal), dot(dvv, normal)
        return np.asarray((e * right - 2 * f * middle + g * left) / (2 * (e * g - f**2)))

    assert np.abs(mean(patch)).max() < 0.02
    assert np.abs(mean(nodal)).max() > 1.0


@pytest.mark.parametrize("name", ["lidinoid", "split_p", "octo"])
def test_a_surface_without_a_minimal_one_nearby_says_so(name: str) -> None:
    with pytest.raises(InvalidRequest, match="no minimal surface with the symmetry"):
        fields.tpms(name, 1.0, reference="minimal")
    assert name not in MINIMAL_SERIES


def test_every_surface_of_the_catalogue_has_a_minimal_reference_or_none() -> None:
    assert {name for name, info in surfaces.CATALOGUE.items() if "minimal" in info.references} == set(MINIMAL_SERIES)
