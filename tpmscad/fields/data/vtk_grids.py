"""Images and meshes of VTK: grids of points or cells along the axes, however the file stores them.

Results of topology optimisation and of simulations are often meshes of equal bricks. Their values are put on the grid that the
points, or the centres of the cells, lie on; where the mesh has none, as outside an L-shaped domain, the value is NaN.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from tpmscad._lazy_import import import_extra
from tpmscad._typing import Array
from tpmscad.errors import InvalidRequest
from tpmscad.fields.data.stored_images import POSITION_TOL_SPACINGS, ImageChoice, StoredImage, select_name

BRICKS = {11: "voxels", 12: "hexahedra", 25: "hexahedra", 29: "hexahedra", 33: "hexahedra", 72: "hexahedra"}
"""VTK's types of cells that may fill a uniform grid."""

GHOST_ARRAY = "vtkGhostType"

MAX_EMPTY_SHARE = 64
"""Places of a grid for each value: points that lie on no grid have as many coordinates as points along each axis."""

SAME_COORDINATE = 1e-6
"""Of the extent: coordinates closer than this are those of one grid plane."""


def read_vtk(file: Path, choice: ImageChoice) -> StoredImage:
    """Values of points or cells on a uniform grid: of an image, a rectilinear or structured grid, or a mesh of bricks."""
    data = _read_data_set(file, choice)
    attributes = {False: data.GetPointData(), True: data.GetCellData()}
    names = {of_cells: _list_arrays(each) for of_cells, each in attributes.items()}
    holding = [of_cells for of_cells, known in names.items() if known and choice.array_name in (None, *known)]
    if len(holding) > 1 and choice.centred is None:
        raise InvalidRequest(
            f"{file.name} holds values of points and of cells: give centred=True for those of cells, centred=False for the others"
        )
    of_cells = choice.centred if len(holding) > 1 else holding[0] if holding else bool(names[True])
    scalars, notes = _choose_array(file, attributes[bool(of_cells)], names[bool(of_cells)], choice.array_name)
    if scalars is None or scalars.GetNumberOfTuples() == 0:
        raise InvalidRequest(f"{file.name} holds no array of numbers on an image of three dimensions")
    values = np.asarray(_load_vtk("util.numpy_support").vtk_to_numpy(scalars))
    if values.ndim > 1:
        raise InvalidRequest(
            f"the array {scalars.GetName()!r} of {file.name} holds {values.shape[1]} numbers at each place, where one is needed: "
            "save one component, or the magnitude"
        )
    if data.IsA("vtkImageData"):
        return _place_image_data(data, values, bool(of_cells), notes)
    return _place_on_grid(file, data, values, bool(of_cells), notes)


def _read_data_set(file: Path, choice: ImageChoice) -> Any:
    """VTK's data set of a file; InvalidRequest if it holds none."""
    if file.suffix.lower() == ".vtk":
        reader = _load_vtk("vtkIOLegacy").vtkGenericDataObjectReader()
        if choice.array_name is not None:
            reader.ReadAllScalarsOn()
    else:
        reader = _load_vtk("vtkIOXML").vtkXMLGenericDataObjectReader()
    reader.SetFileName(str(file))
    reader.Update()
    data = reader.GetOutput()
    if data is None or not data.IsA("vtkDataSet"):
        raise InvalidRequest(f"{file.name} holds no array of numbers on a grid or mesh that VTK can read")
    return data


def _load_vtk(module: str) -> Any:
    """A module of VTK."""
    return import_extra(f"vtkmodules.{module}", "grids and meshes of VTK", "images", "vtk")


def _list_arrays(attributes: Any) -> list[str]:
    """The names of arrays of numbers, those without a name by their place."""
    arrays = (attributes.GetArray(i) for i in range(attributes.GetNumberOfArrays()))
    names = [array.GetName() or "" for array in arrays if array is not None]
    return [name for name in names if name != GHOST_ARRAY]


def _choose_array(file: Path, attributes: Any, names: list[str], wanted: str | None) -> tuple[Any, tuple[str, ...]]:
    """The array that is wanted, the active scalars or the only array, and a note if others were left; None without any."""
    if not names:
        return None, ()
    active = attributes.GetScalars()
    if wanted is None and active is not None:
        name = active.GetName() or ""
    else:
        name, active = select_name(file.name, names, wanted), None
    others = ", ".join(repr(other) for other in names if other != name)
    notes = (f"array {name!r} was taken; `array_name` takes another: {others}",) if others and wanted is None else ()
    return active or attributes.GetArray(name) or attributes.GetArray(0), notes


def _place_image_data(data: Any, values: Array, of_cells: bool, notes: tuple[str, ...]) -> StoredImage:
    """The samples of VTK's image, at the centres of its cells or at its points."""
    matrix = np.array([data.GetDirectionMatrix().GetElement(i, j) for i in range(3) for j in range(3)]).reshape(3, 3)
    matrix = matrix * data.GetSpacing()
    origin, shape = np.array(data.GetOrigin()), data.GetDimensions()
    if of_cells:
        origin, shape = origin + matrix @ np.full(3, 0.5), tuple(n - 1 for n in shape)
    affine = np.eye(4)
    affine[:3, :3], affine[:3, 3] = matrix, origin + matrix @ np.array(data.GetExtent()[::2])
    values = values.reshape(shape, order="F")
    return StoredImage(values, affine, centred=of_cells, notes=notes)


def _place_on_grid(file: Path, data: Any, values: Array, of_cells: bool, notes: tuple[str, ...]) -> StoredImage:
    """The values of a mesh on the uniform grid of its points or of the centres of its cells, NaN where it has none."""
    if of_cells:
        kinds = {data.GetCellType(i) for i in range(data.GetNumberOfCells())}
        if not kinds <= BRICKS.keys():
            raise InvalidRequest(
                f"the cells of {file.name} are no bricks (VTK's types {sorted(kinds - BRICKS.keys())}): resample the mesh to an "
                "image, or give the values at points, fields.scattered"
            )
        centres = _load_vtk("vtkFiltersCore").vtkCellCenters()
        centres.SetInputData(data)
        centres.Update()
        source = centres.GetOutput()
    else:
        source = data
    places = np.array([source.GetPoint(i) for i in range(source.GetNumberOfPoints())])
    first, spacing, index = _find_grid(file.name, places, _find_bounds(data), of_cells)
    shape = tuple(int(n) + 1 for n in index.max(axis=0))
    flat = np.ravel_multi_index(tuple(index.T), shape)
    if len(np.unique(flat)) < len(flat):
        raise InvalidRequest(f"{file.name} holds several values at one place of its grid of {shape}")
    whole = len(flat) == np.prod(shape)
    filled = np.full(int(np.prod(shape)), 0 if whole else np.nan, values.dtype if whole else float)
    filled[flat] = values
    affine = np.diag([*spacing, 1.0])
    affine[:3, 3] = first
    return StoredImage(filled.reshape(shape), affine, centred=of_cells, notes=notes)


def _find_bounds(data: Any) -> Array:
    """The box (3, 2) of the cells of a data set; a mesh may hold points that belong to none."""
    if not data.IsA("vtkUnstructuredGrid") or not data.GetNumberOfCells():
        return np.reshape(data.GetBounds(), (3, 2))
    to_numpy = _load_vtk("util.numpy_support").vtk_to_numpy
    used = to_numpy(data.GetPoints().GetData())[np.unique(to_numpy(data.GetCells().GetConnectivityArray()))]
    return np.stack([used.min(axis=0), used.max(axis=0)], axis=1)


def _find_grid(name: str, places: Array, bounds: Array, of_cells: bool) -> tuple[Array, Array, Array]:
    """The first place (3,), the spacing (3,) and the indices (n, 3) of places (n, 3) on a uniform grid along the axes.

    `bounds` (3, 2) is the box of the mesh. InvalidRequest if there is no such grid, or its cells do not fill the box.
    """
    first, spacing = places.min(axis=0), np.ones(3)
    for axis in range(3):
        planes = np.unique(places[:, axis])
        steps = np.diff(planes)
        steps = steps[steps > SAME_COORDINATE * np.ptp(bounds, axis=1).max()]
        if len(steps):
            spacing[axis] = steps.min()
            spacing[axis] = np.ptp(planes) / np.rint(np.ptp(planes) / spacing[axis])
        elif of_cells:  # one layer
            spacing[axis] = np.ptp(bounds[axis])
    steps = (places - first) / spacing
    index = np.rint(steps).astype(int)
    off = float(np.abs(steps - index).max())
    share = float(np.prod(index.max(axis=0) + 1.0)) / len(places)
    if off > POSITION_TOL_SPACINGS or share > MAX_EMPTY_SHARE:
        what = "centres of the cells" if of_cells else "points"
        raise InvalidRequest(
            f"the {what} of {name} lie on no uniform grid along x, y and z (up to {off:.2g} spacings off): resample the mesh to "
            "an image, or give the values at points, fields.scattered"
        )
    if of_cells:
        ends = np.stack([first - spacing / 2, places.max(axis=0) + spacing / 2], axis=1)
        if np.abs(ends - bounds).max() > POSITION_TOL_SPACINGS * spacing.min():
            raise InvalidRequest(
                f"the cells of {name} differ in size: their centres are {spacing.tolist()} apart, but the mesh reaches from "
                f"{bounds[:, 0].tolist()} to {bounds[:, 1].tolist()}; resample it to an image"
            )
    return first, spacing, index
