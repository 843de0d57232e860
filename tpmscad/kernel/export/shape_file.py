"""STEP files of OCCT solids with the validation properties that are measured on their faces."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tpmscad.kernel.measure.edge_gaps import measure_accuracy
from tpmscad.kernel.measure.mass_properties import solid_moments
from tpmscad.kernel.step.face_labels import NamedSolid
from tpmscad.kernel.step.shape_writer import name_solids, write_named_solids


def write_solids(
    solids: Sequence[NamedSolid],
    path: str | os.PathLike[str],
    *,
    schema: str = "ap242",
    name: str | None = None,
    assembly: bool = False,
    accuracy: float | None = None,
    time_stamp: str | None = None,
    verify: Callable[[Path], None] | None = None,
) -> None:
    """Write named solids in mm to a STEP file, as one product or, if `assembly`, as a product each; see `write_named_solids`.

    The accuracy is measured unless it is given.
    """
    if accuracy is None:
        accuracy = measure_accuracy([of.solid for of in solids])
    moments = np.array([solid_moments(of.solid) for of in solids])
    write_named_solids(
        solids,
        moments,
        path,
        accuracy=accuracy,
        schema=schema,
        name=name,
        assembly=assembly,
        time_stamp=time_stamp,
        verify=verify,
    )


def write_shape(
    shape: Any,
    path: str | os.PathLike[str],
    *,
    schema: str = "ap242",
    name: str | None = None,
    time_stamp: str | None = None,
    verify: Callable[[Path], None] | None = None,
) -> None:
    """Write the solids of a TopoDS, build123d or CadQuery shape as one STEP product in mm; arguments and errors as `write_step`.

    Raises InvalidRequest if the shape has no solid, or faces outside of solids, and KernelError if a surface or curve has no form
    in STEP.
    """
    solids = name_solids(shape, name or Path(path).stem)
    write_solids(solids, path, schema=schema, name=name, time_stamp=time_stamp, verify=verify)
