"""Volume images of files: arrays of samples with their spacing and position, whatever the format.

NumPy reads its own arrays and raw samples; the readers of all other formats come with the extra `tpmscad[images]`. Samples keep
the type of the file, because integers may be labels.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from tpmscad.errors import InvalidRequest
from tpmscad.fields.data.image_frames import Image, place_image
from tpmscad.fields.data.medical_images import read_dicom, read_metaimage, read_nifti, read_nrrd
from tpmscad.fields.data.microscope_images import (
    PICTURE_SUFFIXES,
    read_density_map,
    read_picture_folder,
    read_tiff,
)
from tpmscad.fields.data.stored_images import ImageChoice, StoredImage, select_name, select_volume
from tpmscad.fields.data.vtk_grids import read_vtk

RAW_NAME = re.compile(r"(\d+)x(\d+)x(\d+)_(u?int(?:8|16|32|64)|float(?:32|64))(_be)?(?=\.raw$)", re.IGNORECASE)
"""Shape, type and byte order in the name of a file of raw samples, as in the Open Scientific Visualization Datasets."""

RAW_EXAMPLE = "scan_256x256x128_uint16.raw"


def read_npy(file: Path, choice: ImageChoice) -> StoredImage:
    """An array that NumPy saved; its fourth axis, if it has one, numbers volumes."""
    return StoredImage(np.asarray(np.load(file, allow_pickle=False)))


def read_npz(file: Path, choice: ImageChoice) -> StoredImage:
    """The array of a name in an archive of NumPy, or the only one of three or four dimensions."""
    with np.load(file, allow_pickle=False) as archive:
        names = [name for name in archive.files if archive[name].ndim in (3, 4)]
        taken = select_name(file.name, names, choice.array_name)
        others = ", ".join(repr(name) for name in archive.files if name not in names)
        notes = (
            (f"its arrays {others} are not read: give `spacing` and `origin` if they state a place",) if others else ()
        )
        return StoredImage(np.asarray(archive[taken]), notes=notes)


def read_raw(file: Path, choice: ImageChoice) -> StoredImage:
    """Samples without a header, x fastest, whose shape and type stand in the name of the file."""
    found = RAW_NAME.search(file.name)
    if found is None:
        raise InvalidRequest(
            f"{file.name} does not say its shape and type: name it like {RAW_EXAMPLE} (x fastest; _be behind the type for "
            "big-endian numbers), or write a header .mhd beside it"
        )
    *shape, kind = (int(found[1]), int(found[2]), int(found[3]), np.dtype(found[4].lower()))
    needed, size = int(np.prod(shape)) * kind.itemsize, file.stat().st_size
    if needed != size:
        raise InvalidRequest(f"{file.name} has {size} bytes: its name says {shape} of {kind}, which are {needed} bytes")
    values = np.fromfile(file, kind.newbyteorder(">" if found[5] else "<"))
    return StoredImage(values.astype(kind).reshape(shape, order="F"))


READERS: dict[str, Callable[[Path, ImageChoice], StoredImage]] = {
    ".npy": read_npy,
    ".npz": read_npz,
    ".raw": read_raw,
    ".nrrd": read_nrrd,
    ".nhdr": read_nrrd,
    ".nii": read_nifti,
    ".nii.gz": read_nifti,
    ".mha": read_metaimage,
    ".mhd": read_metaimage,
    ".dcm": read_dicom,
    ".tif": read_tiff,
    ".tiff": read_tiff,
    ".mrc": read_density_map,
    ".map": read_density_map,
    ".vti": read_vtk,
    ".vtr": read_vtk,
    ".vts": read_vtk,
    ".vtu": read_vtk,
    ".vtk": read_vtk,
}
"""The reader of each suffix."""


def read_image(
    path: str | os.PathLike[str],
    *,
    frame: str | None = None,
    centred: bool | None = None,
    array_name: str | None = None,
    volume: int | None = None,
) -> Image:
    """The samples of a volume image; the suffix tells the format. InvalidRequest if the file is missing or unreadable.

    A folder holds slices: DICOM, or TIFF pictures. `frame` is one of FRAME. Where a file holds several, `centred` chooses between
    arrays of cells and of points, `array_name` one of several arrays and `volume` one of several volumes.
    """
    file = Path(path)
    name = file.name.lower()
    suffix = ".nii.gz" if name.endswith(".nii.gz") else file.suffix.lower()
    if not file.exists():
        if suffix not in READERS:
            raise InvalidRequest(_refuse_suffix(file))
        raise InvalidRequest(f"there is no file {file}")
    if file.is_dir():
        reader, suffix = _choose_folder_reader(file), "a folder of slices"
    elif suffix in READERS:
        reader = READERS[suffix]
    else:
        raise InvalidRequest(_refuse_suffix(file))
    try:
        stored = reader(file, ImageChoice(centred, array_name, volume))
    except InvalidRequest:
        raise
    except Exception as error:
        raise InvalidRequest(
            f"{file.name} cannot be read as {suffix}: it is damaged, or of another format ({type(error).__name__}); save it again"
        ) from error
    if stored.values.dtype.kind not in "biuf":
        kind = "complex numbers" if stored.values.dtype.kind == "c" else f"values of the type {stored.values.dtype}"
        raise InvalidRequest(
            f"{file.name} holds {kind}, where one real number for each voxel is needed: save one quantity of them"
        )
    count = stored.values.shape[3] if stored.values.ndim == 4 else 1
    number = select_volume(file.name, count, None if stored.is_chosen else volume)
    if stored.values.ndim == 4:
        told = (*stored.notes, f"volume {number} of {count}") if count > 1 else stored.notes
        stored = replace(stored, values=stored.values[..., number], notes=told)
    if stored.values.ndim != 3:
        raise InvalidRequest(
            f"{file.name} holds an array of shape {stored.values.shape}: three dimensions of one number each are needed; save a "
            "stack of them, or one of its parts"
        )
    return place_image(file.name, stored, frame)


def _refuse_suffix(file: Path) -> str:
    return f"{file.name} is no image that can be read: choose one of {', '.join(READERS)}, or a folder of slices"


def _choose_folder_reader(folder: Path) -> Callable[[Path, ImageChoice], StoredImage]:
    """The reader of a folder's slices: pictures, if it holds any, else DICOM, whose files may have any name."""
    has_pictures = any(file.suffix.lower() in PICTURE_SUFFIXES for file in folder.iterdir())
    return read_picture_folder if has_pictures else read_dicom
