"""Images of microscopes and tomographs: stacks of TIFF pages by tifffile, density maps (MRC, CCP4) by mrcfile."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from tpmscad._lazy_import import import_extra
from tpmscad._typing import Array
from tpmscad.errors import InvalidRequest
from tpmscad.fields.data.stored_images import MILLIMETRES, ImageChoice, StoredImage, select_volume

PICTURE_SUFFIXES = (".tif", ".tiff")
"""Pictures that make a stack in a folder."""

DEFAULT_OME_UNIT = "µm"
"""Unit of length of OME-XML where it states none."""


def read_tiff(file: Path, choice: ImageChoice) -> StoredImage:
    """A stack of TIFF pages: x along the rows, y down the columns, z from page to page; spacing of ImageJ or OME-XML."""
    tifffile = import_extra("tifffile", "TIFF pictures", "images")
    with tifffile.TiffFile(file) as tif:
        stacks = [series for series in tif.series if series.ndim > 2] or _join_pictures(file.name, tif.series)
        is_chosen = len(stacks) > 1
        number = select_volume(file.name, len(stacks), choice.volume, "stacks of pictures") if is_chosen else 0
        first = stacks[number]
        series = first[0] if isinstance(first, list) else first
        told = f"stack {number} of {len(stacks)} was taken" if is_chosen else ""
        if isinstance(first, list):
            values, axes = np.stack([each.asarray() for each in first]), f"Z{series.axes}"
        else:
            values, axes = series.asarray(), series.axes
            if len(stacks) < len(tif.series):
                told += (
                    f"{'; ' * is_chosen}{len(tif.series) - len(stacks)} single pictures beside its stacks were left out"
                )
        spacing, unit = _read_spacing(tif, series.keyframe)
    notes = (told,) if told else ()
    return StoredImage(
        _order_axes(file.name, values, axes), _scaling(spacing), "", unit, notes=notes, is_chosen=is_chosen
    )


def _join_pictures(name: str, series: Sequence[Any]) -> list[Any]:
    """The series of single pictures of one size as one stack; InvalidRequest if they differ. One picture is itself."""
    shapes = {tuple(each.shape): sum(other.shape == each.shape for other in series) for each in series}
    if len(shapes) > 1:
        listed = ", ".join(f"{count} of {' x '.join(map(str, shape))}" for shape, count in shapes.items())
        raise InvalidRequest(
            f"{name} holds pictures of several sizes, {listed} pixels, and no stack: save those of one size alone"
        )
    return [list(series)] if len(series) > 1 else list(series)


def _order_axes(name: str, values: Array, axes: str) -> Array:
    """Samples with the axes x, y, z, and volumes last if there are more; `axes` are their letters in the file."""
    if values.ndim < 3:  # one picture
        return values
    if "S" in axes:
        raise InvalidRequest(f"{name} holds {values.shape[axes.index('S')]} colours for each pixel: save it in grey")
    others = [i for i, letter in enumerate(axes) if letter not in "XY"]
    heights = [i for i in others if axes[i] in "ZIQ"] or others[-1:]  # a stack may be saved as times or channels
    z = heights[0]
    others.remove(z)
    ordered = np.transpose(values, (axes.index("X"), axes.index("Y"), z, *others))
    return ordered.reshape(*ordered.shape[:3], -1) if others else ordered


def _read_spacing(tif: Any, page: Any) -> tuple[Sequence[float] | None, str]:
    """The spacing along x, y, z and its unit by OME-XML or ImageJ; resolutions of other programs are those of prints."""
    if tif.is_ome:
        pixels = next((e for e in ElementTree.fromstring(tif.ome_metadata).iter() if e.tag.endswith("Pixels")), None)
        sizes = [float(pixels.get(f"PhysicalSize{axis}", 0)) for axis in "XYZ"] if pixels is not None else [0.0]
        if pixels is None or min(sizes) <= 0:
            return None, ""
        units = [pixels.get(f"PhysicalSize{axis}Unit", DEFAULT_OME_UNIT) for axis in "XYZ"]
        if len(set(units)) == 1:
            return sizes, units[0]
        if set(units) - MILLIMETRES.keys():
            raise InvalidRequest(
                f"{Path(tif.filename).name} states pixels in {', '.join(units)}: save it in one unit of length"
            )
        return [size * MILLIMETRES[unit] for size, unit in zip(sizes, units, strict=True)], "mm"
    stated = tif.imagej_metadata or {}
    resolutions = [page.tags.get(f"{axis}Resolution") for axis in "XY"]
    if not float(stated.get("spacing", 0)) or None in resolutions or not all(tag.value[0] for tag in resolutions):
        return None, ""
    x, y = (tag.value[1] / tag.value[0] for tag in resolutions)
    unit = str(stated.get("unit", "")).replace("\\u00B5", "µ")
    return (None, "") if unit.startswith("pixel") else ((x, y, float(stated["spacing"])), unit)


def _scaling(spacing: Sequence[float] | None) -> Array | None:
    return None if spacing is None else np.diag([*spacing, 1.0])


def read_picture_folder(folder: Path, choice: ImageChoice) -> StoredImage:
    """The TIFF pictures of a folder, one page each, stacked along z in the order of the numbers in their names."""
    tifffile = import_extra("tifffile", "TIFF pictures", "images")
    files = sorted((f for f in folder.iterdir() if f.suffix.lower() in PICTURE_SUFFIXES), key=_numbers_in_name)
    pictures = [tifffile.imread(file) for file in files]
    for file, picture in zip(files, pictures, strict=True):
        if picture.ndim != 2:
            raise InvalidRequest(
                f"{file.name} in {folder.name} is no slice, its shape is {picture.shape}: name the file itself if it is a stack"
            )
        if picture.shape != pictures[0].shape:
            raise InvalidRequest(
                f"{file.name} in {folder.name} has the shape {picture.shape}, {files[0].name} {pictures[0].shape}: slices are "
                "pictures of one size"
            )
    return StoredImage(
        np.transpose(np.stack(pictures)), notes=(f"{len(files)} pictures, {files[0].name} to {files[-1].name}",)
    )


def _numbers_in_name(file: Path) -> list[Any]:
    """A key that sorts slice2 before slice10."""
    return [(part.isdigit(), int(part) if part.isdigit() else part) for part in re.split(r"(\d+)", file.name)]


def read_density_map(file: Path, choice: ImageChoice) -> StoredImage:
    """A density map of electron microscopy or crystallography; its lengths, in angstrom, are not converted."""
    mrcfile = import_extra("mrcfile", "density maps", "images")
    with mrcfile.open(file) as found:
        header, values = found.header, np.array(found.data)
        voxel = np.array([float(found.voxel_size[axis]) for axis in "xyz"])
        order = [int(header[name]) - 1 for name in ("mapc", "mapr", "maps")]
        start = np.zeros(3)
        start[order] = [int(header[name]) for name in ("nxstart", "nystart", "nzstart")]
        origin = np.array([float(header.origin[axis]) for axis in "xyz"])
    values = np.moveaxis(np.transpose(values), 3, -1) if values.ndim == 4 else np.transpose(values)
    if sorted(order) != [0, 1, 2]:
        raise InvalidRequest(f"{file.name} states the axes {[i + 1 for i in order]}, which must be 1, 2 and 3")
    if not (voxel > 0).all():
        return StoredImage(values, notes=("it states no size of a voxel",))
    affine = np.zeros((4, 4))
    affine[order, range(3)] = voxel[order]
    affine[:, 3] = [*(origin if origin.any() else start * voxel), 1.0]
    return StoredImage(values, affine, notes=("lengths in angstrom, of which 1 is taken as 1 mm: scale the result",))
