"""Slices of STEP files."""

from __future__ import annotations

from pathlib import Path

from tpmscad.api.public_calls import validate_options
from tpmscad.kernel.body_import.isolated_reader import read_foreign_step
from tpmscad.kernel.measure.shape_extents import shape_bounds
from tpmscad.requests.study_options import SliceStepOptions
from tpmscad.studies.layer_slices import Slices, slice_shape


@validate_options(SliceStepOptions, 'slice_step("part.step", 0.05)')
def slice_step(options: SliceStepOptions) -> Slices:
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
    >>> from tpmscad.studies._slice_step import slice_step
    >>> slice_step("part.step", 0.05).write("part.cli")  # doctest: +SKIP
    """
    path, shape = Path(options.path), read_foreign_step(options.path).shape
    low, high = shape_bounds(shape)
    return slice_shape(shape, path.stem, options.height, options.chord_error, (float(low[2]), float(high[2])))
