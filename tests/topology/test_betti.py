"""Components, cavities and Betti numbers of sampled solids."""

from __future__ import annotations

import gudhi
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from tpmscad.errors import InvalidRequest
from tpmscad.topology import (
    Betti,
    betti,
    bound_component_counts,
    count_components_and_cavities,
    euler_characteristic,
)
from tpmscad.topology.components import EXTERIOR, find_deepest_samples, label_phase

AXES = np.linspace(-1.5, 1.5, 41), np.linspace(-1.4, 1.4, 37), np.linspace(-1.3, 1.3, 33)
X, Y, Z = np.meshgrid(*AXES, indexing="ij")


def torus(x: np.ndarray, y: np.ndarray, z: np.ndarray, ring: float = 0.7, tube: float = 0.22) -> np.ndarray:
    return np.hypot(np.hypot(x, y) - ring, z) - tube


def shell(f: np.ndarray, wall: float) -> np.ndarray:
    return np.abs(f) - wall


SOLIDS = {
    "ball": (np.sqrt(X**2 + Y**2 + Z**2) - 1, Betti(1, 0, 0)),
    "hollow shell": (shell(np.sqrt(X**2 + Y**2 + Z**2) - 0.9, 0.2), Betti(1, 0, 1)),
    "ball in a shell": (shell(np.sqrt(X**2 + Y**2 + Z**2) - 0.7, 0.45), Betti(1, 0, 1)),
    "torus": (torus(X, Y, Z), Betti(1, 1, 0)),
    "hollow torus": (shell(torus(X, Y, Z, 0.75, 0.35), 0.12), Betti(1, 2, 1)),
    "linked rings": (np.minimum(torus(X + 0.35, Y, Z, 0.65, 0.18), torus(X - 0.35, Z, Y, 0.65, 0.18)), Betti(2, 2, 0)),
    "two balls": (np.sqrt((np.abs(X) - 0.7) ** 2 + Y**2 + Z**2) - 0.4, Betti(2, 0, 0)),
    "everything": (-1 + 0 * X, Betti(1, 0, 0)),
    "nothing": (1 + 0 * X, Betti(0, 0, 0)),
    "outside of a ball": (1 - np.sqrt(X**2 + Y**2 + Z**2), Betti(1, 0, 1)),
    "outside of a torus": (-torus(X, Y, Z), Betti(1, 1, 1)),
}


@pytest.mark.parametrize("convention", ["vertices", "top_cells"])
@pytest.mark.parametrize("name", SOLIDS)
def test_solids_of_the_textbook_have_their_betti_numbers(name: str, convention: str) -> None:
    values, expected = SOLIDS[name]
    assert betti(values, convention=convention) == expected
    assert euler_characteristic(values, convention=convention) == expected.euler


@pytest.mark.parametrize("name", SOLIDS)
def test_well_sampled_solids_are_certified(name: str) -> None:
    values, expected = SOLIDS[name]
    assert count_components_and_cavities(values) == (expected.b0, expected.b2)
    assert bound_component_counts(values) == ((expected.b0, expected.b0), (expected.b2, expected.b2))


fields_of_noise = st.builds(
    lambda seed, shape, sigma: ndimage.gaussian_filter(np.random.default_rng(seed).normal(size=shape), sigma),
    st.integers(0, 2**32 - 1),
    st.tuples(*3 * [st.integers(1, 9)]),
    st.sampled_from((0.0, 0.6)),
)


@pytest.mark.parametrize("convention", ["vertices", "top_cells"])
@given(field=fields_of_noise, level=st.sampled_from((-0.2, 0.0, 0.1)))
@settings(max_examples=60)
def test_betti_numbers_of_noise_are_gudhis(convention: str, field: np.ndarray, level: float) -> None:
    built = {"vertices": field} if convention == "vertices" else {"top_dimensional_cells": field}
    brep = gudhi.CubicalComplex(**built)
    brep.compute_persistence()
    expected = [*brep.persistent_betti_numbers(level, level), 0, 0, 0][:3]
    found = betti(field, level, convention)
    assert [found.b0, found.b1, found.b2] == expected


@pytest.mark.parametrize("convention", ["vertices", "top_cells", "strict"])
@given(field=fields_of_noise, level=st.sampled_from((-0.2, 0.0, 0.1)))
@settings(max_examples=60)
def test_pieces_are_those_of_a_labelling(convention: str, field: np.ndarray, level: float) -> None:
    solid, void = {"vertices": (1, 3), "top_cells": (3, 1), "strict": (1, 1)}[convention]
    labels, count = ndimage.label(field <= level, ndimage.generate_binary_structure(3, solid))
    found, n_found = label_phase(field, level, convention, solid=True)
    np.testing.assert_array_equal(found, labels)
    assert n_found == count
    lowest = ndimage.minimum(field, labels, np.arange(1, count + 1)) if count else []
    np.testing.assert_array_equal(field.ravel()[find_deepest_samples(field, found, count, 1)], lowest)

    around = np.pad(field > level, 1, constant_values=True)
    labels, count = ndimage.label(around, ndimage.generate_binary_structure(3, void))
    inner = labels[1:-1, 1:-1, 1:-1]
    holes = inner * (inner != labels[0, 0, 0])
    found, n_found = label_phase(field, level, convention, solid=False)
    assert n_found == count
    np.testing.assert_array_equal(found == EXTERIOR, inner == labels[0, 0, 0])
    assert len(set(zip(found.ravel(), inner.ravel(), strict=True))) == len(np.unique(found))
    deepest = find_deepest_samples(field, found, n_found, -1)
    for label in range(EXTERIOR + 1, n_found + 1):
        assert found.ravel()[deepest[label - 1]] == label
        assert field.ravel()[deepest[label - 1]] == field[found == label].max()
    assert n_found - 1 == len(np.unique(holes[holes > 0]))


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=15)
def test_the_trilinear_interpolant_is_between_the_certified_numbers(seed: int) -> None:
    """Counted on the interpolant sampled five times finer, where strict and lenient counts agree."""
    values = ndimage.gaussian_filter(np.random.default_rng(seed).normal(size=(7, 6, 5)), 0.5)
    fine = ndimage.zoom(values, [(5 * (n - 1) + 1) / n for n in values.shape], order=1, grid_mode=False)
    (least_parts, most_parts), (least_holes, most_holes) = bound_component_counts(values)
    (fewest, parts), (few, holes) = bound_component_counts(fine)
    assert least_parts <= parts
    assert fewest <= most_parts
    assert least_holes <= holes
    assert few <= most_holes


def test_loops_have_no_convention_without_a_complex() -> None:
    with pytest.raises(InvalidRequest, match="vertices or top_cells"):
        betti(X, convention="strict")
