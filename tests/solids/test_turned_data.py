"""Data end where their samples end, wherever they are moved: oblique images, rotations, and other fields beside them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import build123d as bd
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import tpmscad
from tpmscad import fields
from tpmscad.errors import InvalidRequest
from tpmscad.fields.data.field_notes import find_least_spacing
from tpmscad.fields.kinds.data_domains import list_bounded, settle_data

pytestmark = pytest.mark.kernel
RNG = np.random.default_rng(5)

COUNTS, STEP = (14, 12, 10), np.array([1.0, 1.1, 1.2])
MIDDLE = STEP * (np.array(COUNTS) - 1) / 2
AXES = {"within": np.array([4.0, 3.5, 3.0]), "cut": np.array([10.0, 9.0, 4.0])}
"""Half axes of an ellipsoid in the middle of the samples: within their box, and cut by all of its sides but those of z, and by
the edges between them."""


TURN, FIRST = Rotation.from_euler("XYZ", (12.0, 20.0, 35.0), degrees=True).as_matrix(), np.array([3.0, -7.0, 11.0])
AFFINE = np.eye(4)
AFFINE[:3, :3], AFFINE[:3, 3] = TURN * STEP, FIRST
TO_LPS = np.diag([-1.0, -1.0, 1.0, 1.0])


def sample(name: str) -> np.ndarray:
    """The distance from the ellipsoid, about: positive within, so that the level is 0."""
    points = np.moveaxis(np.indices(COUNTS), 0, -1) * STEP - MIDDLE
    return (3.0 * (1.0 - np.linalg.norm(points / AXES[name], axis=-1))).astype(np.float32)


def is_within(name: str, points: np.ndarray) -> np.ndarray:
    """By the formula, at points (n, 3) of the patient: in the ellipsoid and in the turned box of the samples."""
    own = (points - FIRST) @ TURN
    in_box = ((own >= 0) & (own <= 2 * MIDDLE)).all(axis=-1)
    return in_box & (np.linalg.norm((own - MIDDLE) / AXES[name], axis=-1) < 1)


def integrate_cut() -> float:
    """Volume of the ellipsoid that the box cuts, by the section areas of planes."""
    steps = [(np.arange(600) + 0.5) / 600 * 2 * m - m for m in MIDDLE]
    x, y = np.meshgrid(*steps[:2], indexing="ij")
    rest = np.clip(1 - (x / AXES["cut"][0]) ** 2 - (y / AXES["cut"][1]) ** 2, 0, None)
    height = 2 * np.minimum(AXES["cut"][2] * np.sqrt(rest), MIDDLE[2])
    return float(height.mean() * 4 * MIDDLE[0] * MIDDLE[1])


def write_nifti(path: Path, values: np.ndarray) -> Path:
    nibabel = pytest.importorskip("nibabel")
    nibabel.save(nibabel.Nifti1Image(values, AFFINE), path / "a.nii")
    return path / "a.nii"


def write_nrrd(path: Path, values: np.ndarray) -> Path:
    """In LPS, the second axis stored backwards."""
    nrrd = pytest.importorskip("nrrd")
    flip = np.diag([1.0, -1.0, 1.0, 1.0])
    flip[1, 3] = COUNTS[1] - 1
    affine = TO_LPS @ AFFINE @ flip
    stated = {"space": "left-posterior-superior", "space directions": affine[:3, :3].T, "space origin": affine[:3, 3]}
    nrrd.write(str(path / "a.nrrd"), values[:, ::-1], stated)
    return path / "a.nrrd"


def write_mha(path: Path, values: np.ndarray) -> Path:
    """The axes stored in the order z, x, y."""
    sitk = pytest.importorskip("SimpleITK")
    image = sitk.GetImageFromArray(np.transpose(np.transpose(values, (2, 0, 1))))
    image.SetSpacing(STEP[[2, 0, 1]].tolist())
    image.SetDirection((TO_LPS[:3, :3] @ TURN)[:, [2, 0, 1]].ravel().tolist())
    image.SetOrigin((TO_LPS[:3, :3] @ FIRST).tolist())
    sitk.WriteImage(image, str(path / "a.mha"))
    return path / "a.mha"


def write_dicom(path: Path, values: np.ndarray) -> Path:
    """Slices of whole numbers, a thousandth each."""
    pydicom = pytest.importorskip("pydicom")
    (path / "slices").mkdir()
    axes = TO_LPS[:3, :3] @ TURN
    for k in range(COUNTS[2]):
        data = pydicom.Dataset()
        data.file_meta = pydicom.dataset.FileMetaDataset()
        data.file_meta.TransferSyntaxUID = pydicom.uid.ExplicitVRLittleEndian
        data.SOPClassUID = data.file_meta.MediaStorageSOPClassUID = pydicom.uid.CTImageStorage
        data.SOPInstanceUID = data.file_meta.MediaStorageSOPInstanceUID = f"1.2.3.{k + 1}"
        data.Modality, data.SeriesInstanceUID, data.StudyInstanceUID, data.InstanceNumber = "CT", "1.2.3", "1.2", k + 1
        data.ImageOrientationPatient = [f"{c:.12g}" for c in axes[:, :2].T.ravel()]
        data.ImagePositionPatient = [f"{c:.12g}" for c in TO_LPS[:3, :3] @ FIRST + axes[:, 2] * STEP[2] * k]
        data.PixelSpacing, data.SliceThickness = [str(STEP[1]), str(STEP[0])], str(STEP[2])
        data.Rows, data.Columns = COUNTS[1], COUNTS[0]
        data.SamplesPerPixel, data.PhotometricInterpretation = 1, "MONOCHROME2"
        data.BitsAllocated = data.BitsStored = 16
        data.HighBit, data.PixelRepresentation, data.RescaleSlope, data.RescaleIntercept = 15, 1, "0.001", "0"
        data.PixelData = np.rint(1000 * values[:, :, k].T).astype("<i2").tobytes()
        data.save_as(path / "slices" / f"{k}.dcm", enforce_file_format=True)
    return path / "slices"


WRITERS: dict[str, Callable[[Path, np.ndarray], Path]] = {
    "NIfTI": write_nifti,
    "NRRD": write_nrrd,
    "MHA": write_mha,
    "DICOM": write_dicom,
}


@pytest.mark.parametrize("format", WRITERS)
@pytest.mark.parametrize("name", AXES)
def test_an_oblique_image_is_read_as_it_lies(format: str, name: str, tmp_path: Path) -> None:
    field = fields.sampled(WRITERS[format](tmp_path, sample(name)), level=0.0)
    moved = fields.sampled(sample(name), tuple(STEP), level=0.0)
    low, high = np.array(field.domain)
    points = RNG.uniform(low - 3, high + 3, (40_000, 3))
    assert (field(points) < 0).sum() > 400
    sure = np.abs(field(points)) > 0.02
    assert ((field(points) < 0) == is_within(name, points))[sure].all()
    own = (points - FIRST) @ TURN
    inside = ((own > 0.1) & (own < 2 * MIDDLE - 0.1)).all(axis=1)
    np.testing.assert_allclose(field(points[inside]), moved(own[inside]), atol=2e-3)
    corners = FIRST + np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)]) * 2 * MIDDLE @ TURN.T
    np.testing.assert_allclose(field.domain, [corners.min(axis=0), corners.max(axis=0)], atol=1e-4)
    assert any("turned by up to" in note and "not resampled" in note for note in field.notes)


def test_the_solid_of_an_oblique_image_ends_with_its_data(tmp_path: Path) -> None:
    field = fields.sampled(write_nifti(tmp_path, sample("cut")), level=0.0)
    model = tpmscad.solidify(field, field.domain, tol=0.3)
    assert model.certificate.met
    assert model.volume == pytest.approx(integrate_cut(), rel=0.02)
    np.testing.assert_allclose(tuple(model.solid.center()), FIRST + TURN @ MIDDLE, atol=0.05)
    assert len(model.solid.faces().filter_by(lambda face: face.geom_type.name == "PLANE")) == 4


CUT = fields.sampled(sample("cut"), tuple(STEP), level=0.0)
BALL = fields.sphere((20.0, 5.0, 5.0), 3.0)
MOVES: dict[str, Callable[[Any], Any]] = {
    "translate": lambda f: fields.translate(f, (3, -2, 1)),
    "rotate": lambda f: fields.rotate(f, (1, 2, 3), 40),
    "rotate twice": lambda f: fields.rotate(fields.rotate(f, "x", 25, (1, 2, 3)), "z", 45),
    "scale": lambda f: fields.scale(f, 1.5, (1, 0, 0)),
    "quarter turn": lambda f: fields.rotate(f, "z", 90),
    "union": lambda f: fields.rotate(fields.union(f, BALL), "y", 30),
    "difference": lambda f: fields.translate(fields.difference(fields.box((-9, -9, -9), (30, 30, 30)), f), (1, 2, 3)),
    "intersection": lambda f: fields.rotate(f & fields.sphere(MIDDLE, 6.0), "z", 20),
    "complement": lambda f: fields.rotate(~f, "z", 20) & fields.sphere((0, 0, 0), 30.0),
    "constant": lambda f: fields.rotate(f - 0.1, "z", 20),
    "warp": lambda f: fields.warp(f, lambda p: p + 0.2 * np.sin(p[:, [1, 2, 0]])),
}
"""Each of a field of data and of the same data that are void beyond their box by a function."""


@pytest.mark.parametrize("name", MOVES)
def test_data_that_are_moved_or_combined_are_empty_beyond_their_samples(name: str) -> None:
    def end_with_data(points: np.ndarray) -> np.ndarray:
        outside = ((points < 0) | (points > 2 * MIDDLE)).any(axis=-1)
        return np.where(outside, 5.0, np.where(outside, 0.0, CUT(points)))

    field, expected = MOVES[name](CUT), MOVES[name](fields.from_function(end_with_data, lambda p: np.zeros(p.shape)))
    points = RNG.uniform(-30, 40, (40_000, 3))
    sure = np.abs(field(points)) > 0.02
    assert ((field(points) < 0) == (expected(points) < 0))[sure].all()
    has_domain = name not in ("union", "difference", "complement", "warp")
    assert (field.domain is not None) == has_domain
    if has_domain:
        low, high = np.array(field.domain)
        beyond = ((points < low) | (points > high)).any(axis=1)
        assert (field(points[beyond]) > 0).all()


def test_data_without_a_solid_at_their_border_need_no_planes() -> None:
    within = fields.sampled(sample("within"), tuple(STEP), level=0.0)
    assert type(fields.rotate(within, "x", 20)).__name__ == "AffineTransformedField"
    assert np.allclose(fields.translate(within, (1, 2, 3)).domain, np.array(within.domain) + np.array([1, 2, 3]))


def test_labels_that_divide_an_oblique_image_end_with_it_and_have_its_planes_once(tmp_path: Path) -> None:
    halves = np.where(np.indices(COUNTS)[0] < COUNTS[0] // 2, 1, 2).astype(np.uint8)
    parts = fields.label_partition(write_nifti(tmp_path, halves))
    low, high = np.array(parts.domain)
    points = RNG.uniform(low - 2, high + 2, (20_000, 3))
    own = (points - FIRST) @ TURN / STEP
    in_cells = ((own > -0.5) & (own < np.array(COUNTS) - 0.5)).all(axis=1)
    near_end = np.abs(np.abs(own - (np.array(COUNTS) - 1) / 2) - np.array(COUNTS) / 2).min(axis=1) < 1e-3
    for number, region in parts.regions.items():
        is_own = in_cells & ((own[:, 0] < COUNTS[0] // 2 - 0.5) == (number == 1))
        sure = ~near_end & (np.abs(own[:, 0] - (COUNTS[0] // 2 - 0.5)) > 0.3)
        assert ((region(points) < 0) == is_own)[sure].all()
        assert len(list_bounded(settle_data(region, low, high)[0])) == 1


def test_a_box_beyond_data_along_the_axes_makes_the_solid_of_their_own_box() -> None:
    field = MOVES["quarter turn"](CUT)
    low, high = np.array(field.domain)
    own = tpmscad.solidify(field, (low, high), tol=0.3)
    wide = tpmscad.solidify(field, (low - 3, high + 4), tol=0.3)
    assert (own.volume, own.certificate.n_faces) == (wide.volume, wide.certificate.n_faces)
    assert any("the solid ends with the data" in note for note in wide.certificate.notes)
    assert wide.envelope.volume == pytest.approx(float(np.prod(high - low + 7)))
    with pytest.raises(InvalidRequest, match="no data in the box"):
        tpmscad.solidify(field, (high + 1, high + 9), tol=0.3)


def test_a_field_of_data_that_fills_a_body_ends_with_them() -> None:
    body = bd.Pos(*MIDDLE) * bd.Box(30, 20, 8)
    assert tpmscad.infill(body, CUT, tol=0.3).volume == pytest.approx(integrate_cut(), rel=0.02)


def test_spacings_of_scaled_data_are_scaled() -> None:
    scaled = fields.scale(fields.rotate(CUT, "x", 20), 3.0) & fields.scale(CUT, 5.0)
    assert (find_least_spacing(CUT), find_least_spacing(scaled)) == (1.0, pytest.approx(3.0))


def test_turned_data_are_a_body_that_ends_with_them() -> None:
    body = fields.rotate(CUT, "z", 40)
    model = tpmscad.infill(body, "schwarz_p", cell=8, thickness=1.0, tol=0.3)
    points = RNG.uniform(*np.array(body.domain), (200_000, 3))
    wall = fields.wall(fields.tpms("schwarz_p", 8.0, reference="minimal"), 1.0)
    inside = (body(points) < 0) & (wall(points) < 0)
    expected = float(np.prod(np.ptp(np.array(body.domain), axis=0))) * inside.mean()
    assert model.volume == pytest.approx(expected, rel=0.02)
