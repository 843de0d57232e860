"""Labels: the surface of a segmentation separates the centres of its voxels and is smooth."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt, gaussian_filter

from tpmscad import fields
from tpmscad.errors import InvalidRequest

RNG = np.random.default_rng(5)
FINE = 6
"""Samples of a voxel's edge."""


def blob(width: float) -> np.ndarray:
    return np.asarray(gaussian_filter(RNG.normal(size=(16, 18, 20)), width) > 0)


def one_voxel() -> np.ndarray:
    mask = np.zeros((9, 10, 11), bool)
    mask[4, 5, 6] = True
    return mask


def rod() -> np.ndarray:
    mask = np.zeros((9, 14, 11), bool)
    mask[4, 3:11, 6] = True
    return mask


def plate() -> np.ndarray:
    mask = np.zeros((14, 12, 11), bool)
    mask[:9, 2:10, 6] = True
    return mask


def slope() -> np.ndarray:
    i, j, k = np.indices((15, 14, 13))
    return np.asarray(i + 0.2 * j + 0.13 * k < 9)


MASKS = {
    "noise": blob(0.7),
    "blobs": blob(1.2),
    "large blobs": blob(2.5),
    "one voxel": one_voxel(),
    "rod": rod(),
    "plate": plate(),
    "slope": slope(),
}


@pytest.fixture(params=MASKS)
def mask(request: pytest.FixtureRequest) -> np.ndarray:
    return np.asarray(MASKS[request.param])


def test_the_field_has_the_sign_of_every_voxel_at_its_centre(mask: np.ndarray) -> None:
    field = fields.labels(np.where(mask, 3, 1), 0.5, (1.0, 2.0, 3.0), 3)
    centres = np.array([1.0, 2.0, 3.0]) + 0.5 * np.moveaxis(np.indices(mask.shape), 0, -1)
    np.testing.assert_array_equal(field(centres) < 0, mask)


def test_no_surface_lies_among_voxels_of_one_kind(mask: np.ndarray) -> None:
    """Between eight centres with one sign the spline, which may overshoot between its samples, keeps that sign."""
    field = fields.labels(mask)
    axes = [np.arange((n - 1) * FINE + 1) / FINE for n in mask.shape]
    solid = field.on_grid(*axes) < 0
    corners = np.stack(
        [
            mask[tuple(slice(a, n - 1 + a) for a, n in zip(at, mask.shape, strict=True))]
            for at in product((0, 1), repeat=3)
        ]
    )
    full, empty = corners.all(axis=0), ~corners.any(axis=0)
    for offset in product(range(FINE + 1), repeat=3):
        part = solid[tuple(slice(o, o + (n - 2) * FINE + 1, FINE) for o, n in zip(offset, mask.shape, strict=True))]
        assert not (part & empty).any()
        assert (part | ~full).all()


@pytest.mark.slow
def test_the_surface_lies_within_half_a_voxel_of_the_voxels_faces(mask: np.ndarray) -> None:
    field = fields.labels(mask)
    axes = [(np.arange(n * FINE) + 0.5) / FINE - 0.5 for n in mask.shape]
    solid = field.on_grid(*axes) < 0
    voxels = np.kron(mask, np.ones((FINE,) * 3)) > 0
    depth = np.where(
        voxels, distance_transform_edt(voxels), distance_transform_edt(~voxels)
    )  # to the nearest sample beyond
    assert ((depth[solid != voxels] - 0.5) / FINE).max(initial=0.0) <= 0.5


@pytest.mark.parametrize("radius", [1.5, 2.0, 4.0, 6.0])
def test_each_of_two_balls_side_by_side_has_the_volume_of_its_voxels(radius: float) -> None:
    """Interpolated numbers would lay label 2 round label 1; without the shift of the surface small balls miss 3 to 6 per cent."""
    spacing = np.array([1.0, 0.9, 1.1])
    count = np.ceil(np.array([4 * radius + 8, 2 * radius + 6, 2 * radius + 6]) / spacing).astype(int)
    places = (np.moveaxis(np.indices(count), 0, -1) + 0.5) * spacing
    organs = np.zeros(count, np.uint8)
    for number, x in ((1, radius + 3.1), (2, 3 * radius + 3.2)):
        organs[np.linalg.norm(places - (x, radius + 3.3, radius + 2.8), axis=-1) < radius] = number
    for number in (1, 2):
        field = fields.labels(organs, spacing, label=number)
        share = fields.volume_fraction(field, field.domain, samples=100)
        volume = share * np.prod(np.subtract(*field.domain[::-1]))
        assert volume == pytest.approx((organs == number).sum() * np.prod(spacing), rel=0.01)
        assert not any("% of that of the voxels" in note for note in field.notes)


def test_a_volume_that_cannot_be_kept_is_told() -> None:
    """A chequerboard of voxels: the surface would have to pass all centres by far less than they are apart."""
    (note,) = fields.labels(np.indices((6, 6, 6)).sum(axis=0) % 2 * (np.indices((6, 6, 6))[0] % 2)).notes
    assert "% of that of the voxels, some of which make parts too thin" in note


def test_a_slope_of_voxels_becomes_a_plane() -> None:
    """The voxels' centres lie up to half a voxel off it; the surface, away from the ends, a tenth."""
    i, j, k = np.indices((24, 24, 24))
    field = fields.labels(i + 0.31 * j + 0.17 * k < 16)
    y, z = RNG.uniform(7, 17, (2, 200))
    low, high = np.zeros(200), np.full(200, 23.0)
    for _ in range(40):
        middle = (low + high) / 2
        solid = field(np.stack([middle, y, z], axis=-1)) < 0
        low, high = np.where(solid, middle, low), np.where(solid, high, middle)
    off = (low + 0.31 * y + 0.17 * z) / np.linalg.norm((1, 0.31, 0.17))
    assert off.std() < 0.1


def test_a_label_at_the_end_of_the_array_is_solid_up_to_there() -> None:
    organs = np.zeros((9, 8, 7), int)
    organs[:, :4] = 1
    field = fields.labels(organs, 2.0)
    assert field.domain == ((-1, -1, -1), (17, 15, 13))
    assert (field([[-1.0, 2.0, 3.0], [17.0, -1.0, 13.0]]) < 0).all()
    assert (field([[-1.0, 10.0, 3.0], [17.0, 15.0, 13.0]]) > 0).all()
    y = np.linspace(-1, 15, 40)
    at_end, inside = (np.stack([np.full(40, x), y, np.full(40, z)], axis=-1) for x, z in ((-1.0, 13.0), (8.0, 6.0)))
    np.testing.assert_allclose(field(at_end), field(inside), atol=1e-12)


class TestSelection:
    ORGANS = np.repeat([0, 2, 5, 9], 3)[:, None, None] * np.ones((1, 5, 6), int)

    def test_several_labels_make_one_solid(self) -> None:
        both = fields.labels(self.ORGANS, label=[2, 5])
        np.testing.assert_array_equal(both(np.argwhere(self.ORGANS >= 0)) < 0, np.isin(self.ORGANS, (2, 5)).ravel())

    def test_all_labels_but_zero_are_told_with_the_way_to_take_one(self) -> None:
        field = fields.labels(self.ORGANS, label="all")
        np.testing.assert_array_equal(field(np.argwhere(self.ORGANS >= 0)) < 0, (self.ORGANS > 0).ravel())
        assert "labels 2, 5, 9 of 0, 2, 5, 9 as one solid; `label` takes one of them" in field.notes[0]

    def test_the_note_says_what_the_deviation_is_measured_from(self) -> None:
        assert (
            "label 5 of 0, 2, 5, 9; the deviation is that from its smoothed"
            in fields.labels(self.ORGANS, label=5).notes[0]
        )

    def test_whole_floating_point_numbers_may_be_labels_where_one_is_named(self) -> None:
        points = RNG.uniform(0, 5, (30, 3))
        found = fields.labels(self.ORGANS.astype(float), label=5)(points)
        np.testing.assert_array_equal(found, fields.labels(self.ORGANS, label=5)(points))

    @pytest.mark.parametrize(
        ("values", "label", "message"),
        [
            (ORGANS, 7, "holds no label 7: its values are 0, 2, 5, 9"),
            (ORGANS, [2, 7], "holds no label 7"),
            (ORGANS * 0, 0, "label 0 of 0 fills all of the array"),
            (ORGANS * 0, "all", "holds no label but 0"),
            (ORGANS, 1.5, "label 1.5 must be a whole number"),
            (ORGANS, "bone", "label 'bone' is unknown; choose one of 'all'"),
            (ORGANS + 0.25, 1, "holds 0.25: labels are whole numbers; `level` is for grey values"),
            (
                ORGANS * 1.0,
                "all",
                "floating-point numbers, which are grey values: it needs `level`.* from 0 to 9; Otsu",
            ),
            (ORGANS - 1000, "all", "integers of too many values, or below zero, which are grey values"),
        ],
    )
    def test_what_is_no_label_of_the_array_is_refused(self, values: np.ndarray, label: object, message: str) -> None:
        with pytest.raises(InvalidRequest, match=message):
            fields.labels(values, label=label)  # type: ignore[arg-type]


class TestLabelsAreNoNumbers:
    @pytest.mark.parametrize("dtype", [bool, np.uint8, np.int16, np.int64])
    def test_labels_are_not_interpolated(self, dtype: type) -> None:
        with pytest.raises(InvalidRequest, match=r"holds the labels 0, 1(, 2)?, which are no quantity to interpolate"):
            fields.sampled((np.indices((6, 6, 6))[0] // 2).astype(dtype), level=0.5)

    def test_grey_values_are_interpolated_whatever_their_type(self) -> None:
        scan = RNG.integers(-1000, 2000, (6, 7, 8))
        points = RNG.uniform(0, 5, (30, 3))
        for values in (scan.astype(np.int16), scan - scan.min()):  # with negative values, or with very many
            field = fields.sampled(values, level=300)
            np.testing.assert_allclose(field(points), fields.sampled(values.astype(float), level=300)(points))
            assert "are taken as grey values" in field.notes[0]

    def test_whole_floating_point_numbers_are_numbers_and_told(self) -> None:
        phases = (np.indices((6, 6, 6))[0] // 2).astype(float)
        assert "the whole numbers 0, 1, 2 are taken as grey values" in fields.sampled(phases, level=0.5).notes[0]
        assert not any("whole" in note for note in fields.sampled(np.minimum(phases, 1), level=0.5).notes)
