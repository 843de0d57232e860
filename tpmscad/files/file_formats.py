"""Files of solids by suffix: STEP and BREP hold the exact solids, STL, 3MF and glTF closed triangle meshes.

Every file is written under a temporary name, read back and compared with the solids, and only then gets its own name.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tpmscad.atomic_file import validate_output_path
from tpmscad.errors import InvalidRequest, KernelError
from tpmscad.file_suffixes import (
    MODEL_SUFFIXES,
    STEP_SUFFIXES,
    TRIANGLE_SUFFIXES,
    TRIANGLE_WRITERS,
    list_suffixes,
    load_writer,
)
from tpmscad.kernel.boolean.boolean_operations import OcctSolids
from tpmscad.kernel.build.solids import BrepSolids
from tpmscad.kernel.export.brep_file import write_brep_file
from tpmscad.kernel.export.mesh_parts import group_faces
from tpmscad.kernel.export.solid_mesh import measure_meshes
from tpmscad.kernel.occt.construction import make_compound
from tpmscad.requests.study_options import ExportOptions
from tpmscad.results.result_summary import measure_diagonal

if TYPE_CHECKING:
    from tpmscad.results.domain_results import FluidDomains
    from tpmscad.results.model import Model

DEVIATION_FRACTION = 2e-4
"""Default deviation of a mesh, in diagonals of the solid: far below what a printer resolves on a part of its size."""

ROUND_OFF = 1e-9
"""Deviation up to which triangles are said to lie on the faces, model units: those of planes."""

DEFAULT_ANGLE_DEG = 20.0
"""Default turn of the normal between neighbouring facets."""


def check_export(options: ExportOptions) -> str:
    """The suffix of the file; InvalidRequest if it is unknown, or if an option does not fit the format or is not positive."""
    path = Path(options.path)
    suffix = path.suffix.lower()
    if suffix not in MODEL_SUFFIXES:
        raise InvalidRequest(
            f"{path.name} ends in {suffix!r}: give it a name ending in {list_suffixes(MODEL_SUFFIXES)}"
        )
    if suffix not in TRIANGLE_SUFFIXES and (options.deviation is not None or options.angle is not None):
        raise InvalidRequest(
            f"a {suffix} file is exact: leave deviation and angle out, or write {list_suffixes(TRIANGLE_SUFFIXES)}"
        )
    given = {field.name for field in fields(options) if getattr(options, field.name) != field.default}
    if suffix not in STEP_SUFFIXES and given & {"schema", "instanced", "verify"}:
        raise InvalidRequest(f"schema, instanced and verify are for STEP files: leave them out of a {suffix} file")
    for name, value, most in (("deviation", options.deviation, np.inf), ("angle", options.angle, 90.0)):
        if value is not None and not 0.0 < value < most:
            limit = "" if most == np.inf else f" and less than {most:g} degrees"
            raise InvalidRequest(f"{name} = {value!r} must be greater than 0{limit}")
    return suffix


@dataclass(frozen=True, slots=True, repr=False)
class ExportedFile:
    """A file that a result was written to.

    Attributes
    ----------
    path : Path
        The file.
    triangles : int
        Triangles of a mesh; 0 in exact formats.
    deviation : float
        Greatest distance of the triangles from the faces of the solid, and of their sides on edges from these, mm, as measured:
        at most what was asked. 0 in exact formats.
    """

    path: Path
    triangles: int = 0
    deviation: float = 0.0

    def summary(self) -> str:
        """The triangles and their deviation in plain words; empty for exact formats."""
        where = f"within {self.deviation:.3g} mm of" if self.deviation > ROUND_OFF else "on"
        return f"{self.triangles} triangles {where} the faces" if self.triangles else ""

    def __repr__(self) -> str:
        return f"{self.path.name}: {self.summary() or 'exact'}"


def write_mesh_or_brep_file(
    result: Model | FluidDomains, options: ExportOptions, built: Sequence[BrepSolids | OcctSolids]
) -> ExportedFile:
    """Write a result as a mesh (STL, 3MF, GLB) or as OCCT's own BREP, by the suffix of the path.

    built: what the solids are made of, for faces that repeat. KernelError if a mesh does not keep the deviation.
    """
    target, deviation = validate_output_path(options.path, MODEL_SUFFIXES), options.deviation
    suffix = target.suffix.lower()
    if suffix not in TRIANGLE_SUFFIXES:
        write_brep_file(result.wrapped, target, result.volume)
        return ExportedFile(target)
    if deviation is None:
        deviation = max(result.certificate.tol, DEVIATION_FRACTION * measure_diagonal(result.bounding_box))
    angle = DEFAULT_ANGLE_DEG if options.angle is None else options.angle
    solids, volume = result.named_solids(), result.volume
    arrays = [of for of in built if isinstance(of, BrepSolids)]
    source = arrays if len(arrays) == len(built) else make_compound(of.solid for of in solids)
    found = measure_meshes(source, deviation, float(np.radians(angle)))
    parts = [group_faces(of.name, mesh, of.labels, of.colour_of) for of, mesh in zip(solids, found.meshes, strict=True)]
    area = sum(part.mesh.area for part in parts)
    enclosed = sum(part.mesh.volume for part in parts)
    if abs(enclosed - volume) > deviation * area:
        raise KernelError(
            "triangulate",
            f"the mesh has volume {enclosed:.9g}, the solid {volume:.9g}: more than a deviation of {deviation:g} over its "
            f"area {area:.6g} explains",
        )
    load_writer(TRIANGLE_WRITERS, suffix)(parts, target, result.name)
    return ExportedFile(target, sum(len(part.mesh.triangles) for part in parts), found.deviation)
