"""Volume images of files: arrays of samples with their spacing and position.

NumPy reads `.npy`; nibabel reads NIfTI, pynrrd NRRD and VTK its own formats. These three come with the extra `tpmscad[images]`.
Samples keep the type of the file, because integers may be labels.
"""

from __future__ import annotations

import importlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from tpmscad.errors import InvalidRequest
from tpmscad.fields.data.image_frames import Image, StoredImage, place_image

NRRD_FRAMES = {"right-anterior-superior": "RAS", "left-anterior-superior": "LAS", "left-posterior-superior": "LPS"}
NRRD_FRAMES |= {short.lower(): short for short in NRRD_FRAMES.values()}
"""Frames of the patient by the names of NRRD's field "space", in lower case."""

POSITION_TOL_SPACINGS = 1e-2
"""In spacings: difference of the two positions of a NIfTI file that rounding of its rotation explains."""


def read_image(path: str | os.PathLike[str], *, frame: str | None = None, centred: bool | None = None) -> Image:
    """The samples of a volume image; the suffix tells the format. InvalidRequest if the file is missing or unreadable.

    `frame` is one of FRAME; `centred` chooses between arrays of cells and of points where a file holds both.
    """
    file = Path(path)
    readers: dict[str, Callable[[Path], StoredImage]] = {
        ".npy": _read_npy,
        ".vti": lambda file: _read_vtk(file, centred),
        ".vtk": lambda file: _read_vtk(file, centred),
        ".nrrd": _read_nrrd,
        ".nhdr": _read_nrrd,
        ".nii": _read_nifti,
        ".nii.gz": _read_nifti,
    }
    suffix = ".nii.gz" if file.name.lower().endswith(".nii.gz") else file.suffix.lower()
    if suffix not in readers:
        raise InvalidRequest(f"{file.name} is no image that can be read: choose one of {', '.join(readers)}")
    if not file.is_file():
        raise InvalidRequest(f"there is no file {file}")
    try:
        stored = readers[suffix](file)
    except InvalidRequest:
        raise
    except Exception as error:
        raise InvalidRequest(f"{file.name} cannot be read as {suffix}: {type(error).__name__}: {error}") from error
    if stored.values.ndim != 3:
        raise InvalidRequest(
            f"{file.name} holds an array of shape {stored.values.shape}: three dimensions of one number each are needed"
        )
    return place_image(file.name, stored, frame)


def _load_reader(module: str, package: str) -> Any:
    """The module of an optional package; InvalidRequest says how to install it."""
    try:
        return importlib.import_module(module)
    except ImportError:
        raise InvalidRequest(f"reading this image needs {package}: pip install 'tpmscad[images]'") from None


def _read_npy(file: Path) -> StoredImage:
    return StoredImage(np.asarray(np.load(file, allow_pickle=False)))


def _read_nifti(file: Path) -> StoredImage:
    nibabel = _load_reader("nibabel", "nibabel")
    image = nibabel.load(file)
    header, values = image.header, np.asarray(image.dataobj)
    while values.ndim > 3 and values.shape[-1] == 1:
        values = values[..., 0]
    unit = header.get_xyzt_units()[0]
    sform, qform = image.get_sform(coded=True), image.get_qform(coded=True)
    found = [np.asarray(affine) for affine, code in (sform, qform) if code]
    if not found:  # method 1 of the standard: the spacing alone; nibabel would guess a frame
        return StoredImage(values, np.diag([*header.get_zooms()[:3], 1.0]), "", _known(unit))
    agree = np.allclose(found[0], found[-1], atol=POSITION_TOL_SPACINGS * float(header.get_zooms()[0]))
    notes = () if agree else ("its two positions (sform and qform) differ, and the sform was taken",)
    return StoredImage(values, found[0], "RAS", _known(unit), notes=notes)


def _read_nrrd(file: Path) -> StoredImage:
    nrrd = _load_reader("nrrd", "pynrrd")
    values, header = nrrd.read(str(file))
    affine = np.eye(4)
    if "space directions" in header:
        affine[:3, :3] = np.asarray(header["space directions"], float).T
    elif "spacings" in header:
        affine[:3, :3] = np.diag(np.asarray(header["spacings"], float))
    affine[:3, 3] = np.asarray(header.get("space origin", np.zeros(3)), float)
    space = str(header.get("space", ""))
    frame = NRRD_FRAMES.get(space.lower(), space)
    units = {_known(str(unit).strip('"')) for unit in header.get("space units", header.get("units", ()))} - {""}
    if len(units) > 1:
        raise InvalidRequest(f"{file.name} states several units of length, {', '.join(sorted(units))}: save it in one")
    centring = {str(word) for word in header.get("centerings", header.get("centers", ()))}
    centred = True if centring == {"cell"} else False if centring == {"node"} else None
    return StoredImage(values, affine, frame, "".join(units), centred)


def _known(unit: str) -> str:
    """A unit, or nothing for the words that say that it is unknown."""
    return "" if unit in ("unknown", "none", "???") else unit


def _read_vtk(file: Path, centred: bool | None) -> StoredImage:
    module, name = (
        ("vtkmodules.vtkIOXML", "vtkXMLImageDataReader")
        if file.suffix.lower() == ".vti"
        else ("vtkmodules.vtkIOLegacy", "vtkStructuredPointsReader")
    )
    reader = getattr(_load_reader(module, "vtk"), name)()
    to_numpy = _load_reader("vtkmodules.util.numpy_support", "vtk").vtk_to_numpy
    reader.SetFileName(str(file))
    reader.Update()
    data = reader.GetOutput()
    matrix = np.array([data.GetDirectionMatrix().GetElement(i, j) for i in range(3) for j in range(3)]).reshape(3, 3)
    matrix = matrix * data.GetSpacing()
    origin, shape = np.array(data.GetOrigin()), data.GetDimensions()
    both = data.GetPointData().GetNumberOfArrays() and data.GetCellData().GetNumberOfArrays()
    if both and centred is None:
        raise InvalidRequest(
            f"{file.name} holds values of points and of cells: give centred=True for those of cells, centred=False for the others"
        )
    of_cells = centred if both else not data.GetPointData().GetNumberOfArrays()
    scalars = _choose_array(file, data.GetCellData() if of_cells else data.GetPointData())
    if of_cells:  # the samples lie at the centres
        origin, shape = origin + matrix @ np.full(3, 0.5), tuple(n - 1 for n in shape)
    if scalars is None or scalars.GetNumberOfTuples() == 0:
        raise InvalidRequest(f"{file.name} holds no array of numbers on an image of three dimensions")
    values = np.asarray(to_numpy(scalars))
    affine = np.eye(4)
    affine[:3, :3], affine[:3, 3] = matrix, origin + matrix @ np.array(data.GetExtent()[::2])
    values = values.reshape(shape, order="F") if values.ndim == 1 else values
    return StoredImage(values, affine, centred=bool(of_cells))


def _choose_array(file: Path, attributes: Any) -> Any:
    """The active scalars of VTK's point or cell data, or its only array; None without arrays, InvalidRequest for several."""
    names = [attributes.GetArrayName(i) for i in range(attributes.GetNumberOfArrays())]
    if attributes.GetScalars() is None and len(names) > 1:
        raise InvalidRequest(
            f"{file.name} holds {len(names)} arrays, {', '.join(map(repr, names))}, none of them active: save the one that is "
            "meant alone, or mark it as the active scalars"
        )
    return attributes.GetScalars() or attributes.GetArray(0)
