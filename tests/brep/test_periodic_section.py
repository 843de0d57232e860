"""Sections of an endless lattice: joined by links, they are those of the field everywhere, in any outline."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from skimage import measure

from tpmscad.brep.loops import signed_area
from tpmscad.brep.sections.periodic_section import PeriodicSection, find_periodic_section
from tpmscad.brep.sections.polygon_regions import combine_regions, region_length, signed_areas, thin_curve, thin_polygon
from tpmscad.errors import TrimmingError

CELL, LOW = np.array([2.0, 3.0]), np.array([0.31, -0.27])
N = 120


def wave(kind: str, points: np.ndarray) -> np.ndarray:
    """Periodic functions of the plane, negative in the solid, whose curves are islands, holes, stripes and slanted stripes."""
    x, y = (2 * np.pi * points / CELL).T
    return {
        "islands": -np.cos(x) - np.cos(y) + 0.8,
        "holes": -np.cos(x) - np.cos(y) - 0.8,
        "stripes": np.cos(y + 0.6 * np.sin(x)) + 0.2,
        "slanted": np.cos(2 * x - y + 0.4 * np.sin(y)) - 0.3,
        "mixed": np.cos(y + 0.6 * np.sin(x)) + 0.9 * np.cos(2 * x) * np.sin(2 * y) + 0.1,
    }[kind]


KINDS = ("islands", "holes", "stripes", "slanted", "mixed")


def section_of(kind: str) -> PeriodicSection:
    """The section from the contours in one cell that scikit-image finds, closed by a rim of void."""
    axes = [low + cell * np.arange(-1, N + 2) / N for low, cell in zip(LOW, CELL, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    values = wave(kind, grid.reshape(-1, 2)).reshape(grid.shape[:2])
    box = np.array([LOW, [LOW[0] + CELL[0], LOW[1]], LOW + CELL, [LOW[0], LOW[1] + CELL[1]]])
    contours = [
        LOW + CELL * (c[:-1] - 2) / N for c in measure.find_contours(np.pad(values, 1, constant_values=9.0), 0.0)
    ]
    if signed_areas(contours) < 0:
        contours = [contour[::-1] for contour in contours]
    region = combine_regions(contours, [box], "intersection")
    area = signed_areas(region)
    return find_periodic_section(region, area, LOW, CELL)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.slow
def test_the_covered_rectangle_is_solid_where_the_function_is_negative(kind: str) -> None:
    section = section_of(kind)
    low, high = np.array([-5.3, 2.1]), np.array([6.4, 13.2])
    points = np.random.default_rng(0).uniform(low, high, (1500, 2))
    values = wave(kind, points)
    clear = np.abs(values) > 0.03
    inside = sum(np.sign(signed_area(p)) * measure.points_in_poly(points, p) for p in section.cover(low, high)) > 0
    assert (inside == (values < 0))[clear].all()
    assert clear.mean() > 0.9
    assert section.filled == (kind == "holes")


@pytest.mark.parametrize("kind", KINDS)
def test_a_thinned_section_has_about_the_same_area(kind: str) -> None:
    section = section_of(kind)
    assert section.thin(0.01).area == pytest.approx(section.area, abs=0.02)
    assert section.thin(0.01).length <= section.length


@settings(max_examples=12, deadline=None)
@given(st.sampled_from(KINDS), st.integers(0, 10**6))
def test_within_an_outline_it_is_solid_where_the_function_is_negative(kind: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    angle = np.sort(rng.uniform(0, 2 * np.pi, 12))
    star = rng.uniform(3, 9, (12, 1)) * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    hole = 1.3 * np.stack([np.cos(angle), np.sin(angle)], axis=1)[::-1]
    outline = combine_regions([star], [hole[::-1]], "difference")
    section = section_of(kind)
    found = section.combine(outline, "intersection")
    points = rng.uniform(-9, 9, (400, 2))
    values = wave(kind, points)
    within, solid = (
        sum(np.sign(signed_area(p)) * measure.points_in_poly(points, p) for p in region) > 0
        for region in (outline, found)
    )
    clear = np.abs(values) > 0.03
    assert (solid == within & (values < 0))[clear].all()
    rest = section.combine(outline, "difference")
    rounding = 1e-8 * (region_length(found) + region_length(rest))  # of points to Clipper2's integers
    assert signed_areas(found) + signed_areas(rest) == pytest.approx(signed_areas(outline), abs=rounding)


def test_an_outline_may_run_along_a_curve() -> None:
    section = section_of("islands")
    island = max(section.cover(LOW, LOW + CELL), key=signed_area)
    assert signed_areas(section.combine([island], "intersection")) == pytest.approx(signed_area(island), rel=1e-9)


def test_sides_that_do_not_match_are_told() -> None:
    """A bar that leaves the cell on its right side and enters on its left a tenth higher."""
    bar = np.array([(0.0, 1.1), (0.0, 0.6), (2.0, 0.5), (2.0, 1.0)])
    with pytest.raises(TrimmingError, match="do not match"):
        find_periodic_section([bar], 1.0, np.zeros(2), CELL)


@given(st.integers(0, 10**6), st.floats(0.001, 0.5))
def test_points_that_are_left_out_lie_within_the_error(seed: int, error: float) -> None:
    curve = np.cumsum(np.random.default_rng(seed).normal(size=(40, 2)), axis=0)
    thin = thin_curve(curve, error)
    a, b = thin[:-1, None], thin[1:, None]
    t = np.clip(((curve - a) * (b - a)).sum(axis=-1) / ((b - a) ** 2).sum(axis=-1), 0, 1)[..., None]
    assert np.linalg.norm(curve - a - t * (b - a), axis=-1).min(axis=0).max() <= error + 1e-12
    assert (thin[[0, -1]] == curve[[0, -1]]).all()
    assert len(thin_polygon(curve, error)) <= len(curve)
