"""Regions of several labels divide space: no gaps, no overlaps, every voxel's centre in its own."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from tpmscad import fields
from tpmscad.errors import InvalidRequest

RNG = np.random.default_rng(23)
SPACING, FIRST = np.array([0.5, 0.7, 0.6]), np.array([1.0, -2.0, 3.0])


def organs(with_background: bool) -> np.ndarray:
    """Labels 2, 5 and 7 in blobs of some voxels, with a background round them or without."""
    ways = gaussian_filter(RNG.normal(size=(3, 14, 13, 12)), (0, 1.5, 1.5, 1.5))
    values = np.array([2, 5, 7])[ways.argmax(axis=0)]
    if with_background:
        values[np.linalg.norm(np.moveaxis(np.indices(values.shape), 0, -1) - 6, axis=-1) > 5.5] = 0
    return values


@pytest.mark.parametrize(
    ("with_background", "label"), [(True, "all"), (False, "all"), (True, (7, 2)), (True, (5, 2, 7))]
)
def test_every_point_of_the_labels_belongs_to_one_region(with_background: bool, label: str | tuple[int, ...]) -> None:
    values = organs(with_background)
    wanted = [2, 5, 7] if label == "all" else list(label)
    parts = fields.label_partition(values, SPACING, FIRST, label)
    assert list(parts.regions) == wanted
    assert parts.domain[0] == pytest.approx(FIRST - SPACING / 2)
    points = RNG.uniform(*parts.domain, (4000, 3))
    count = sum((field(points) < 0).astype(int) for field in parts.regions.values())
    together = np.ones(4000, bool)
    if not np.isin(values, wanted).all():
        together = fields.labels(values, SPACING, FIRST, wanted)(points) < 0
    np.testing.assert_array_equal(count, together)


@pytest.mark.parametrize("with_background", [True, False])
def test_every_voxel_has_its_centre_in_its_own_region(with_background: bool) -> None:
    values = organs(with_background)
    parts = fields.label_partition(values, SPACING, FIRST)
    centres = np.moveaxis(np.indices(values.shape), 0, -1) * SPACING + FIRST
    for number, field in parts.regions.items():
        np.testing.assert_array_equal(field(centres) < 0, values == number)


@pytest.mark.parametrize(
    ("label", "message"), [((2,), "label 2 is one label: .* fields.labels is for one"), ((2, 3), "holds no label 3")]
)
def test_one_label_or_an_absent_one_is_refused(label: tuple[int, ...], message: str) -> None:
    with pytest.raises(InvalidRequest, match=message):
        fields.label_partition(organs(True), label=label)


@pytest.mark.kernel
def test_the_solids_of_two_labels_have_the_same_faces_where_they_touch() -> None:
    """Two halves of an ellipsoid, divided by a slope."""
    import tpmscad

    places = np.moveaxis(np.indices((10, 8, 8)), 0, -1)
    inside = np.linalg.norm((places - (4.6, 3.7, 3.4)) / (3.6, 2.9, 2.7), axis=-1) < 1
    values = np.where(inside, np.where(places[..., 0] + 0.4 * places[..., 1] > 6.2, 2, 1), 0)
    parts = fields.label_partition(values)
    faces, volumes = [], []
    for number, field in parts.regions.items():
        model = tpmscad.solidify(field, parts.domain, tol=0.2)
        assert model.certificate.met
        assert model.volume == pytest.approx((values == number).sum(), rel=0.02)
        volumes.append(model.volume)
        faces.append([(np.array(tuple(face.center())), face.area) for face in model.solid.faces()])
    common = [
        area
        for (place, area), (other, its_area) in product(*faces)
        if np.abs(place - other).max() < 0.01 and abs(area - its_area) < 1e-6 * area
    ]
    # the kernel's centre of a trimmed face depends on the bounds of its parameters
    halfway = np.pi * 2.9 * 2.7 * 1.02  # of the ellipsoid's section by the slope
    assert sum(common) == pytest.approx(halfway, rel=0.2)
    assert sum(volumes) == pytest.approx(inside.sum(), rel=0.005)
