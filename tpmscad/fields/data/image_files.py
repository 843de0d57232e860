"""Volume images of files: arrays of samples with their spacing and position.

NumPy reads `.npy`; nibabel reads NIfTI, pynrrd NRRD and VTK its own formats. These three come with the extra `tpmscad[images]`.
Images whose axes are turned against x, y and z are refused, because a uniform grid along the axes could not hold them unchanged.
"""

from __future__ import annotations

import importlib
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tpmscad._typing import Array
from tpmscad.errors import InvalidRequest
from tpmscad.fields.tape.evaluation import Triple

AXIS_ALIGNMENT_TOL = 1e-4
"""Largest cosine between an image's axis and another coordinate axis: headers store directions in single precision."""


@dataclass(frozen=True, slots=True, eq=False)
class Image:
    """Samples (nx, ny, nz), their spacing and the position of the first, in the units of the file; None where it has none."""

    values: Array
    spacing: Triple | None
    origin: Triple | None


def read_image(path: str | os.PathLike[str]) -> Image:
    """The samples of a volume image; the suffix tells the format. InvalidRequest if the file is missing or unreadable."""
    file = Path(path)
    readers: dict[str, Callable[[Path], Image]] = {
        ".npy": _read_npy,
        ".vti": _read_vtk,
        ".vtk": _read_vtk,
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
        image = readers[suffix](file)
    except InvalidRequest:
        raise
    except Exception as error:
        raise InvalidRequest(f"{file.name} cannot be read as {suffix}: {type(error).__name__}: {error}") from error
    if image.values.ndim != 3:
        raise InvalidRequest(
            f"{file.name} holds an array of shape {image.values.shape}: three dimensions of one number each are needed"
        )
    return image


def _load_reader(module: str, package: str) -> Any:
    """The module of an optional package; InvalidRequest says how to install it."""
    try:
        return importlib.import_module(module)
    except ImportError:
        raise InvalidRequest(f"reading this image needs {package}: pip install 'tpmscad[images]'") from None


def _read_npy(file: Path) -> Image:
    return Image(np.asarray(np.load(file, allow_pickle=False), float), None, None)


def _read_nifti(file: Path) -> Image:
    nibabel = _load_reader("nibabel", "nibabel")
    image = nibabel.load(file)
    values = np.asarray(image.get_fdata(), float)
    return _align_with_axes(file, values.reshape([n for n in values.shape if n > 1] or [1]), np.asarray(image.affine))


def _read_nrrd(file: Path) -> Image:
    nrrd = _load_reader("nrrd", "pynrrd")
    values, header = nrrd.read(str(file))
    affine = np.eye(4)
    if "space directions" in header:
        affine[:3, :3] = np.asarray(header["space directions"], float).T
    elif "spacings" in header:
        affine[:3, :3] = np.diag(np.asarray(header["spacings"], float))
    affine[:3, 3] = np.asarray(header.get("space origin", np.zeros(3)), float)
    return _align_with_axes(file, np.asarray(values, float), affine)


def _read_vtk(file: Path) -> Image:
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
    spacing, origin, shape = np.array(data.GetSpacing()), np.array(data.GetOrigin()), data.GetDimensions()
    scalars = _choose_array(file, data.GetPointData())
    if scalars is None:  # values of voxels: samples lie at the centres
        scalars = _choose_array(file, data.GetCellData())
        origin, shape = origin + spacing / 2, tuple(n - 1 for n in shape)
    if scalars is None or scalars.GetNumberOfTuples() == 0:
        raise InvalidRequest(f"{file.name} holds no array of numbers on an image of three dimensions")
    first = np.array(data.GetExtent()[::2])
    values = np.asarray(to_numpy(scalars), float)
    affine = np.diag([*spacing, 1.0])
    affine[:3, 3] = origin + first * spacing
    return _align_with_axes(file, values.reshape(shape, order="F") if values.ndim == 1 else values, affine)


def _choose_array(file: Path, attributes: Any) -> Any:
    """The active scalars of VTK's point or cell data, or its only array; None without arrays, InvalidRequest for several."""
    names = [attributes.GetArrayName(i) for i in range(attributes.GetNumberOfArrays())]
    if attributes.GetScalars() is None and len(names) > 1:
        raise InvalidRequest(
            f"{file.name} holds {len(names)} arrays, {', '.join(map(repr, names))}, none of them active: save the one that is "
            "meant alone, or mark it as the active scalars"
        )
    return attributes.GetScalars() or attributes.GetArray(0)


def _align_with_axes(file: Path, values: Array, affine: Array) -> Image:
    """The image with its axes in the order and direction of x, y and z; `affine` (4, 4) takes indices to positions."""
    if values.ndim != 3:
        return Image(values, None, None)
    matrix, origin = affine[:3, :3], affine[:3, 3].astype(float)
    lengths = np.linalg.norm(matrix, axis=0)
    if not (np.isfinite(affine).all() and (lengths > 0).all()):
        raise InvalidRequest(f"{file.name} states a spacing of {lengths.tolist()}, which must be positive")
    cosines = np.abs(matrix / lengths)
    order = cosines.argmax(axis=0)
    off_axis = np.sort(cosines, axis=0)[1].max()
    if sorted(order.tolist()) != [0, 1, 2] or off_axis > AXIS_ALIGNMENT_TOL:
        raise InvalidRequest(
            f"the axes of {file.name} are turned against x, y and z (cosine {off_axis:.3g}): resample the image along the axes "
            "first, or give its array alone (.npy) and rotate the field"
        )
    for axis in range(3):
        if matrix[order[axis], axis] < 0:
            origin = origin + matrix[:, axis] * (values.shape[axis] - 1)
            values = np.flip(values, axis)
    inverse = np.argsort(order)
    spacing = lengths[inverse]
    return Image(
        np.ascontiguousarray(np.transpose(values, inverse)),
        (float(spacing[0]), float(spacing[1]), float(spacing[2])),
        (float(origin[0]), float(origin[1]), float(origin[2])),
    )
