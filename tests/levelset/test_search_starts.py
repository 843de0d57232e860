"""Where the search for an octree starts, and when it is given up."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from tpmscad import fields
from tpmscad.brep import connectivity
from tpmscad.errors import LevelSetError
from tpmscad.levelset import adaptive_search
from tpmscad.levelset.boundary_level_sets import find_narrow_places, sample_level_set, sample_narrow_places
from tpmscad.levelset.field_solid import find_sample_spacing, fit_field_solid
from tpmscad.levelset.level_set_fit import FitRequest
from tpmscad.parallel import run_serial

LO, HI = np.zeros(3), np.full(3, 2.0)
BALL = fields.sphere((1.0, 1.1, 0.9), 0.7)


@pytest.mark.parametrize("radius", [0.2, 0.08])
def test_a_pore_between_the_corners_of_the_first_leaves_is_fitted(radius: float) -> None:
    pore = fields.sphere((1.22, 1.13, 1.07), radius)
    found = fit_field_solid(fields.difference(BALL, pore), LO, HI, 2e-2)
    assert connectivity.label_shells(found.brep)[0] == 2
    distance = np.linalg.norm(found.brep.vertices - [1.22, 1.13, 1.07], axis=1)
    assert np.abs(distance[distance < 0.5 * (radius + 0.36)] - radius).max() < 1e-9 + 1e-6 * radius


def test_a_surface_that_no_leaf_shows_is_refused_with_its_place(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(adaptive_search, "_split_until_found", lambda *_: None)
    with pytest.raises(LevelSetError, match=r"the surface at \(.*\) is too small to be fitted"):
        fit_field_solid(BALL, LO, HI, 2e-2)


@pytest.mark.parametrize("radius", [0.02, 0.01, 1e-3])
@pytest.mark.parametrize("formula", ["sqrt({0}) - {1}", "{0} - {1}^2"], ids=["distance", "square"])
def test_narrow_places_that_samples_missed_are_sampled(formula: str, radius: float) -> None:
    centre = np.array([1.0563, 0.8428, 1.0769])
    square = "((x - 1.0563)^2 + (y - 0.8428)^2 + (z - 1.0769)^2)"
    speck = fields.expression(formula.format(square, radius))
    found = sample_narrow_places(speck, LO, HI, np.empty((0, 3)), find_narrow_places(speck, LO, HI))
    assert len(found) > 3
    np.testing.assert_allclose(np.linalg.norm(found - centre, axis=1), radius, rtol=1e-3)


def test_a_speck_of_one_voxel_of_a_long_image_is_sampled() -> None:
    values = np.full((90, 7, 6), -1.0)
    values[57, 3, 2] = 0.02  # half-way between the 40 lines that suffice for a formula
    image = fields.sampled(values, spacing=(1.0, 1.003, 1.002), level=0.0)
    lo, hi = (np.array(corner) for corner in image.domain)
    found = sample_level_set(image, lo, hi, find_sample_spacing(image, lo, hi))
    assert len(found) > 0
    assert np.linalg.norm(found - lo - np.array([57.0, 3.009, 2.004]), axis=1).max() < 1.0


def test_the_samples_of_a_large_image_are_bounded() -> None:
    image = fields.sampled(np.linspace(-1.0, 1.0, 600)[:, None, None] * np.ones((1, 4, 4)), level=0.0)
    lo, hi = (np.array(corner) for corner in image.domain)
    assert find_sample_spacing(image, lo, hi) == pytest.approx(599 / 256)


@pytest.mark.slow
@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_rounded_edges_of_a_flat_wedge_are_fitted() -> None:
    """Leaves as flat as the box are split without end along its edges, which are rounded with a hundredth of its width."""
    planes = ("z - 0.1 * (0.5 - x)", "-z - 0.1 * (0.5 - x)", "y - 1", "-y - 1", "-x - 0.4")
    wedge = fields.expression(f"0.01 * log({' + '.join(f'exp(({plane}) / 0.01)' for plane in planes)})")
    found = fit_field_solid(wedge, np.array([-0.55, -1.05, -0.1]), np.array([0.55, 1.05, 0.1]), 1e-3)
    assert found.deviation.max <= 1e-3
    assert len(found.brep.faces) < 4000


def test_narrow_places_of_a_plate_are_sampled_as_coarsely_as_its_length_allows() -> None:
    ball = fields.sphere((1.0, 1.0, 0.0), 0.5)
    thin = np.array([2.0, 2.0, 1e-4])
    found = sample_narrow_places(ball, LO, thin, np.empty((0, 3)), find_narrow_places(ball, LO, thin))
    assert 100 < len(found) < 10_000


def test_a_surface_that_samples_show_has_no_narrow_places() -> None:
    known = sample_level_set(BALL, LO, HI, 0.05)
    assert not len(sample_narrow_places(BALL, LO, HI, known, find_narrow_places(BALL, LO, HI)))


@pytest.mark.parametrize("size", [1.0, 1e-2, 1e-5])
@pytest.mark.parametrize("field", [BALL, fields.tpms("gyroid", 2.0)], ids=["ball", "periodic"])
def test_first_octrees_are_bounded(field: fields.Field, size: float) -> None:
    counts = adaptive_search._count_leaves(field, LO, HI, size)
    assert np.prod(counts) <= adaptive_search.MAX_FIRST_LEAVES
    assert np.prod(counts) >= min((2.0 / size) ** 3, 0.5 * adaptive_search.MAX_FIRST_LEAVES)


@pytest.mark.parametrize(
    ("bad_fraction", "n_patches", "expected"), [(0.2, 12_000, 2), (0.2, 500, 7), (0.001, 12_000, 7)]
)
def test_a_search_is_given_up_after_hopeless_starts_with_many_patches(
    bad_fraction: float, n_patches: int, expected: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    tried = []

    def fail(_: FitRequest, start: object) -> object:
        tried.append(start)
        network = SimpleNamespace(curve=np.zeros((n_patches, 4)))
        return SimpleNamespace(bad_leaves=np.arange(3), bad_volume=1.0, bad_fraction=bad_fraction, network=network)

    monkeypatch.setattr(adaptive_search, "_generate_starts", lambda *_: iter(range(7)))
    monkeypatch.setattr(adaptive_search, "_refine_from", fail)
    monkeypatch.setattr(adaptive_search, "_explain_failure", lambda _: "3 places could not be fitted")
    with pytest.raises(LevelSetError, match="3 places"):
        adaptive_search.fit_level_set_adaptively(FitRequest(BALL, 1e-2, np.ones((1, 3)), run_serial), LO, HI)
    assert len(tried) == expected
