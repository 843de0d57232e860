"""One volume in every format: other libraries write it, and the same array is read in the same place."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tpmscad import fields
from tpmscad.errors import InvalidRequest
from tpmscad.fields.data.grey_levels import find_otsu_threshold
from tpmscad.fields.data.image_files import read_image

RNG = np.random.default_rng(17)
SPACING, ORIGIN = np.array([0.5, 0.4, 0.7]), np.array([1.0, -2.0, 0.5])
STORED = RNG.integers(-900, 900, (4, 5, 6)).astype(np.int16)
SLOPE, INTERCEPT = 0.5, -3.0
VALUES = (SLOPE * STORED + INTERCEPT).astype(np.float32)
"""In LPS; exact in all formats, scaled integers of DICOM among them."""

AFFINE = np.diag([*SPACING, 1.0])
AFFINE[:3, 3] = ORIGIN


def write_nifti(path: Path) -> None:
    nibabel = pytest.importorskip("nibabel")
    nibabel.save(nibabel.Nifti1Image(VALUES, np.diag([-1.0, -1.0, 1.0, 1.0]) @ AFFINE), path)


def write_nrrd(path: Path) -> None:
    nrrd = pytest.importorskip("nrrd")
    header = {"space": "left-posterior-superior", "space directions": np.diag(SPACING), "space origin": ORIGIN}
    nrrd.write(str(path), VALUES, header)


def write_mhd(path: Path, element: str = "MET_FLOAT") -> None:
    """By hand, after the format's description: the first axis is stored backwards, and its direction says so."""
    pytest.importorskip("SimpleITK")
    end = ORIGIN + np.array([SPACING[0] * (VALUES.shape[0] - 1), 0, 0])
    path.with_suffix(".bin").write_bytes(VALUES[::-1].tobytes(order="F"))
    path.write_text(
        "ObjectType = Image\nNDims = 3\nBinaryData = True\nBinaryDataByteOrderMSB = False\nCompressedData = False\n"
        f"TransformMatrix = -1 0 0 0 1 0 0 0 1\nOffset = {' '.join(map(str, end))}\n"
        f"ElementSpacing = {' '.join(map(str, SPACING))}\nDimSize = 4 5 6\nElementType = {element}\n"
        f"ElementDataFile = {path.with_suffix('.bin').name}\n"
    )


def write_slice(path: Path, k: int, position: Sequence[float], series: str = "1.2.3", instance: int = 1) -> None:
    """Slice k of the volume by pydicom, its first axis along the rows."""
    pydicom = pytest.importorskip("pydicom")
    pytest.importorskip("SimpleITK")
    from pydicom.uid import CTImageStorage, ExplicitVRLittleEndian, generate_uid

    meta = pydicom.dataset.FileMetaDataset()
    meta.TransferSyntaxUID, meta.MediaStorageSOPClassUID = ExplicitVRLittleEndian, CTImageStorage
    meta.MediaStorageSOPInstanceUID = generate_uid()
    data = pydicom.dataset.FileDataset(str(path), {}, file_meta=meta, preamble=b"\0" * 128)
    data.SOPClassUID, data.SOPInstanceUID = CTImageStorage, meta.MediaStorageSOPInstanceUID
    data.Modality, data.SeriesInstanceUID, data.StudyInstanceUID = "CT", series, "1.2"
    data.SeriesDescription, data.InstanceNumber = f"series {series[-1]}", instance
    data.ImagePositionPatient = [float(x) for x in position]
    data.ImageOrientationPatient, data.PixelSpacing = [1, 0, 0, 0, 1, 0], [SPACING[1], SPACING[0]]
    data.Rows, data.Columns, data.SliceThickness = VALUES.shape[1], VALUES.shape[0], "9"
    data.SamplesPerPixel, data.PhotometricInterpretation = 1, "MONOCHROME2"
    data.BitsAllocated, data.BitsStored, data.HighBit, data.PixelRepresentation = 16, 16, 15, 1
    data.RescaleSlope, data.RescaleIntercept = SLOPE, INTERCEPT
    data.PixelData = np.ascontiguousarray(STORED[:, :, k].T).tobytes()
    data.save_as(path, enforce_file_format=True)


def write_dicom(folder: Path, skipped: Sequence[int] = (), **options: Any) -> None:
    """The slices in files whose names are in another order."""
    folder.mkdir(exist_ok=True)
    for k in set(range(6)) - set(skipped):
        write_slice(
            folder / f"{(5 * k + 3) % 7}{options}.dcm"[:20], k, ORIGIN + np.array([0, 0, k * SPACING[2]]), **options
        )


def write_tiff(path: Path) -> None:
    tifffile = pytest.importorskip("tifffile")
    stated = {"spacing": SPACING[2], "unit": "mm", "axes": "ZYX"}
    tifffile.imwrite(path, VALUES.T, imagej=True, resolution=1 / SPACING[:2], metadata=stated)


def write_ome(path: Path) -> None:
    tifffile = pytest.importorskip("tifffile")
    stated = {"axes": "ZYX"} | {f"PhysicalSize{axis}": 1e3 * size for axis, size in zip("XYZ", SPACING, strict=True)}
    tifffile.imwrite(path, VALUES.T, ome=True, photometric="minisblack", metadata=stated)


def write_map(path: Path) -> None:
    """Columns along z, rows along x, sections along y."""
    mrcfile = pytest.importorskip("mrcfile")
    with mrcfile.new(path) as made:
        made.set_data(np.ascontiguousarray(VALUES.transpose(1, 0, 2)))
        made.voxel_size = tuple(SPACING)
        made.header.mapc, made.header.mapr, made.header.maps = 3, 1, 2
        made.header.origin.x, made.header.origin.y, made.header.origin.z = ORIGIN


def brick_mesh() -> tuple[np.ndarray, np.ndarray]:
    """The corners of the voxels, and the eight of each, in the order of their values."""
    counts = np.array(VALUES.shape) + 1
    corners = (np.indices(counts).reshape(3, -1).T - 0.5) * SPACING + ORIGIN
    number = np.arange(counts.prod()).reshape(counts)
    ring = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)]
    bricks = [number[i : i + counts[0] - 1, j : j + counts[1] - 1, k : k + counts[2] - 1].ravel() for i, j, k in ring]
    return corners, np.stack(bricks, axis=1)


def write_vtu(
    path: Path, kept: np.ndarray | None = None, move: Callable[[np.ndarray], np.ndarray] = lambda x: x
) -> None:
    """By meshio, the elements in any order."""
    meshio = pytest.importorskip("meshio")
    pytest.importorskip("vtkmodules")
    corners, bricks = brick_mesh()
    order = RNG.permutation(len(bricks) if kept is None else np.flatnonzero(kept.ravel()))
    data = {"density": [VALUES.ravel()[order]], "other": [np.zeros(len(order))]}
    meshio.Mesh(move(corners), [("hexahedron", bricks[order])], cell_data=data).write(path)


IN_LPS = {"a.nii.gz": write_nifti, "a.nrrd": write_nrrd, "a.mhd": write_mhd, "slices": write_dicom}
WITHOUT_FRAME = {"a.tif": write_tiff, "a.ome.tif": write_ome, "a.map": write_map, "a.vtu": write_vtu}


@pytest.mark.parametrize("name", [*IN_LPS, *WITHOUT_FRAME])
def test_one_volume_is_the_same_array_in_the_same_place_in_every_format(name: str, tmp_path: Path) -> None:
    (IN_LPS | WITHOUT_FRAME)[name](tmp_path / name)
    options: dict[str, Any] = {"frame": "LPS"} if name in IN_LPS else {}
    image = read_image(tmp_path / name, **options, array_name="density" if name == "a.vtu" else None)
    np.testing.assert_allclose(image.values, VALUES, rtol=1e-6)
    np.testing.assert_allclose(image.spacing, SPACING, rtol=1e-5)
    np.testing.assert_allclose(image.origin, (0, 0, 0) if name.endswith("tif") else ORIGIN, rtol=1e-5)
    assert image.centred is (True if name == "a.vtu" else None)


@pytest.mark.parametrize("name", ["a.mhd", "slices"])
def test_the_frame_of_itk_and_dicom_is_lps(name: str, tmp_path: Path) -> None:
    IN_LPS[name](tmp_path / name)
    assert read_image(tmp_path / name).notes[0] == f"{name}: frame LPS converted to RAS, x and y reversed"


class TestSlices:
    def test_a_missing_slice_is_refused(self, tmp_path: Path) -> None:
        write_dicom(tmp_path / "scan", skipped=[2])
        with pytest.raises(InvalidRequest, match=r"in scan are 0\.7 to 1\.4 mm apart, most between 1\.2 and 2\.6: a"):
            read_image(tmp_path / "scan")

    def test_of_several_series_one_is_chosen(self, tmp_path: Path) -> None:
        write_dicom(tmp_path / "scan")
        write_dicom(tmp_path / "scan", series="1.2.4", skipped=[0, 1])
        with pytest.raises(InvalidRequest, match="scan holds 2 series of DICOM: choose one, volume=0 to 1"):
            read_image(tmp_path / "scan")
        depths = {read_image(tmp_path / "scan", volume=k).values.shape[2] for k in (0, 1)}
        assert depths == {6, 4}
        assert "scan: series 0 of 2, series 3" in read_image(tmp_path / "scan", volume=0).notes

    def test_slices_of_several_times_are_volumes_in_whatever_order_they_are_found(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        reader = pytest.importorskip("SimpleITK").ImageSeriesReader
        find = reader.GetGDCMSeriesFileNames
        shuffled = staticmethod(lambda *series: RNG.permutation(find(*series)).tolist())
        monkeypatch.setattr(reader, "GetGDCMSeriesFileNames", shuffled)
        tmp_path.joinpath("scan").mkdir()
        for time in (1, 2):
            for k in range(3):
                path = tmp_path / "scan" / f"{9 * k + time}"
                write_slice(path, 3 * (time - 1) + k, ORIGIN + np.array([0, 0, k]), instance=10 * k + time)
        np.testing.assert_array_equal(read_image(tmp_path / "scan", volume=1, frame="LPS").values, VALUES[:, :, 3:])

    def test_slices_that_make_no_volume_are_refused(self, tmp_path: Path) -> None:
        pydicom = pytest.importorskip("pydicom")
        write_dicom(tmp_path / "scan", skipped=[4, 5])
        write_slice(tmp_path / "scan" / "again", 0, ORIGIN, instance=9)
        with pytest.raises(InvalidRequest, match="5 slices in scan lie at 4 positions: as many are needed at each"):
            read_image(tmp_path / "scan")
        data = pydicom.dcmread(tmp_path / "scan" / "again")
        data.PixelSpacing = [1.0, 1.0]
        data.save_as(tmp_path / "scan" / "again")
        with pytest.raises(InvalidRequest, match="the slices in scan differ in size, spacing or direction"):
            read_image(tmp_path / "scan")

    def test_one_file_of_a_series_is_refused(self, tmp_path: Path) -> None:
        write_dicom(tmp_path / "scan")
        with pytest.raises(InvalidRequest, match="one slice: give the folder of its series"):
            read_image(min((tmp_path / "scan").iterdir()))

    def test_pictures_of_a_folder_are_in_the_order_of_their_numbers(self, tmp_path: Path) -> None:
        tifffile = pytest.importorskip("tifffile")
        for k in range(6):
            tifffile.imwrite(tmp_path / f"slice{2 * k + 1}.tif", VALUES[:, :, k].T)
        np.testing.assert_array_equal(read_image(tmp_path).values, VALUES)
        tifffile.imwrite(tmp_path / "slice99.tif", VALUES[:3, :, 0].T)
        with pytest.raises(InvalidRequest, match=r"slice99\.tif in .* has the shape \(5, 3\), slice1\.tif \(5, 4\)"):
            read_image(tmp_path)

    def test_a_folder_without_slices_is_refused(self, tmp_path: Path) -> None:
        pytest.importorskip("SimpleITK")
        (tmp_path / "notes.txt").write_text("no slices")
        with pytest.raises(InvalidRequest, match="holds no slices of DICOM, and no pictures"):
            read_image(tmp_path)

    def test_colours_are_refused(self, tmp_path: Path) -> None:
        tifffile = pytest.importorskip("tifffile")
        tifffile.imwrite(tmp_path / "a.tif", np.zeros((4, 5, 6, 3), np.uint8), photometric="rgb")
        with pytest.raises(InvalidRequest, match=r"a\.tif holds 3 colours for each pixel"):
            read_image(tmp_path / "a.tif")


def test_vectors_and_maps_without_three_axes_are_refused(tmp_path: Path) -> None:
    sitk = pytest.importorskip("SimpleITK")
    sitk.WriteImage(sitk.GetImageFromArray(np.zeros((5, 6, 7, 2)), isVector=True), str(tmp_path / "a.mha"))
    with pytest.raises(InvalidRequest, match=r"a\.mha holds 2 numbers for each voxel"):
        read_image(tmp_path / "a.mha")
    mrcfile = pytest.importorskip("mrcfile")
    with mrcfile.new(tmp_path / "a.mrc") as made:
        made.set_data(VALUES)
        made.header.mapr = 1
    with pytest.raises(InvalidRequest, match=r"a\.mrc states the axes \[1, 1, 3\], which must be 1, 2 and 3"):
        read_image(tmp_path / "a.mrc")


class TestMeshes:
    """Values of a mesh of bricks, put on the grid of its elements or of its nodes."""

    def test_values_of_nodes_are_points(self, tmp_path: Path) -> None:
        meshio = pytest.importorskip("meshio")
        corners, bricks = brick_mesh()
        order = RNG.permutation(len(corners))
        values = RNG.normal(size=len(corners))
        data = {"stress": values[order]}
        cells = [("hexahedron", np.argsort(order)[bricks])]
        meshio.Mesh(corners[order], cells, point_data=data).write(tmp_path / "a.vtu")
        image = read_image(tmp_path / "a.vtu")
        np.testing.assert_array_equal(image.values, values.reshape(5, 6, 7))
        np.testing.assert_allclose((image.spacing, image.origin), (SPACING, ORIGIN - SPACING / 2))
        assert image.centred is False

    def test_where_the_mesh_has_no_element_there_is_no_solid(self, tmp_path: Path) -> None:
        kept = np.ones(VALUES.shape, bool)
        kept[1:, 3:] = False
        write_vtu(tmp_path / "a.vtu", kept)
        field = fields.sampled(tmp_path / "a.vtu", level=-1000, array_name="density")
        centres = np.argwhere(np.ones_like(kept)) * SPACING + ORIGIN
        np.testing.assert_array_equal(field(centres) < 0, kept.ravel())
        assert any("36 of 120 samples have no value" in note for note in field.notes)

    def test_of_several_arrays_one_is_named(self, tmp_path: Path) -> None:
        write_vtu(tmp_path / "a.vtu")
        with pytest.raises(
            InvalidRequest, match=r"holds 2 arrays, 'density', 'other': name one .*array_name='density'"
        ):
            read_image(tmp_path / "a.vtu")
        with pytest.raises(InvalidRequest, match=r"holds no array 'rho': its arrays are 'density', 'other'"):
            read_image(tmp_path / "a.vtu", array_name="rho")

    def test_elements_on_no_grid_are_refused(self, tmp_path: Path) -> None:
        write_vtu(tmp_path / "a.vtu", move=lambda x: x + 0.05 * np.sin(7 * x[:, [1, 2, 0]]))
        with pytest.raises(InvalidRequest, match=r"a\.vtu lie on no uniform grid along x, y and z"):
            read_image(tmp_path / "a.vtu", array_name="density")

    def test_elements_of_two_sizes_are_refused(self, tmp_path: Path) -> None:
        """The outermost layers, twice as thick, have centres on a uniform grid only if that grid misses the box."""
        thick = np.array([-1.0, 0.0, 2.0])
        meshio = pytest.importorskip("meshio")
        pytest.importorskip("vtkmodules")
        corners = np.array([(x, y, z) for x in thick for y in (0.0, 1.0) for z in (0.0, 1.0)])
        bricks = [[0, 4, 6, 2, 1, 5, 7, 3], [4, 8, 10, 6, 5, 9, 11, 7]]
        meshio.Mesh(corners, [("hexahedron", bricks)], cell_data={"a": [[1.0, 2.0]]}).write(tmp_path / "a.vtu")
        with pytest.raises(InvalidRequest, match=r"cells of a\.vtu differ in size: .* resample"):
            read_image(tmp_path / "a.vtu")

    def test_vectors_and_places_with_two_values_are_refused(self, tmp_path: Path) -> None:
        meshio = pytest.importorskip("meshio")
        pytest.importorskip("vtkmodules")
        corners, bricks = brick_mesh()
        for rows, data, words in (
            ([0], np.zeros((1, 3)), "holds 3 numbers at each place"),
            ([0, 1, 1], np.zeros(3), "several values at one place"),
        ):
            mesh = meshio.Mesh(corners, [("hexahedron", bricks[rows])], cell_data={"a": [data]})
            mesh.write(tmp_path / "a.vtu")
            with pytest.raises(InvalidRequest, match=words):
                read_image(tmp_path / "a.vtu")

    @pytest.mark.parametrize("suffix", ["vtr", "vtk"])
    def test_rectilinear_grids_are_read_where_they_are_uniform(self, tmp_path: Path, suffix: str) -> None:
        pytest.importorskip("vtkmodules")
        from vtkmodules.util.numpy_support import numpy_to_vtk
        from vtkmodules.vtkCommonDataModel import vtkRectilinearGrid
        from vtkmodules.vtkIOLegacy import vtkRectilinearGridWriter
        from vtkmodules.vtkIOXML import vtkXMLRectilinearGridWriter

        for power, is_uniform in ((1.0, True), (1.5, False)):
            axes = [
                f + s * (np.arange(n + 1.0) / n) ** power * n
                for n, s, f in zip(VALUES.shape, SPACING, ORIGIN, strict=True)
            ]
            grid = vtkRectilinearGrid()
            grid.SetDimensions(*(len(axis) for axis in axes))
            for name, axis in zip("XYZ", axes, strict=True):
                getattr(grid, f"Set{name}Coordinates")(numpy_to_vtk(axis, deep=True))
            array = numpy_to_vtk(VALUES.ravel(order="F"), deep=True)
            array.SetName("a")
            grid.GetCellData().SetScalars(array)
            writer = vtkXMLRectilinearGridWriter() if suffix == "vtr" else vtkRectilinearGridWriter()
            writer.SetFileName(str(tmp_path / f"a.{suffix}"))
            writer.SetInputData(grid)
            writer.Write()
            if is_uniform:
                image = read_image(tmp_path / f"a.{suffix}")
                np.testing.assert_array_equal(image.values, VALUES)
                np.testing.assert_allclose((image.spacing, image.origin), (SPACING, ORIGIN + SPACING / 2))
            else:
                with pytest.raises(InvalidRequest, match="on no uniform grid"):
                    read_image(tmp_path / f"a.{suffix}")

    def test_tetrahedra_are_refused(self, tmp_path: Path) -> None:
        meshio = pytest.importorskip("meshio")
        cells = [("tetra", [[0, 1, 2, 3]])]
        meshio.Mesh(np.eye(4, 3), cells, cell_data={"a": [[1.0]]}).write(tmp_path / "a.vtu")
        with pytest.raises(InvalidRequest, match=r"cells of a\.vtu are no bricks"):
            read_image(tmp_path / "a.vtu")


class TestPlainArrays:
    def test_an_archive_holds_one_array_or_named_ones(self, tmp_path: Path) -> None:
        np.savez(tmp_path / "a.npz", rho=VALUES, size=SPACING)
        np.testing.assert_array_equal(read_image(tmp_path / "a.npz").values, VALUES)
        np.savez(tmp_path / "b.npz", rho=VALUES, mask=VALUES > 0)
        with pytest.raises(InvalidRequest, match="holds 2 arrays, 'rho', 'mask': name one"):
            read_image(tmp_path / "b.npz")
        np.testing.assert_array_equal(read_image(tmp_path / "b.npz", array_name="mask").values, VALUES > 0)

    @pytest.mark.parametrize(("end", "order"), [("int16", "<"), ("int16_be", ">")])
    def test_raw_samples_say_shape_and_type_in_their_name(self, tmp_path: Path, end: str, order: str) -> None:
        path = tmp_path / f"scan_4x5x6_{end}.raw"
        path.write_bytes(STORED.astype(f"{order}i2").tobytes(order="F"))
        np.testing.assert_array_equal(read_image(path).values, STORED)

    def test_raw_samples_that_do_not_say_it_are_refused(self, tmp_path: Path) -> None:
        (tmp_path / "scan.raw").write_bytes(STORED.tobytes())
        with pytest.raises(InvalidRequest, match=r"name it like scan_256x256x128_uint16\.raw"):
            read_image(tmp_path / "scan.raw")
        (tmp_path / "scan_4x5x7_int16.raw").write_bytes(STORED.tobytes())
        with pytest.raises(InvalidRequest, match=r"has 240 bytes: its name says \[4, 5, 7\] of int16, which are 280"):
            read_image(tmp_path / "scan_4x5x7_int16.raw")


class TestVolumes:
    """A file of four dimensions holds several volumes."""

    SERIES = np.stack([VALUES, -VALUES, 2 * VALUES], axis=-1)

    def write(self, path: Path) -> None:
        if path.suffix == ".npy":
            np.save(path, self.SERIES)
        elif path.suffix == ".nii":
            nibabel = pytest.importorskip("nibabel")
            nibabel.save(nibabel.Nifti1Image(self.SERIES, AFFINE), path)
        elif path.suffix == ".nrrd":
            nrrd = pytest.importorskip("nrrd")
            directions = np.vstack([np.full(3, np.nan), np.diag(SPACING)])
            header = {"space": "RAS", "space directions": directions, "space origin": ORIGIN}
            nrrd.write(str(path), np.moveaxis(self.SERIES, -1, 0).copy(), header)
        elif path.suffix == ".mha":
            sitk = pytest.importorskip("SimpleITK")
            image = sitk.GetImageFromArray(self.SERIES.T, isVector=False)
            image.SetSpacing([*SPACING, 2.0])
            image.SetOrigin([*(ORIGIN * (-1, -1, 1)), 0.0])
            image.SetDirection((np.diag([-1.0, -1.0, 1.0, 1.0])).ravel())
            sitk.WriteImage(image, str(path))
        else:
            tifffile = pytest.importorskip("tifffile")
            stated = {"axes": "TZYX", "spacing": SPACING[2], "unit": "mm"}
            tifffile.imwrite(path, self.SERIES.T, imagej=True, metadata=stated, resolution=1 / SPACING[:2])

    @pytest.mark.parametrize("suffix", ["npy", "nii", "nrrd", "mha", "tif"])
    def test_one_of_them_is_chosen(self, tmp_path: Path, suffix: str) -> None:
        path = tmp_path / f"a.{suffix}"
        self.write(path)
        with pytest.raises(InvalidRequest, match=f"a.{suffix} holds 3 volumes: choose one, volume=0 to 2"):
            read_image(path)
        with pytest.raises(InvalidRequest, match=f"volume 3: a.{suffix} holds 3 volumes, 0 to 2"):
            read_image(path, volume=3)
        image = read_image(path, volume=1)
        np.testing.assert_array_equal(image.values, -VALUES)
        assert f"a.{suffix}: volume 1 of 3" in image.notes
        if suffix != "npy":
            np.testing.assert_allclose(image.spacing, SPACING, rtol=1e-6)
        if suffix not in ("npy", "tif"):
            np.testing.assert_allclose(image.origin, ORIGIN, rtol=1e-6)

    def test_one_volume_has_no_number_one(self, tmp_path: Path) -> None:
        np.save(tmp_path / "a.npy", VALUES[..., None])
        np.testing.assert_array_equal(read_image(tmp_path / "a.npy").values, VALUES)
        np.save(tmp_path / "b.npy", VALUES)
        with pytest.raises(InvalidRequest, match=r"volume 2: b\.npy holds one volume: leave `volume` out"):
            read_image(tmp_path / "b.npy", volume=2)
        with pytest.raises(InvalidRequest, match=r"volume 1: a\.npy holds one volume: leave `volume` out"):
            read_image(tmp_path / "a.npy", volume=1)


class TestMissingValues:
    """NaN is outside the solid, and told."""

    BOX = (slice(2, 6), slice(2, 7), slice(3, 7))

    @pytest.mark.parametrize("level", [None, 0.5])
    def test_the_solid_ends_halfway_to_the_first_missing_sample(self, level: float | None) -> None:
        values = np.full((9, 9, 9), np.nan)
        values[self.BOX] = 1.0 if level else -1.0
        field = fields.sampled(values, 2.0, level=level)
        for axis, part in enumerate(self.BOX):
            for end, outward in ((part.start, -1), (part.stop - 1, 1)):
                steps = end + outward * np.linspace(0, 1, 101)
                at = np.tile([4.0, 4.0, 5.0], (101, 1))
                at[:, axis] = steps
                solid = field(2 * at) < 0
                assert solid[0]
                assert 0.4 < np.count_nonzero(solid) / 101 < 0.6
        assert any("649 of 729 samples have no value (NaN) and are outside" in note for note in field.notes)

    def test_labels_are_zero_where_they_are_missing(self) -> None:
        organs = np.where(np.indices((8, 8, 8))[0] < 4, 2.0, np.nan)
        field = fields.labels(organs, label=2)
        np.testing.assert_array_equal(field(np.argwhere(organs == organs)) < 0, True)
        assert "256 voxels without a value (NaN) are taken as 0" in field.notes[0]

    def test_an_image_of_nothing_else_is_refused(self) -> None:
        with pytest.raises(InvalidRequest, match="holds no values but NaN"):
            fields.sampled(np.full((5, 5, 5), np.nan), level=1)


class TestLevels:
    def test_the_threshold_is_otsus(self) -> None:
        filters = pytest.importorskip("skimage.filters")
        for classes in ((0.0, 1.0), (100.0, 1000.0)):
            values = np.concatenate([RNG.normal(m, 0.4 * (classes[1] - classes[0]), 4000) for m in classes])
            # scikit-image returns the centre of the bin below, or the last of several equal ones
            width = np.ptp(values) / 256
            assert abs(find_otsu_threshold(values) - filters.threshold_otsu(values)) <= 2 * width

    def test_between_two_values_it_is_their_mean(self) -> None:
        assert find_otsu_threshold(np.repeat([2.0, 6.0], (30, 70))) == pytest.approx(4.0, abs=0.02)

    def test_a_level_outside_the_data_or_none_is_answered_with_one(self) -> None:
        values = np.repeat([2.0, 6.0], 32)[:, None, None] * np.ones((1, 8, 8))
        for level in (1, 6, 9):
            with pytest.raises(InvalidRequest, match=rf"level {level} .* from 2 to 6; Otsu's .* is 4: give a"):
                fields.sampled(values, level=level)
        with pytest.raises(InvalidRequest, match=r"grey values: it needs `level`.* from 2 to 6; Otsu's .* is 4\)"):
            fields.labels(values, label="all")


class TestSeveralThings:
    """What a file holds beside the samples that are read is chosen by an argument, applied, refused or told."""

    @staticmethod
    def write_stacks(path: Path, *stacks: np.ndarray) -> Path:
        tifffile = pytest.importorskip("tifffile")
        with tifffile.TiffWriter(path) as writer:
            for stack in stacks:
                writer.write(stack.T, photometric="minisblack")
        return path

    def test_of_several_stacks_of_pictures_one_is_chosen(self, tmp_path: Path) -> None:
        path = self.write_stacks(tmp_path / "a.tif", VALUES, VALUES + 1)
        with pytest.raises(InvalidRequest, match=r"a\.tif holds 2 stacks of pictures: choose one, volume=0 to 1"):
            read_image(path)
        second = read_image(path, volume=1)
        np.testing.assert_array_equal(second.values, VALUES + 1)
        assert "a.tif: stack 1 of 2 was taken" in second.notes

    def test_single_pictures_are_a_stack_if_they_have_one_size(self, tmp_path: Path) -> None:
        layers = [VALUES[:, :, k] for k in range(VALUES.shape[2])]
        np.testing.assert_array_equal(read_image(self.write_stacks(tmp_path / "a.tif", *layers)).values, VALUES)
        with pytest.raises(InvalidRequest, match=r"pictures of several sizes, 1 of .* 1 of .* no stack"):
            read_image(self.write_stacks(tmp_path / "b.tif", layers[0], layers[0][1:]))
        beside = read_image(self.write_stacks(tmp_path / "c.tif", VALUES, layers[0][1:]))
        assert "c.tif: 1 single pictures beside its stacks were left out" in beside.notes

    def test_each_axis_of_ome_has_its_own_unit(self, tmp_path: Path) -> None:
        tifffile = pytest.importorskip("tifffile")
        stated = {"axes": "ZYX", "PhysicalSizeX": 500.0, "PhysicalSizeY": 0.5, "PhysicalSizeYUnit": "mm"}
        stated |= {"PhysicalSizeZ": 0.2, "PhysicalSizeZUnit": "cm"}
        tifffile.imwrite(tmp_path / "a.ome.tif", VALUES.T, ome=True, photometric="minisblack", metadata=stated)
        assert read_image(tmp_path / "a.ome.tif").spacing == pytest.approx((0.5, 0.5, 2.0))

    def test_slope_and_offset_of_metaimage_are_applied(self, tmp_path: Path) -> None:
        write_mhd(tmp_path / "a.mhd")
        plain = read_image(tmp_path / "a.mhd").values
        text = (tmp_path / "a.mhd").read_text()
        scale = "ElementToIntensityFunctionSlope = 2\nElementToIntensityFunctionOffset = -3\n"
        (tmp_path / "a.mhd").write_text(text.replace("ElementDataFile", f"{scale}ElementDataFile"))
        np.testing.assert_allclose(read_image(tmp_path / "a.mhd").values, 2.0 * plain - 3.0)

    def test_axes_of_nrrd_that_are_no_space_number_volumes(self, tmp_path: Path) -> None:
        nrrd = pytest.importorskip("nrrd")
        colours = np.stack([VALUES, VALUES + 1, VALUES + 2])
        kinds = {"kinds": ["RGB-color", "domain", "domain", "domain"]}
        nrrd.write(str(tmp_path / "a.nrrd"), colours, kinds)
        nrrd.write(
            str(tmp_path / "b.nrrd"), np.stack([colours, colours], axis=-1), {"kinds": [*kinds["kinds"], "list"]}
        )
        for name, count in (("a.nrrd", 3), ("b.nrrd", 6)):
            with pytest.raises(InvalidRequest, match=f"holds {count} volumes"):
                read_image(tmp_path / name)
            np.testing.assert_array_equal(read_image(tmp_path / name, volume=1).values, VALUES + 1)
        nrrd.write(str(tmp_path / "c.nrrd"), VALUES, {"axis mins": [5.0, 6.0, 7.0]})
        assert any(
            "axis mins, which are not read: give `spacing`, `origin`" in n
            for n in read_image(tmp_path / "c.nrrd").notes
        )

    def test_arrays_that_are_no_samples_are_told_and_complex_ones_refused(self, tmp_path: Path) -> None:
        np.savez(tmp_path / "a.npz", density=VALUES, spacing=SPACING)
        assert any("its arrays 'spacing' are not read" in note for note in read_image(tmp_path / "a.npz").notes)
        np.save(tmp_path / "a.npy", VALUES.astype(complex))
        with pytest.raises(InvalidRequest, match=r"a\.npy holds complex numbers, .* save one quantity"):
            read_image(tmp_path / "a.npy")
