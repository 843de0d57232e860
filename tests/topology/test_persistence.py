"""Persistence by union-find against gudhi's matrix reduction."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from scipy.ndimage import gaussian_filter

from tpmscad.errors import InvalidRequest
from tpmscad.topology import CONNECTIVITY, PersistencePairs, compute_pairs_at_level, compute_persistence, gudhi_complex

COMPLEXES = ("vertices", "top_cells")
DIMENSIONS = (0, 2)


def shapes(least: int = 1, most: int = 7) -> st.SearchStrategy[tuple[int, ...]]:
    return arrays.array_shapes(min_dims=3, max_dims=3, min_side=least, max_side=most)


@st.composite
def distinct(draw: st.DrawFn) -> np.ndarray:
    """Fields without ties: white, or smoothed along some axes."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    white = rng.normal(size=draw(shapes(most=9)))
    field = gaussian_filter(white, draw(st.tuples(*3 * [st.sampled_from((0, 0.7, 1.5))])))
    assume(len(np.unique(field)) == field.size)
    return field


@st.composite
def tied(draw: st.DrawFn) -> np.ndarray:
    """Fields of few values, zeros of both signs among them."""
    return draw(arrays.arrays(float, draw(shapes()), elements=st.sampled_from((-2.0, -1.0, -0.0, 0.0, 0.5, 3.0))))


def assert_same(found: PersistencePairs, expected: PersistencePairs, *, located: bool) -> None:
    np.testing.assert_array_equal(found.birth, expected.birth)
    np.testing.assert_array_equal(found.death, expected.death)
    if located:
        np.testing.assert_array_equal(found.birth_at, expected.birth_at)
        np.testing.assert_array_equal(found.death_at, expected.death_at)


@pytest.mark.parametrize("convention", COMPLEXES)
@pytest.mark.parametrize("dimension", DIMENSIONS)
@given(field=distinct())
@settings(max_examples=40)
def test_without_ties_values_and_voxels_are_gudhis(convention: str, dimension: int, field: np.ndarray) -> None:
    assert_same(
        compute_persistence(field, dimension, convention),
        gudhi_complex.gudhi_pairs(field, dimension, convention),
        located=True,
    )


@pytest.mark.parametrize("convention", COMPLEXES)
@pytest.mark.parametrize("dimension", DIMENSIONS)
@given(field=tied())
@example(field=np.ones((3, 4, 5)))
@settings(max_examples=40)
def test_with_ties_values_are_gudhis(convention: str, dimension: int, field: np.ndarray) -> None:
    assert_same(
        compute_persistence(field, dimension, convention),
        gudhi_complex.gudhi_pairs(field, dimension, convention),
        located=False,
    )


@pytest.mark.parametrize("convention", CONNECTIVITY)
@pytest.mark.parametrize("dimension", DIMENSIONS)
@given(field=st.one_of(distinct(), tied()), level=st.sampled_from((0.0, -0.3, 0.5, 9.0, -9.0)))
@settings(max_examples=40)
def test_the_pairs_at_a_level_are_those_alive_at_it(
    convention: str, dimension: int, field: np.ndarray, level: float
) -> None:
    assert_same(
        compute_pairs_at_level(field, dimension, convention, level),
        compute_persistence(field, dimension, convention).alive_at(level),
        located=True,
    )


@pytest.mark.parametrize("convention", CONNECTIVITY)
@pytest.mark.parametrize("dimension", DIMENSIONS)
@given(field=st.one_of(distinct(), tied()))
@settings(max_examples=20)
def test_voxels_have_the_values_of_their_pairs(convention: str, dimension: int, field: np.ndarray) -> None:
    pairs = compute_persistence(field, dimension, convention)
    flat = field.ravel()
    np.testing.assert_array_equal(flat[pairs.birth_at], pairs.birth)
    finite = np.isfinite(pairs.death)
    np.testing.assert_array_equal(flat[pairs.death_at[finite]], pairs.death[finite])
    assert (pairs.death_at[~finite] == -1).all()
    assert (pairs.birth < pairs.death).all()
    assert np.count_nonzero(~finite) == (1 if dimension == 0 else 0)


@pytest.mark.parametrize(("convention", "count"), [("vertices", 6), ("top_cells", 26), ("strict", 6)])
def test_two_wells_join_at_the_pass_between_them(convention: str, count: int) -> None:
    field = np.full((5, 4, 3), 9.0)
    field[0, 0, 0], field[1, 1, 0], field[1, 0, 0], field[4, 3, 2] = -3.0, -2.0, 1.0, -1.0
    pairs = compute_pairs_at_level(field, 0, convention)
    if count == 6:
        # the pass is (1, 0, 0)
        assert list(pairs.birth) == [-3, -2, -1]
        assert list(pairs.death) == [np.inf, 1, 9]
        assert np.unravel_index(pairs.death_at[1], field.shape) == (1, 0, 0)
    else:
        assert list(pairs.birth) == [-3, -1]


def test_a_cavity_closes_at_its_rim_and_fills_at_its_depth() -> None:
    field = np.full((5, 6, 7), -2.0)
    field[2, 3, 4], field[0, 3, 4], field[1, 3, 4] = 4.0, 5.0, -0.5
    for convention in CONNECTIVITY:
        pairs = compute_pairs_at_level(field, 2, convention)
        assert (pairs.birth[0], pairs.death[0], len(pairs)) == (-0.5, 4.0, 1)
        assert np.unravel_index(pairs.birth_at[0], field.shape) == (1, 3, 4)
        assert np.unravel_index(pairs.death_at[0], field.shape) == (2, 3, 4)


@pytest.mark.parametrize("level", [0.0, 0.25])
def test_a_wall_exactly_at_the_level_is_solid_and_still_joins_what_it_parts(level: float) -> None:
    field = np.full((5, 5, 7), -2.0)
    field[2, 2, 2], field[2, 2, 3], field[2, 2, 4] = 4.0, level, 3.0
    for convention in CONNECTIVITY:
        pairs = compute_pairs_at_level(field, 2, convention, level)
        assert list(zip(pairs.birth, pairs.death, strict=True)) == [(-2, 4), (level, 3)]
        assert compute_pairs_at_level(-field, 0, convention, -np.nextafter(level, 9)).birth[0] == -4


def test_arrays_of_any_memory_order_and_type_are_read() -> None:
    field = np.random.default_rng(0).integers(-9, 9, (6, 5, 4))
    expected = compute_persistence(field.astype(float), 0)
    for same in (
        np.asfortranarray(field),
        field.astype(np.float32),
        field.tolist(),
        np.repeat(field, 2, axis=2)[:, :, ::2],
    ):
        assert_same(compute_persistence(same, 0), expected, located=True)


@pytest.mark.parametrize(
    "wrong", [np.ones((3, 3)), np.ones((0, 3, 3)), np.full((2, 2, 2), np.nan), np.full((2, 2, 2), np.inf)]
)
@pytest.mark.parametrize("compute", [compute_persistence, compute_pairs_at_level, gudhi_complex.gudhi_pairs])
def test_samples_that_are_none_are_refused(compute: object, wrong: np.ndarray) -> None:
    with pytest.raises(InvalidRequest, match="samples"):
        compute(wrong, 0)


@pytest.mark.parametrize("compute", [compute_persistence, compute_pairs_at_level])
def test_other_dimensions_and_conventions_are_refused(compute: object) -> None:
    with pytest.raises(InvalidRequest, match="dimension 1"):
        compute(np.ones((2, 2, 2)), 1)
    with pytest.raises(InvalidRequest, match="choose one of 'vertices', 'top_cells', 'strict'"):
        compute(np.ones((2, 2, 2)), 0, "voxels")
    with pytest.raises(InvalidRequest, match="vertices or top_cells"):
        gudhi_complex.gudhi_pairs(np.ones((2, 2, 2)), 0, "strict")
