"""Frames and units of volume images: from the coordinates that a file states to those of the model, in mm.

A medical image states a frame of the patient, named by the directions in which x, y and z increase. The model is in RAS: x to the
right, y anterior, z superior, as NIfTI has it; DICOM, ITK and most NRRD files are in LPS, with x and y the other way round.
Samples of images whose axes are turned against x, y and z stay on their grid, whose directions are told: the field is turned.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from tpmscad._typing import Array, triple
from tpmscad.api.argument_kinds import choice_of
from tpmscad.errors import InvalidRequest
from tpmscad.fields.data.stored_images import MILLIMETRES, StoredImage
from tpmscad.fields.tape.evaluation import Triple

FRAME_SIGNS = {"RAS": (1.0, 1.0, 1.0), "LAS": (-1.0, 1.0, 1.0), "LPS": (-1.0, -1.0, 1.0)}
"""Directions of x, y and z of a patient's frame as multiples of right, anterior and superior."""

FRAME = choice_of("RAS", "LPS", "file")
"""The frames of a result: two of the patient, and that of the file as it is."""

FRAME_MEANING = (
    "Frame of the result. An image that states a frame of the patient is converted to RAS by default (x to the right, y "
    "anterior, z superior), or to LPS; ``file`` keeps the coordinates of the file."
)

AXIS_ALIGNMENT_TOL = 1e-4
"""Largest cosine between an image's axis and another coordinate axis, up to which it is along its own: headers store directions
in single precision."""

LEAST_SPREAD = 1e-3
"""Volume of the cell of an image's unit axes, below which they lie in one plane."""


@dataclass(frozen=True, slots=True, eq=False)
class Image:
    """Samples (nx, ny, nz), their spacing and the position of the first, model units; None where the file has none.

    `directions` (3, 3): the unit vectors along the axes of the samples, its columns; None if they are x, y and z.
    `centred`: whether the samples belong to cells (True) or points (False), None if the file does not say. `notes` tell how
    frame and unit were read.
    """

    values: Array
    spacing: Triple | None = None
    origin: Triple | None = None
    centred: bool | None = None
    notes: tuple[str, ...] = ()
    directions: Array | None = None


def place_image(name: str, stored: StoredImage, frame: str | None) -> Image:
    """The image of the file `name` in a frame and in mm, with its axes in the order and direction of x, y and z."""
    signs, told = _convert_frame(name, stored.frame, frame)
    scale = MILLIMETRES.get(stored.unit.lower(), 1.0)
    notes = [told, *(f"{name}: {note}" for note in stored.notes)]
    if stored.unit and stored.unit.lower() not in MILLIMETRES:
        notes.append(f"{name}: its unit of length, {stored.unit!r}, is unknown; its numbers are taken as mm")
    elif scale != 1.0:
        notes.append(f"{name}: lengths in {stored.unit} were converted to mm")
    if stored.affine is None or stored.values.ndim != 3:
        return Image(stored.values, centred=stored.centred, notes=tuple(notes))
    affine = np.diag([*(scale * signs), 1.0]) @ stored.affine
    values, spacing, origin, directions = _align_with_axes(name, stored.values, affine)
    if directions is not None:
        turn = np.degrees(np.arccos(np.clip(np.abs(np.diag(directions)).min(), 0.0, 1.0)))
        notes.append(
            f"{name}: its axes are turned by up to {turn:.4g} degrees against x, y and z; the field is turned, and not resampled"
        )
    return Image(values, spacing, origin, stored.centred, tuple(notes), directions)


def _convert_frame(name: str, stated: str, wanted: str | None) -> tuple[Array, str]:
    """The factors of x, y and z that take the stated frame to the wanted one, and a note; InvalidRequest if there are none."""
    keeps = np.ones(3)
    if wanted == "file":
        return keeps, f"{name}: frame as in the file, {stated or 'which states none'}"
    if stated in FRAME_SIGNS:
        target = wanted or "RAS"
        signs = np.multiply(FRAME_SIGNS[stated], FRAME_SIGNS[target])
        reversed_axes = " and ".join(axis for axis, sign in zip("xyz", signs, strict=True) if sign < 0)
        done = f"{stated} converted to {target}, {reversed_axes} reversed" if reversed_axes else stated
        return signs, f"{name}: frame {done}"
    if "left-handed" in stated:
        raise InvalidRequest(
            f"{name} states {stated} coordinates, in which the model would be its mirror image: give frame='file' to take them "
            "as they are, or save the image in RAS or LPS"
        )
    if wanted is not None:
        raise InvalidRequest(
            f"{name} states {stated or 'no frame'}, from which nothing can be converted to {wanted}: leave `frame` out"
        )
    return keeps, f"{name}: no frame stated{f' ({stated})' if stated else ''}; coordinates as in the file"


def _align_with_axes(name: str, values: Array, affine: Array) -> tuple[Array, Triple, Triple, Array | None]:
    """The samples with their axes in the order and direction of x, y and z, their spacing, and the position of the first.

    Of axes that are turned against x, y and z, the nearest; the last result are then their directions, as of an `Image`.
    """
    matrix, origin = affine[:3, :3], affine[:3, 3].astype(float)
    lengths = np.linalg.norm(matrix, axis=0)
    if not (np.isfinite(affine).all() and (lengths > 0).all()):
        raise InvalidRequest(f"{name} states a spacing of {lengths.tolist()}, which must be positive")
    directions = matrix / lengths
    if abs(np.linalg.det(directions)) < LEAST_SPREAD:
        raise InvalidRequest(
            f"the axes of {name} lie in one plane: {directions.T.round(4).tolist()}; save the image again"
        )
    order = linear_sum_assignment(-np.abs(directions.T))[1]
    along = np.zeros((3, 3), bool)
    along[order, np.arange(3)] = True
    off_axis = np.abs(directions[~along]).max()
    for axis in range(3):
        if matrix[order[axis], axis] < 0:
            origin = origin + matrix[:, axis] * (values.shape[axis] - 1)
            values = np.flip(values, axis)
    inverse = np.argsort(order)
    spacing = lengths[inverse]
    signs = np.sign(matrix[order, np.arange(3)])
    return (
        np.ascontiguousarray(np.transpose(values, inverse)),
        triple(spacing.tolist()),
        triple(origin.tolist()),
        (directions * signs)[:, inverse] if off_axis > AXIS_ALIGNMENT_TOL else None,
    )
