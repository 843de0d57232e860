"""Slices of STEP files."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from tpmscad.api.public_calls import validate_call
from tpmscad.api.shared_kinds import PATH, POSITIVE
from tpmscad.kernel.body_import.isolated_reader import read_foreign_step
from tpmscad.kernel.measure.shape_extents import shape_bounds
from tpmscad.studies.layer_slices import Slices, slice_shape


@validate_call()
def slice_step(
    path: Annotated[str | Path, PATH, "The STEP file to read."],
    height: Annotated[
        float,
        POSITIVE,
        "Height of a layer in mm; layers begin at the lowest point of the solids and are cut in their middle.",
    ],
    chord_error: Annotated[
        float | None,
        POSITIVE.described_as(example="0.01"),
        "Greatest distance of a chord from the exact contour in mm; by default a quarter of the height.",
    ] = None,
) -> Slices:
    """Slice the solids of a STEP file for layered manufacturing; see `Model.slices`.

    Returns
    -------
    Slices
        The layers with their closed contours.

    Raises
    ------
    InvalidRequest
        If the file cannot be read, an argument is not positive, or there would be more than 100,000 layers.
    KernelError
        If the kernel cannot triangulate the solids.

    Examples
    --------
    >>> from tpmscad import workflows
    >>> workflows.slice_step("part.step", 0.05).write("part.cli")  # doctest: +SKIP
    """
    shape = read_foreign_step(path).shape
    low, high = shape_bounds(shape)
    return slice_shape(shape, Path(path).stem, height, chord_error, (float(low[2]), float(high[2])))
