"""Regions drawn as an image or a stack of images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import distance_transform_edt

from tpmscad._typing import Array
from tpmscad.errors import InvalidRequest
from tpmscad.fields import stencil
from tpmscad.fields.evaluation import FieldJet, Triple
from tpmscad.fields.field import Field


@dataclass(frozen=True, slots=True, eq=False)
class ImageRegion(Field):
    """Distances (nx, ny, nz) at the centers of pixels of size `pixel`, the first at `first`, interpolated linearly between them;
    beyond the outermost centers as at the nearest of them."""

    distances: Array
    first: Triple
    pixel: Triple

    def at(self, x: Array, y: Array, z: Array) -> Array:
        return stencil.contract_table(self.distances, self._stencils(x, y, z), (x, y, z))

    def jet(self, x: Array, y: Array, z: Array) -> FieldJet:
        return stencil.contract_table_jet(self.distances, self._stencils(x, y, z), (x, y, z))

    def _stencils(self, *coordinates: Array) -> list[stencil.Stencil]:
        return [
            _linear_stencil(t, count, first, pixel)
            for t, count, first, pixel in zip(coordinates, self.distances.shape, self.first, self.pixel, strict=True)
        ]


def image_region(mask: ArrayLike, lo: Sequence[float], hi: Sequence[float], *, axis: str = "z") -> ImageRegion:
    """The signed distance to the True pixels of a mask (nx, ny) or (nx, ny, nz) that covers the box from lo to hi.

    The first index runs along x. A picture read in rows from the top is `picture.T[:, ::-1]`. A mask of two dimensions is
    extruded along `axis`, and lo and hi have the two other coordinates. At pixel centers the sign is the mask's, exactly; the
    border runs half-way between pixels. Outside the picture its border pixels are continued.
    Raises InvalidRequest for a mask that is not boolean or all of one value.
    """
    array = np.asarray(mask)
    if array.dtype != bool:
        raise InvalidRequest(
            f"the mask holds {array.dtype}, not bool: compare the picture with a threshold, image < 128"
        )
    if array.ndim not in (2, 3) or array.size == 0:
        raise InvalidRequest(f"a mask of shape {array.shape}: two or three dimensions are needed")
    if array.all() or not array.any():
        raise InvalidRequest("the mask has one value only, so that no border and no distance exists")
    low, high = _as_corner(lo, array.ndim, "lo"), _as_corner(hi, array.ndim, "hi")
    if not (low < high).all():
        raise InvalidRequest(f"the image from {lo!r} to {hi!r} is empty: each lo must be below its hi")
    pixel = (high - low) / array.shape
    # distances are between pixel centers; the border is half a pixel off
    half = 0.5 * float(pixel.min())
    outside, inside = distance_transform_edt(~array, pixel), distance_transform_edt(array, pixel)
    distances: Any = np.where(array, half - inside, outside - half)
    first = low + pixel / 2
    if array.ndim == 2:
        if axis not in ("x", "y", "z"):
            raise InvalidRequest(f"axis {axis!r}: choose x, y or z")
        place = "xyz".index(axis)
        distances = np.expand_dims(distances, place)
        first, pixel = np.insert(first, place, 0.0), np.insert(pixel, place, 1.0)
    return ImageRegion(np.ascontiguousarray(distances), tuple(map(float, first)), tuple(map(float, pixel)))  # type: ignore[arg-type]


def _as_corner(value: Sequence[float], count: int, name: str) -> Array:
    corner = np.asarray(value, float)
    if corner.shape != (count,) or not np.isfinite(corner).all():
        raise InvalidRequest(f"{name} {value!r} must be {count} finite numbers for a mask of {count} dimensions")
    return corner


def _linear_stencil(t: Array, count: int, first: float, pixel: float) -> stencil.Stencil:
    if count == 1:
        entry = np.zeros(t.shape, np.int64)
        return stencil.Stencil([entry], [np.ones(t.shape)], [np.zeros(t.shape)])
    u = (t - first) / pixel
    clamped = np.minimum(np.maximum(u, 0.0), count - 1.0)
    base = np.minimum(np.floor(clamped), count - 2.0)
    r = clamped - base
    rate = np.where((u >= 0) & (u <= count - 1), 1.0 / pixel, 0.0)
    entry = base.astype(np.int64)
    return stencil.Stencil([entry, entry + 1], [1.0 - r, r], [-rate, rate])
