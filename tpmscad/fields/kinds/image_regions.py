"""Regions given by an image or a stack of images, as interpolated signed distances."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import distance_transform_edt

from tpmscad._typing import Array
from tpmscad.api.argument_kinds import choice_of
from tpmscad.api.public_calls import validate_call
from tpmscad.api.shared_kinds import MASK, PAIR_OR_TRIPLE
from tpmscad.errors import InvalidRequest
from tpmscad.fields.field import Field
from tpmscad.fields.tape.evaluation import Triple
from tpmscad.fields.tape.tape_nodes import Node, clamp, tensor_spline


@dataclass(frozen=True, slots=True, eq=False)
class ImageRegion(Field):
    """Trilinear interpolation of distances (nx, ny, nz) at pixel centers, constant beyond the outermost centers.

    The center of pixel (0, 0, 0) is `first`, the pixel size is `pixel`, both in model units.
    """

    distances: Array
    first: Triple
    pixel: Triple
    notes: tuple[str, ...] = ("an image region ends halfway between pixels: the deviation is that from its steps",)

    def trace(self, x: Node, y: Node, z: Node) -> Node:
        """The formula on the nodes of a tape."""
        counts = self.distances.shape
        steps = [
            clamp((t - first) / pixel, 0.0, n - 1.0)
            for t, n, first, pixel in zip((x, y, z), counts, self.first, self.pixel, strict=True)
        ]
        degrees = [min(1, n - 1) for n in counts]  # an axis of one pixel is one of extrusion
        knots = [np.pad(np.arange(max(n, 2.0)), degree, mode="edge") for n, degree in zip(counts, degrees, strict=True)]
        return tensor_spline(knots, degrees, self.distances, (steps[0], steps[1], steps[2]))


@validate_call()
def image_region(
    mask: Annotated[
        ArrayLike, MASK, "The first index runs along x. A picture stored in rows from the top is `picture.T[:, ::-1]`."
    ],
    lo: Annotated[
        Sequence[float],
        PAIR_OR_TRIPLE,
        "Corners of the box that the mask covers, in model units; two coordinates for a mask of two dimensions.",
    ],
    hi: Annotated[Sequence[float], PAIR_OR_TRIPLE.described_as(example="(20, 20)"), "As `lo`."],
    *,
    axis: Annotated[str, choice_of("x", "y", "z"), "Direction along which a mask of two dimensions is extruded."] = "z",
) -> ImageRegion:
    """Return the region of the True pixels of a mask.

    Returns
    -------
    ImageRegion
        The signed distance to the border, negative in the True pixels. At pixel centers its sign is that of the mask exactly;
        the border lies halfway between pixels. Outside the box the border pixels are continued.

    Raises
    ------
    InvalidRequest
        If the mask is not boolean, has one value only, or the box is empty.

    Notes
    -----
    Exact Euclidean distance transform between pixel centers (scipy.ndimage.distance_transform_edt), shifted by half a pixel. It
    follows the steps of the pixels, for regions and bands. For a solid with smooth sides take the mask as a label, of one layer:
    ``fields.labels(mask[:, :, None], (dx, dy, height), (dx / 2, dy / 2, height / 2))``.

    Examples
    --------
    >>> import numpy as np
    >>> from tpmscad import fields
    >>> picture = np.array([[0, 200], [0, 200]])
    >>> region = fields.image_region(picture < 128, (0, 0), (20, 20))
    >>> float(region((10.0, 5.0, 0.0))), float(region((10.0, 15.0, 0.0)))
    (-5.0, 5.0)
    """
    array = np.asarray(mask)
    if array.ndim not in (2, 3) or array.size == 0:
        raise InvalidRequest(
            f"a mask of shape {array.shape}: give an array of two or three dimensions that is not empty"
        )
    if array.all() or not array.any():
        raise InvalidRequest("the mask has one value only, so that no border and no distance exists")
    low, high = _as_corner(lo, array.ndim, "lo"), _as_corner(hi, array.ndim, "hi")
    if not (low < high).all():
        raise InvalidRequest(f"the image from {lo!r} to {hi!r} is empty: each lo must be below its hi")
    pixel = (high - low) / array.shape
    # distances are measured between pixel centers, and the border is half a pixel from them
    half = 0.5 * float(pixel.min())
    outside, inside = distance_transform_edt(~array, pixel), distance_transform_edt(array, pixel)
    distances: Any = np.where(array, half - inside, outside - half)
    first = low + pixel / 2
    if array.ndim == 2:
        extruded = "xyz".index(axis)
        distances = np.expand_dims(distances, extruded)
        first, pixel = np.insert(first, extruded, 0.0), np.insert(pixel, extruded, 1.0)
    return ImageRegion(np.ascontiguousarray(distances), tuple(map(float, first)), tuple(map(float, pixel)))  # type: ignore[arg-type]


def _as_corner(value: Sequence[float], count: int, name: str) -> Array:
    corner = np.asarray(value, float)
    if corner.shape != (count,) or not np.isfinite(corner).all():
        raise InvalidRequest(f"{name} {value!r} must be {count} finite numbers for a mask of {count} dimensions")
    return corner
