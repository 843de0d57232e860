"""Volume fractions against quadrature through the wall, and back to the thickness."""

from __future__ import annotations

import itertools

import mpmath as mp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tpmscad import surfaces
from tpmscad.errors import InvalidRequest

EXACT = [info.name for info in surfaces.CATALOGUE.values() if info.primitives == "exact"]
BOTH = list(itertools.product(EXACT, ("minimal", "nodal")))


def gauss(n: int) -> tuple[np.ndarray, np.ndarray]:
    x, w = np.polynomial.legendre.leggauss(n)
    return (x + 1) / 2, w / 2


def offset_area(name: str, reference: str, offset: float) -> float:
    """Area of the offset surface in a cell, from the first derivatives of its own jet."""
    x, w = gauss(30)
    jet = surfaces.primitive_patch(name, reference).jet(x[:, None], x, offset)
    return surfaces.CATALOGUE[name].patches_per_cell * w @ np.linalg.norm(np.cross(jet.du, jet.dv), axis=-1) @ w


@pytest.mark.parametrize(("name", "reference"), BOTH)
def test_a_sheet_is_the_areas_of_its_offsets_piled_up(name: str, reference: str) -> None:
    lower, upper = -0.08, 0.14
    s, w = gauss(4)
    piled = (upper - lower) * w @ [offset_area(name, reference, d) for d in lower + (upper - lower) * s]
    assert surfaces.volume_fraction(name, reference, lower, upper) == pytest.approx(piled, rel=1e-12)
    assert surfaces.area(name, reference) == pytest.approx(offset_area(name, reference, 0.0), rel=1e-13)


@pytest.mark.parametrize(
    ("name", "raw_cell", "expected"),
    # Sheets of offset 0.2 raw, by OCCT's volume of fitted solids.
    [
        ("gyroid", 2.656243496748273, 0.451233),
        ("diamond", 3.3715007096251908, 0.441330),
        ("schwarz_p", 2.1565156474996432, 0.421615),
    ],
)
def test_sheets_have_the_volume_of_solids_built_of_them(name: str, raw_cell: float, expected: float) -> None:
    d = 0.2 / raw_cell
    assert surfaces.volume_fraction(name, "minimal", -d, d) == pytest.approx(expected, abs=2e-6)


def test_the_minimal_surfaces_have_their_known_areas() -> None:
    """3 (K^2 + K'^2) / (2 K K'), 3 K' / K and 3 K / K', in cells squared: 3.0914, 3.8378, 2.3451 (K by Gauss's mean)."""
    k, k1 = (np.pi / 2 / float(mp.agm(1, mp.sqrt(1 - m))) for m in (mp.mpf(1) / 4, mp.mpf(3) / 4))
    closed = {"gyroid": 1.5 * (k / k1 + k1 / k), "diamond": 3 * k1 / k, "schwarz_p": 3 * k / k1}
    for name, known in (("gyroid", 3.0914), ("diamond", 3.8378), ("schwarz_p", 2.3451)):
        assert surfaces.area(name) == pytest.approx(closed[name], rel=1e-14)
        assert surfaces.area(name) == pytest.approx(known, abs=5e-5)


@pytest.mark.parametrize(("name", "reference"), BOTH)
def test_the_mid_surface_halves_the_cell_and_offsets_trade_volume(name: str, reference: str) -> None:
    assert surfaces.skeletal_volume_fraction(name, reference) == 0.5
    low, high = (
        surfaces.skeletal_volume_fraction(name, reference, -0.1),
        surfaces.skeletal_volume_fraction(name, reference, 0.1),
    )
    assert high - low == pytest.approx(surfaces.volume_fraction(name, reference, -0.1, 0.1), rel=1e-14)
    for offset in (-0.1, 0.07):
        sides = (surfaces.skeletal_volume_fraction(name, reference, offset, side) for side in "-+")
        assert sum(sides) == pytest.approx(1, rel=1e-15)


@settings(max_examples=30, deadline=None, derandomize=True)
@given(pair=st.sampled_from(BOTH), share=st.floats(1e-6, 0.999), cell=st.floats(0.1, 100))
def test_the_offsets_for_a_volume_fraction_make_it(pair: tuple[str, str], share: float, cell: float) -> None:
    limit = surfaces.primitive_patch(*pair).max_offset * (1 - 1e-9)
    fraction = share * min(1.0, surfaces.volume_fraction(*pair, -limit, limit))
    lower, upper = surfaces.offsets_for(*pair, fraction, "sheet", cell)
    assert upper == -lower
    assert surfaces.volume_fraction(*pair, lower / cell, upper / cell) == pytest.approx(fraction, rel=1e-11)
    assert surfaces.thickness_for(*pair, fraction) == pytest.approx(2 * upper / cell, rel=1e-14)
    skeletal = 0.5 + (share - 0.5) * surfaces.volume_fraction(*pair, -limit, limit)
    for side in "-+":
        offset, same = surfaces.offsets_for(*pair, skeletal, "skeletal", cell, side)
        assert offset == same
        assert surfaces.skeletal_volume_fraction(*pair, offset / cell, side) == pytest.approx(skeletal, rel=1e-11)


@pytest.mark.parametrize(("name", "reference"), BOTH)
def test_a_volume_fraction_out_of_reach_is_refused_with_the_reach(name: str, reference: str) -> None:
    limit = surfaces.primitive_patch(name, reference).max_offset
    most = surfaces.volume_fraction(name, reference, -limit * (1 - 1e-9), limit * (1 - 1e-9))
    with pytest.raises(InvalidRequest, match=rf"is out of reach.*{limit:.6g}.* between 0 and {most:.6g}"):
        surfaces.thickness_for(name, reference, most + 1e-6)
    for fraction in (0.0, -0.1, 1.0, np.nan):
        with pytest.raises(InvalidRequest, match="a number between 0 and 1"):
            surfaces.thickness_for(name, reference, fraction)
    for fraction in (0.5 + most / 2 + 1e-6, 0.5 - most / 2 - 1e-6):
        with pytest.raises(InvalidRequest, match="out of reach"):
            surfaces.skeletal_offset_for(name, reference, fraction)


def test_offsets_out_of_order_or_past_the_limit_and_unknown_words_are_refused() -> None:
    with pytest.raises(InvalidRequest, match=r"lower offset 0\.1 is not below the upper 0\.1"):
        surfaces.volume_fraction("gyroid", "minimal", 0.1, 0.1)
    with pytest.raises(InvalidRequest, match="curvature radius"):
        surfaces.volume_fraction("gyroid", "minimal", 0.0, 0.2)
    with pytest.raises(InvalidRequest, match="side 'up'"):
        surfaces.skeletal_volume_fraction("gyroid", "minimal", 0.0, "up")
    with pytest.raises(InvalidRequest, match="kind 'rod'"):
        surfaces.offsets_for("gyroid", "minimal", 0.3, "rod", 1.0)
