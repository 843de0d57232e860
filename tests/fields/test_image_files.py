"""Image files: written by other libraries, read back with position, frame and unit; and what they say of cells and points."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tpmscad import fields
from tpmscad.errors import InvalidRequest
from tpmscad.fields.data.image_files import read_image

RNG = np.random.default_rng(11)
SPACING, ORIGIN = np.array([0.5, 0.4, 0.7]), np.array([1.0, -2.0, 0.5])
VALUES = RNG.normal(size=(4, 5, 6))
AFFINE = np.diag([*SPACING, 1.0])
AFFINE[:3, 3] = ORIGIN


def check(path: Path, **options: Any) -> None:
    image = read_image(path, **options)
    np.testing.assert_allclose(image.values, VALUES, rtol=1e-6)
    np.testing.assert_allclose(image.spacing, SPACING, rtol=1e-6)
    np.testing.assert_allclose(image.origin, ORIGIN, rtol=1e-6)


def write_nifti(path: Path, affine: np.ndarray = AFFINE, values: np.ndarray = VALUES, unit: str = "mm") -> Path:
    nibabel = pytest.importorskip("nibabel")
    image = nibabel.Nifti1Image(values, affine)
    image.header.set_xyzt_units(unit)
    nibabel.save(image, path)
    return path


def write_nrrd(path: Path, affine: np.ndarray = AFFINE, **header: Any) -> Path:
    nrrd = pytest.importorskip("nrrd")
    nrrd.write(str(path), VALUES, {"space directions": affine[:3, :3].T, "space origin": affine[:3, 3], **header})
    return path


def write_vtk(path: Path, points: dict[str, np.ndarray], cells: dict[str, np.ndarray], **placed: Any) -> Path:
    """VTK's file of arrays of points and of cells; an array without a name is the active scalars."""
    pytest.importorskip("vtkmodules")
    from vtkmodules.util.numpy_support import numpy_to_vtk
    from vtkmodules.vtkCommonDataModel import vtkImageData
    from vtkmodules.vtkIOLegacy import vtkStructuredPointsWriter
    from vtkmodules.vtkIOXML import vtkXMLImageDataWriter

    data = vtkImageData()
    shape = next((a.shape for a in points.values()), None) or [n + 1 for n in next(iter(cells.values())).shape]
    data.SetDimensions(*shape)
    data.SetSpacing(*SPACING)
    data.SetOrigin(*placed.get("origin", ORIGIN))
    data.SetDirectionMatrix(*placed.get("direction", np.eye(3)).ravel())
    for attributes, arrays in ((data.GetPointData(), points), (data.GetCellData(), cells)):
        for name, values in arrays.items():
            array = numpy_to_vtk(values.ravel(order="F"), deep=True)
            if name:
                array.SetName(name)
                attributes.AddArray(array)
            else:
                attributes.SetScalars(array)
    writer = vtkXMLImageDataWriter() if path.suffix == ".vti" else vtkStructuredPointsWriter()
    writer.SetFileName(str(path))
    writer.SetInputData(data)
    writer.Write()
    return path


def test_a_nifti_file_of_one_volume_in_time_is_a_volume_and_one_of_several_is_refused(tmp_path: Path) -> None:
    check(write_nifti(tmp_path / "one.nii", values=VALUES[..., None]))
    with pytest.raises(InvalidRequest, match=r"holds 2 volumes"):
        read_image(write_nifti(tmp_path / "two.nii", values=np.stack([VALUES] * 2, axis=-1)))


@pytest.mark.parametrize("axes", [[[0.8, -0.6, 0], [0.6, 0.8, 0], [0, 0, 1]], [[1, 0, 0], [0, 1, 0.4], [0, 0, 1.1]]])
def test_every_sample_lies_where_the_axes_of_the_file_take_it(axes: list[list[float]], tmp_path: Path) -> None:
    """Turned axes, and those of a tilted gantry, which are not square to each other; two of the three stored backwards."""
    affine = np.eye(4)
    affine[:3, :3], affine[:3, 3] = np.array(axes) * (-0.5, 0.4, -0.7), ORIGIN
    field = fields.sampled(write_nifti(tmp_path / "a.nii", affine))
    index = np.moveaxis(np.indices(VALUES.shape), 0, -1)[1:-1, 1:-1, 1:-1]
    np.testing.assert_allclose(field(index @ affine[:3, :3].T + ORIGIN), VALUES[1:-1, 1:-1, 1:-1], atol=1e-6)


def test_axes_in_one_plane_are_refused(tmp_path: Path) -> None:
    nrrd = pytest.importorskip("nrrd")
    flat = {"space directions": [[1.0, 0, 0], [0, 1, 0], [1, 1, 0]], "space origin": ORIGIN}
    nrrd.write(str(tmp_path / "a.nrrd"), VALUES, {"space dimension": 3, **flat})
    with pytest.raises(InvalidRequest, match=r"axes of a\.nrrd lie in one plane"):
        read_image(tmp_path / "a.nrrd")


def test_nrrd_with_exchanged_axes(tmp_path: Path) -> None:
    nrrd = pytest.importorskip("nrrd")
    header = {"space dimension": 3, "space directions": np.diag(SPACING)[[2, 1, 0]], "space origin": ORIGIN}
    nrrd.write(str(tmp_path / "a.nrrd"), np.ascontiguousarray(VALUES.transpose(2, 1, 0)), header)
    check(tmp_path / "a.nrrd")


def test_a_vti_file_of_turned_axes_lies_where_vtk_has_it(tmp_path: Path) -> None:
    """The index axes run along y, -x and z, so that the box begins at -x."""
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    image = read_image(write_vtk(tmp_path / "a.vti", {"": VALUES}, {}, origin=(0.0, 0.0, 0.0), direction=turn))
    np.testing.assert_allclose(image.spacing, SPACING[[1, 0, 2]])
    np.testing.assert_allclose(image.origin, (-4 * SPACING[1], 0, 0), atol=1e-15)
    np.testing.assert_allclose(image.values, VALUES.transpose(1, 0, 2)[::-1])


@pytest.mark.parametrize("suffix", ["npy", "vti", "vtk", "nrrd", "nii"])
def test_a_broken_file_is_refused(tmp_path: Path, suffix: str, capfd: pytest.CaptureFixture[str]) -> None:
    (tmp_path / f"a.{suffix}").write_bytes(b"no image at all")
    with pytest.raises(InvalidRequest, match=f"a.{suffix}"):
        read_image(tmp_path / f"a.{suffix}")


class TestFrames:
    """Coordinates x, y, z of a patient's frame, and the same ones in another."""

    @pytest.mark.parametrize(
        ("space", "signs"),
        [
            ("left-posterior-superior", (-1, -1, 1)),
            ("LPS", (-1, -1, 1)),
            ("left-anterior-superior", (-1, 1, 1)),
            ("right-anterior-superior", (1, 1, 1)),
        ],
    )
    def test_one_volume_is_the_same_field_from_nrrd_in_any_frame_and_from_nifti(
        self, tmp_path: Path, space: str, signs: tuple[int, int, int]
    ) -> None:
        nifti = fields.sampled(write_nifti(tmp_path / "a.nii"))
        nrrd = fields.sampled(write_nrrd(tmp_path / "a.nrrd", np.diag([*signs, 1.0]) @ AFFINE, space=space))
        np.testing.assert_allclose(nrrd.domain, nifti.domain, rtol=1e-6)
        points = RNG.uniform(*nifti.domain, (100, 3))
        np.testing.assert_allclose(nrrd(points), nifti(points), rtol=0, atol=1e-5)

    def test_an_image_in_lps_is_the_one_in_ras_turned_about_z_by_half_a_turn(self, tmp_path: Path) -> None:
        path = write_nifti(tmp_path / "a.nii")
        ras, lps = fields.sampled(path), fields.sampled(path, frame="LPS")
        points = RNG.uniform(*ras.domain, (100, 3))
        np.testing.assert_allclose(lps(points * (-1, -1, 1)), ras(points), atol=1e-12)
        check(write_nrrd(tmp_path / "a.nrrd", space="left-posterior-superior"), frame="LPS")

    def test_the_frame_of_the_file_keeps_its_coordinates(self, tmp_path: Path) -> None:
        for space in ("left-posterior-superior", "left-anterior-superior", "3D-left-handed"):
            check(write_nrrd(tmp_path / "a.nrrd", space=space), frame="file")

    def test_a_frame_that_is_no_patients_keeps_its_coordinates(self, tmp_path: Path) -> None:
        path = write_nrrd(tmp_path / "a.nrrd", space="scanner-xyz")
        check(path)
        assert read_image(path).notes[0] == "a.nrrd: no frame stated (scanner-xyz); coordinates as in the file"

    def test_what_was_done_is_told(self, tmp_path: Path) -> None:
        for space, told in (("LPS", "LPS converted to RAS, x and y reversed"), ("RAS", "RAS")):
            assert read_image(write_nrrd(tmp_path / "a.nrrd", space=space)).notes[0] == f"a.nrrd: frame {told}"

    def test_a_nifti_file_without_a_frame_starts_at_the_origin(self, tmp_path: Path) -> None:
        nibabel = pytest.importorskip("nibabel")
        image = nibabel.Nifti1Image(VALUES, None)
        image.header.set_zooms(SPACING)
        nibabel.save(image, tmp_path / "a.nii")
        found = read_image(tmp_path / "a.nii")
        np.testing.assert_array_equal(found.values, VALUES)
        np.testing.assert_allclose((found.spacing, found.origin), (SPACING, (0, 0, 0)), rtol=1e-6)
        assert "no frame stated" in found.notes[0]

    def test_a_nifti_file_of_two_positions_is_told(self, tmp_path: Path) -> None:
        nibabel = pytest.importorskip("nibabel")
        image = nibabel.Nifti1Image(VALUES, AFFINE)
        other = AFFINE.copy()
        other[0, 3] += 5
        image.set_qform(other, 1)
        nibabel.save(image, tmp_path / "a.nii")
        check(tmp_path / "a.nii")
        assert any("sform and qform" in note for note in read_image(tmp_path / "a.nii").notes)

    @pytest.mark.parametrize(
        ("space", "frame", "message"),
        [
            ("3D-left-handed", None, "mirror image: give frame='file'"),
            ("scanner-xyz", "RAS", "states scanner-xyz, from which nothing can be converted to RAS"),
            ("LPS", "LAS", "frame 'LAS' is unknown; choose one of 'RAS', 'LPS', 'file'"),
        ],
    )
    def test_a_frame_that_cannot_be_had_is_refused(
        self, tmp_path: Path, space: str, frame: str | None, message: str
    ) -> None:
        with pytest.raises(InvalidRequest, match=message):
            fields.sampled(write_nrrd(tmp_path / "a.nrrd", space=space), frame=frame)

    def test_an_array_has_no_frame(self, tmp_path: Path) -> None:
        with pytest.raises(InvalidRequest, match="an array states none"):
            fields.sampled(VALUES, frame="LPS")
        np.save(tmp_path / "a.npy", VALUES)
        with pytest.raises(InvalidRequest, match="states no frame"):
            fields.sampled(tmp_path / "a.npy", frame="RAS")


class TestUnits:
    @pytest.mark.parametrize(("unit", "factor"), [("micron", 1e3), ("meter", 1e-3), ("mm", 1.0), ("unknown", 1.0)])
    def test_lengths_of_nifti_become_millimetres(self, tmp_path: Path, unit: str, factor: float) -> None:
        affine = np.diag([factor, factor, factor, 1.0]) @ AFFINE
        check(write_nifti(tmp_path / "a.nii", affine, unit=unit))

    @pytest.mark.parametrize(("unit", "factor"), [("um", 1e3), ("m", 1e-3), ("parsec", 1.0)])
    def test_lengths_of_nrrd_become_millimetres(self, tmp_path: Path, unit: str, factor: float) -> None:
        affine = np.diag([factor, factor, factor, 1.0]) @ AFFINE
        path = write_nrrd(tmp_path / "a.nrrd", affine, space="RAS", **{"space units": [unit] * 3})
        check(path)
        assert unit in read_image(path).notes[1]

    def test_several_units_are_refused(self, tmp_path: Path) -> None:
        path = write_nrrd(tmp_path / "a.nrrd", space="RAS", **{"space units": ["mm", "mm", "um"]})
        with pytest.raises(InvalidRequest, match="several units of length, mm, um"):
            read_image(path)


class TestCellsOfFiles:
    """What a file says of cells and points is used without asking."""

    @pytest.mark.parametrize(("word", "centred"), [("cell", True), ("node", False), ("none", None)])
    def test_nrrd_says_it(self, tmp_path: Path, word: str, centred: bool | None) -> None:
        path = write_nrrd(tmp_path / "a.nrrd", centerings=[word] * 3)
        assert read_image(path).centred is centred
        field = fields.sampled(path)
        assert field.centred is bool(centred)
        assert any("taken at points" in note for note in field.notes) == (centred is None)

    @pytest.mark.parametrize("suffix", ["vti", "vtk"])
    def test_vtk_says_it(self, tmp_path: Path, suffix: str) -> None:
        field = fields.sampled(write_vtk(tmp_path / f"cells.{suffix}", {}, {"": VALUES}))
        np.testing.assert_allclose(field.domain, (ORIGIN, ORIGIN + SPACING * VALUES.shape))
        check(write_vtk(tmp_path / f"points.{suffix}", {"": VALUES}, {}))

    def test_of_cells_and_points_none_are_picked(self, tmp_path: Path) -> None:
        cells = RNG.normal(size=[n - 1 for n in VALUES.shape])
        path = write_vtk(tmp_path / "a.vti", {"": VALUES}, {"": cells})
        with pytest.raises(InvalidRequest, match="holds values of points and of cells: give centred=True"):
            fields.sampled(path)
        np.testing.assert_array_equal(read_image(path, centred=True).values, cells)
        np.testing.assert_array_equal(read_image(path, centred=False).values, VALUES)

    def test_what_is_given_counts_more(self, tmp_path: Path) -> None:
        path = write_nrrd(tmp_path / "a.nrrd", centerings=["node"] * 3)
        assert fields.sampled(path, centred=True).centred
