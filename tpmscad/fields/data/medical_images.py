"""Medical images: NIfTI by nibabel, NRRD by pynrrd, MetaImage and DICOM by SimpleITK.

SimpleITK's coordinates are those of DICOM, LPS; GDCM, which it reads DICOM with, decompresses the pixels and applies the rescale
slope and intercept of every slice. The slices are placed here, by the positions that they state.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from tpmscad._lazy_import import import_extra
from tpmscad._typing import Array
from tpmscad.errors import InvalidRequest
from tpmscad.fields.data.stored_images import (
    POSITION_TOL_SPACINGS,
    ImageChoice,
    StoredImage,
    select_volume,
)

NRRD_FRAMES = {"right-anterior-superior": "RAS", "left-anterior-superior": "LAS", "left-posterior-superior": "LPS"}
NRRD_FRAMES |= {short.lower(): short for short in NRRD_FRAMES.values()}
"""Frames of the patient by the names of NRRD's field "space", in lower case."""

NRRD_IGNORED = ("axis mins", "axis maxs", "old min", "old max")
"""Fields of NRRD that place or scale its samples, of which a note tells that they are not read."""

METAIMAGE_SCALE = rb"^ElementToIntensityFunction(Slope|Offset)\s*=\s*(\S+)"
"""Lines of a header of MetaImage that SimpleITK does not apply."""

MAX_METAIMAGE_HEAD = 1 << 16
"""Bytes in which the header of a MetaImage ends."""

INSTANCE_NUMBER, SERIES_DESCRIPTION = "0020|0013", "0008|103e"
"""Tags of DICOM, as SimpleITK writes them."""


def read_nifti(file: Path, choice: ImageChoice) -> StoredImage:
    """A NIfTI file, placed by its sform, or else its qform."""
    nibabel = import_extra("nibabel", "NIfTI files", "images")
    image = nibabel.load(file)
    header, values = image.header, np.asarray(image.dataobj)
    if values.ndim > 4:
        values = values.reshape(*values.shape[:3], -1, order="F")
    unit = header.get_xyzt_units()[0]
    sform, qform = image.get_sform(coded=True), image.get_qform(coded=True)
    found = [np.asarray(affine) for affine, code in (sform, qform) if code]
    if not found:  # method 1 of the standard: the spacing alone; nibabel would guess a frame
        return StoredImage(values, np.diag([*header.get_zooms()[:3], 1.0]), "", _known(unit))
    agree = np.allclose(found[0], found[-1], atol=POSITION_TOL_SPACINGS * float(header.get_zooms()[0]))
    notes = () if agree else ("its two positions (sform and qform) differ, and the sform was taken",)
    return StoredImage(values, found[0], "RAS", _known(unit), notes=notes)


def read_nrrd(file: Path, choice: ImageChoice) -> StoredImage:
    """An NRRD file; axes without a direction in space number the volumes."""
    nrrd = import_extra("nrrd", "NRRD files", "images", "pynrrd")
    values, header = nrrd.read(str(file))
    axes = list(range(values.ndim))
    if values.ndim > 3:
        axes = _find_axes_of_space(header, values.ndim)
        others = [axis for axis in range(values.ndim) if axis not in axes]
        values = np.transpose(values, (*axes, *others)).reshape(*(values.shape[axis] for axis in axes), -1, order="F")
    affine = np.eye(4)
    if "space directions" in header:
        affine[:3, :3] = np.asarray(header["space directions"], float)[axes].T
    elif "spacings" in header:
        affine[:3, :3] = np.diag(np.asarray(header["spacings"], float)[axes])
    affine[:3, 3] = np.asarray(header.get("space origin", np.zeros(3)), float)
    space = str(header.get("space", ""))
    frame = NRRD_FRAMES.get(space.lower(), space)
    units_of_axes = [header["units"][axis] for axis in axes] if "units" in header else ()
    units = {_known(str(unit).strip('"')) for unit in header.get("space units", units_of_axes)} - {""}
    if len(units) > 1:
        raise InvalidRequest(f"{file.name} states several units of length, {', '.join(sorted(units))}: save it in one")
    words = header.get("centerings", header.get("centers", ()))
    centring = {str(words[axis]) for axis in axes} if len(words) else set()
    centred = True if centring == {"cell"} else False if centring == {"node"} else None
    ignored = [key for key in NRRD_IGNORED if key in header]
    notes = (
        (f"it states {', '.join(ignored)}, which are not read: give `spacing`, `origin` or `level` by them",)
        if ignored
        else ()
    )
    return StoredImage(values, affine, frame, "".join(units), centred, notes)


def _find_axes_of_space(header: Any, count: int) -> list[int]:
    """The three axes of several that have a direction, or a spacing, or are of the kind of space; else the first three."""
    for key in ("space directions", "spacings"):
        if key in header:
            rows = np.asarray(header[key], float).reshape(count, -1)
            found = np.flatnonzero(np.isfinite(rows).all(axis=1))
            if len(found) == 3:
                return [int(axis) for axis in found]
    kinds = [axis for axis, kind in enumerate(header.get("kinds", ())) if str(kind) in ("domain", "space")]
    return kinds if len(kinds) == 3 else [0, 1, 2]


def _known(unit: str) -> str:
    """A unit, or nothing for the words that say that it is unknown."""
    return "" if unit in ("unknown", "none", "???") else unit


def read_metaimage(file: Path, choice: ImageChoice) -> StoredImage:
    """A MetaImage file, of ITK, in LPS."""
    sitk = import_extra("SimpleITK", "MetaImage files", "images")
    image = sitk.ReadImage(str(file), imageIO="MetaImageIO")
    if image.GetNumberOfComponentsPerPixel() > 1:
        raise InvalidRequest(
            f"{file.name} holds {image.GetNumberOfComponentsPerPixel()} numbers for each voxel, not one"
        )
    values = np.transpose(sitk.GetArrayFromImage(image))
    with file.open("rb") as opened:
        head = opened.read(MAX_METAIMAGE_HEAD).partition(b"ElementDataFile")[0]
    stated = {name: float(number) for name, number in re.findall(METAIMAGE_SCALE, head, re.MULTILINE)}
    slope, offset = stated.get(b"Slope", 1.0), stated.get(b"Offset", 0.0)
    if (slope, offset) != (1.0, 0.0):
        values = slope * values + offset
    if values.ndim < 3:
        return StoredImage(values)
    return StoredImage(values.reshape(*values.shape[:3], -1) if values.ndim > 4 else values, _affine_of(image), "LPS")


def _affine_of(image: Any) -> Array:
    """The affine map (4, 4) of the first three axes of SimpleITK's image, from indices to positions."""
    dimension = image.GetDimension()
    direction = np.array(image.GetDirection()).reshape(dimension, dimension)[:3, :3]
    affine = np.eye(4)
    affine[:3, :3] = direction * image.GetSpacing()[:3]
    affine[:3, 3] = image.GetOrigin()[:3]
    return affine


def read_dicom(path: Path, choice: ImageChoice) -> StoredImage:
    """The slices of a series of DICOM files in a folder, or the frames of one file, in LPS.

    `choice.volume` numbers the series of a folder that holds several.
    """
    sitk = import_extra("SimpleITK", "DICOM files", "images")
    if path.is_file():
        image = _read_dicom_file(sitk, str(path))
        if image.GetSize()[2] == 1:
            raise InvalidRequest(f"{path.name} holds one slice: give the folder of its series")
        return StoredImage(np.transpose(sitk.GetArrayFromImage(image)), _affine_of(image), "LPS")
    series = sitk.ImageSeriesReader.GetGDCMSeriesIDs(str(path))
    if not series:
        raise InvalidRequest(f"the folder {path.name} holds no slices of DICOM, and no pictures (.tif)")
    number = select_volume(path.name, len(series), choice.volume, "series of DICOM") if len(series) > 1 else 0
    names = sitk.ImageSeriesReader.GetGDCMSeriesFileNames(str(path), series[number])
    slices = [_read_dicom_file(sitk, name) for name in names]
    told, is_chosen = (), len(series) > 1
    if is_chosen:
        told = (
            f"series {number} of {len(series)}, {_tag(slices[0], SERIES_DESCRIPTION) or 'which has no description'}",
        )
    values, affine = _stack_slices(path.name, sitk, slices)
    return StoredImage(values, affine, "LPS", notes=told, is_chosen=is_chosen)


def _read_dicom_file(sitk: Any, name: str) -> Any:
    reader = sitk.ImageFileReader()
    reader.SetImageIO("GDCMImageIO")
    reader.SetFileName(name)
    return reader.Execute()


def _tag(image: Any, tag: str) -> str:
    """The text of a tag, empty if there is none."""
    return str(image.GetMetaData(tag)).strip() if image.HasMetaDataKey(tag) else ""


def _stack_slices(name: str, sitk: Any, slices: list[Any]) -> tuple[Array, Array]:
    """Slices in the order of their positions along the normal, as (nx, ny, nz, n), and their affine map; of one file its frames.

    InvalidRequest if they differ in size, spacing or direction, or are not evenly spaced: one is missing, or of another series.
    """
    first = slices[0]
    affine = _affine_of(first)
    if len(slices) == 1:
        return np.transpose(sitk.GetArrayFromImage(first)), affine
    for image in slices:
        if image.GetSize() != first.GetSize() or not np.allclose(_affine_of(image)[:3, :2], affine[:3, :2], atol=1e-4):
            raise InvalidRequest(
                f"the slices in {name} differ in size, spacing or direction: {first.GetSize()[:2]} pixels of "
                f"{first.GetSpacing()[:2]} mm and {image.GetSize()[:2]} of {image.GetSpacing()[:2]}; keep one series"
            )
    normal = np.cross(affine[:3, 0], affine[:3, 1])
    normal /= np.linalg.norm(normal)
    height = np.array([normal @ image.GetOrigin() for image in slices])
    instance = np.array([int(_tag(image, INSTANCE_NUMBER) or 0) for image in slices])
    order = np.lexsort((instance, np.round(height, 3)))
    n_places = len(np.unique(np.round(height, 3)))
    repeats = len(slices) // n_places
    places = np.reshape(height[order][: n_places * repeats], (n_places, repeats))
    steps = np.diff(places[:, 0])
    if n_places * repeats != len(slices) or np.ptp(places, axis=1).max() > 1e-3 or n_places < 2:
        raise InvalidRequest(f"{len(slices)} slices in {name} lie at {n_places} positions: as many are needed at each")
    if np.ptp(steps) > POSITION_TOL_SPACINGS * np.median(steps):
        widest = int(steps.argmax())
        raise InvalidRequest(
            f"the slices in {name} are {steps.min():g} to {steps.max():g} mm apart, most between {places[widest, 0]:g} and "
            f"{places[widest + 1, 0]:g}: a slice is missing, or resample them evenly"
        )
    ends = np.array(slices[order[0]].GetOrigin()), np.array(slices[order[-1]].GetOrigin())
    affine[:3, 2] = (ends[1] - ends[0]) / (n_places - 1)
    affine[:3, 3] = ends[0]
    stacked = np.stack([np.transpose(sitk.GetArrayFromImage(slices[i]))[..., 0] for i in order], axis=-1)
    return stacked.reshape(*stacked.shape[:2], n_places, repeats), affine
