"""Rods, pores and sheets, booleans, and volume fractions."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tpmscad import fields
from tpmscad.errors import InvalidRequest
from tpmscad.fields.kinds.volume_fraction_thresholds import FRACTION_ACCURACY

RNG = np.random.default_rng(11)
POINTS = RNG.uniform(-5, 5, (3000, 3))
GYROID, DIAMOND, SCHWARZ_P = (fields.tpms(name, (2.0, 3.0, 4.0)) for name in ("gyroid", "diamond", "schwarz_p"))
GRADED = fields.ramp("x", (-4, 4), (-0.6, 0.6))


@pytest.mark.parametrize("c", [0.3, GRADED])
def test_rod_pore_and_sheet_are_solid_where_the_paper_says(c: float | fields.Field) -> None:
    phi, threshold = GYROID(POINTS), fields.as_field(c)(POINTS)
    assert ((fields.rod(GYROID, c)(POINTS) <= 0) == (phi <= threshold)).all()
    assert ((fields.pore(GYROID, c)(POINTS) <= 0) == (phi >= threshold)).all()
    both = (threshold - 0.4 <= phi) & (phi <= threshold)
    assert ((fields.sheet(GYROID, fields.as_field(c) - 0.4, c)(POINTS) <= 0) == both).all()


@pytest.mark.parametrize("low", [-0.3, fields.constant(-0.3)])
def test_thresholds_that_leave_nothing_or_everything_are_refused(low: float | fields.Field) -> None:
    with pytest.raises(InvalidRequest, match=r"nothing solid: gyroid takes values from -1.5 to 1.5"):
        fields.rod(GYROID, -1.5)
    with pytest.raises(InvalidRequest, match="everything solid"):
        fields.rod(GYROID, 1.6)
    with pytest.raises(InvalidRequest, match="nothing solid"):
        fields.pore(DIAMOND, 1.5)
    with pytest.raises(InvalidRequest, match="everything solid"):
        fields.pore(DIAMOND, -1.5)
    with pytest.raises(InvalidRequest, match="nothing solid"):
        fields.sheet(GYROID, 2, 3)
    with pytest.raises(InvalidRequest, match=r"from -0.3 to -0.3 is empty"):
        fields.sheet(GYROID, low, -0.3)


@given(st.lists(st.sampled_from([GYROID, DIAMOND, fields.sphere((0, 1, 0), 3.0), -0.2]), min_size=1, max_size=4))
@pytest.mark.slow
def test_booleans_of_fields_are_those_of_their_solids(parts: list[fields.Field]) -> None:
    points = POINTS[:300]
    solids = np.stack([fields.as_field(part)(points) < 0 for part in parts])
    assert ((fields.union(*parts)(points) < 0) == solids.any(axis=0)).all()
    assert ((fields.intersection(*parts)(points) < 0) == solids.all(axis=0)).all()
    rest = solids[0] & ~solids[1:].any(axis=0)
    assert ((fields.difference(*parts)(points) < 0) == rest).all()
    assert ((fields.complement(parts[0])(points) < 0) == ~solids[0]).all()


def test_operators_are_the_booleans_and_the_arithmetic() -> None:
    f, g = GYROID(POINTS), DIAMOND(POINTS)
    for combined, expected in (
        (GYROID | DIAMOND, np.minimum(f, g)),
        (GYROID & 0.2, np.maximum(f, 0.2)),
        (~GYROID, -f),
        (GYROID + DIAMOND, f + g),
        (1 - GYROID, 1 - f),
        (GYROID - 1, f - 1),
        (2 * GYROID * DIAMOND, 2 * f * g),
        (-GYROID / 4, -f / 4),
        (np.float64(2) * GYROID, 2 * f),
        (np.float64(2) - GYROID, 2 - f),
    ):
        np.testing.assert_allclose(combined(POINTS), expected, rtol=1e-15, atol=1e-15)
    for wrong in (0, GYROID):
        with pytest.raises(InvalidRequest, match="divided"):
            GYROID / wrong


def test_smooth_booleans_round_only_where_the_values_are_close() -> None:
    f, g, width = GYROID(POINTS), DIAMOND(POINTS), 0.4
    far = np.abs(f - g) >= width
    union, common = fields.smooth_union(GYROID, DIAMOND, width), fields.smooth_intersection(GYROID, DIAMOND, width)
    assert (union(POINTS)[far] == np.minimum(f, g)[far]).all()
    assert (common(POINTS)[far] == np.maximum(f, g)[far]).all()
    assert (union(POINTS)[~far] < np.minimum(f, g)[~far]).all()
    assert (common(POINTS)[~far] > np.maximum(f, g)[~far]).all()
    assert (np.minimum(f, g) - union(POINTS)).max() <= width / 6


def fraction_below(name: str, c: float, count: int = 300) -> float:
    """The volume fraction of {f <= c} for fields f = A cos(x - d) + B: exact along x, the midpoint rule in y and z."""
    y, z = np.meshgrid(*2 * [2 * np.pi * (np.arange(count) + 0.5) / count], indexing="ij")
    amplitude, rest = {
        "schwarz_p": (1.0, np.cos(y) + np.cos(z)),
        "gyroid": (np.hypot(np.cos(y), np.sin(z)), np.sin(y) * np.cos(z)),
        "diamond": (np.hypot(np.cos(y - z), np.sin(y + z)), 0.0),
    }[name]
    return float(1 - np.arccos(np.clip((c - rest) / amplitude, -1, 1)).mean() / np.pi)


@pytest.mark.parametrize(
    ("phi", "c"), [(GYROID, -0.6), (GYROID, 0.36), (DIAMOND, 0.1), (SCHWARZ_P, -1.2), (SCHWARZ_P, 0.7)]
)
def test_volume_fractions_are_those_of_half_exact_integration(phi: fields.Field, c: float) -> None:
    exact = fraction_below(phi.name, c)
    assert fields.volume_fraction(fields.pore(phi, c), samples=64) == pytest.approx(1 - exact, abs=3e-5)


@pytest.mark.slow
def test_a_threshold_is_as_accurate_as_stated() -> None:
    c = fields.threshold_for(GYROID, 0.3)
    assert fraction_below("gyroid", c, 1200) == pytest.approx(0.3, abs=FRACTION_ACCURACY)


@pytest.mark.slow
@pytest.mark.parametrize("fraction", [0.1, 0.35])
@pytest.mark.parametrize("phi", [GYROID, DIAMOND, SCHWARZ_P], ids=lambda phi: phi.name)
def test_thresholds_give_the_volume_fraction_asked_for(phi: fields.Field, fraction: float) -> None:
    c = fields.threshold_for(phi, fraction, samples=48)
    assert fraction_below(phi.name, c) == pytest.approx(fraction, abs=2e-4)
    c = fields.threshold_for(phi, fraction, "pore", samples=48)
    assert 1 - fraction_below(phi.name, c) == pytest.approx(fraction, abs=2e-4)
    low, high = fields.threshold_for(phi, fraction, "sheet", level=0.1, samples=48)
    assert (low + high) / 2 == pytest.approx(0.1)
    assert fraction_below(phi.name, high) - fraction_below(phi.name, low) == pytest.approx(fraction, abs=2e-4)


def test_volumes_of_bodies_need_a_box() -> None:
    ball = fields.sphere((0, 0, 0), 1.0)
    with pytest.raises(InvalidRequest, match="domain="):
        fields.volume_fraction(ball)
    box = ((-1.1, -1.2, -1.3), (1.1, 1.2, 1.3))
    found = fields.volume_fraction(ball, box, samples=64) * 2.2 * 2.4 * 2.6
    assert found == pytest.approx(4 / 3 * np.pi, rel=1e-4)
    plane = fields.halfspace((0, 0, 0.3), (1, 2, -0.5))
    assert fields.volume_fraction(plane, box, samples=8) == pytest.approx(
        (plane.on_grid(*(np.linspace(-b, b, 301)[1::2] for b in (1.1, 1.2, 1.3))) < 0).mean(), abs=2e-3
    )


@pytest.mark.parametrize("fraction", [0, 1, -0.1, 1.2, np.nan])
def test_fractions_must_be_fractions(fraction: float) -> None:
    with pytest.raises(InvalidRequest, match="between 0 and 1"):
        fields.threshold_for(GYROID, fraction)


def test_ramps_go_from_value_to_value() -> None:
    x = np.linspace(-1, 5, 121)
    points = np.stack([x, 0 * x + 1, 0 * x - 2], axis=-1)
    for smooth in (True, False):
        graded = fields.ramp("x", (0, 4), (0.2, 1.0), smooth=smooth)(points)
        assert (graded[x <= 0] == 0.2).all()
        assert (graded[x >= 4] == 1.0).all()
        assert (np.diff(graded) >= 0).all()
        assert graded[np.argmin(np.abs(x - 2))] == pytest.approx(0.6)
    np.testing.assert_allclose(fields.linear((1, -2, 3), 4)(points), x - 2 - 6 + 4)
    np.testing.assert_allclose(fields.coordinate((3, 0, 4), (0, 0, -2))(points), 0.6 * x)
    with pytest.raises(InvalidRequest, match="unknown; choose one of 'x', 'y', 'z'"):
        fields.ramp("w", (0, 1), (0, 1))


@pytest.mark.parametrize("kind", ["rod", "pore", "sheet"])
def test_a_constant_field_has_no_threshold_of_a_fraction(kind: str) -> None:
    with pytest.raises(InvalidRequest, match="2 everywhere in the domain"):
        fields.threshold_for(2.0, 0.3, kind, samples=8, domain=((0, 0, 0), (1, 1, 1)))


def test_what_is_constant_at_the_threshold_counts_once() -> None:
    stairs = fields.from_function(lambda p: np.floor(4 * p[:, 0]))
    cube = fields.box((0.25, 0.25, 0.25), (0.75, 0.75, 0.75))
    unit = ((0, 0, 0), (1, 1, 1))
    for part, exact in ((stairs - 1.0, 0.5), (fields.union(cube, 0.0), 1.0), (fields.intersection(cube, 0.0), 0.125)):
        assert fields.volume_fraction(part, unit, samples=16) == pytest.approx(exact, abs=1e-12)


@pytest.mark.parametrize("kind", ["rod", "pore", "sheet"])
def test_a_porosity_is_one_less_the_volume_fraction(kind: str) -> None:
    threshold = fields.threshold_for(GYROID, porosity=0.7, kind=kind)
    assert threshold == pytest.approx(fields.threshold_for(GYROID, 0.3, kind), rel=1e-12)
    make = {"rod": fields.rod, "pore": fields.pore, "sheet": fields.sheet}[kind]
    solid = make(GYROID, *threshold) if isinstance(threshold, tuple) else make(GYROID, threshold)
    points = np.random.default_rng(2).random((100_000, 3)) * (2.0, 3.0, 4.0)
    assert (solid(points) > 0).mean() == pytest.approx(0.7, abs=5e-3)


def test_a_threshold_for_both_or_none_of_fraction_and_porosity_is_refused() -> None:
    with pytest.raises(InvalidRequest, match="exactly one of `volume_fraction` and `porosity`; here: none of them"):
        fields.threshold_for(GYROID)
    with pytest.raises(InvalidRequest, match="exactly one of `volume_fraction` and `porosity`; here: both"):
        fields.threshold_for(GYROID, 0.3, porosity=0.7)
