"""Volume meshes of STEP files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tpmscad.api.public_calls import validate_options
from tpmscad.kernel.body_import.isolated_reader import read_foreign_coloured_solids, read_foreign_step
from tpmscad.kernel.export.shape_file import name_solids
from tpmscad.kernel.measure.shape_extents import shape_bounds
from tpmscad.kernel.occt.construction import make_compound
from tpmscad.kernel.step.face_labels import NamedSolid, label_outer_faces
from tpmscad.meshing.volume_mesh import VolumeMesh
from tpmscad.requests.study_options import MeshStepOptions
from tpmscad.studies.volume_meshing import mesh_named_solids


@validate_options(MeshStepOptions, 'mesh_step("part.step", 0.5)')
def mesh_step(options: MeshStepOptions) -> VolumeMesh:
    """Mesh the solids of a STEP or BREP file with tetrahedra; see `Model.mesh`.

    Returns
    -------
    VolumeMesh
        Nodes, elements, facets and groups.

    Raises
    ------
    InvalidRequest
        If the file cannot be read, gmsh is not installed, or a request cannot be met.
    KernelError
        If gmsh fails, or elements stay inverted.

    Examples
    --------
    >>> from tpmscad.studies._mesh_step import mesh_step
    >>> mesh_step("part.step", 0.5).write("part.msh")  # doctest: +SKIP
    """
    source = Path(options.path)
    if source.suffix.lower() == ".brep":
        found = [(of.name, of.solid, ()) for of in name_solids(read_foreign_step(source).shape, "solid")]
    else:
        found = [
            (read.name or f"solid {number}", read.solid, read.face_names)
            for number, read in enumerate(read_foreign_coloured_solids(source), 1)
        ]
    solids = [NamedSolid(name, solid, _label_faces(solid, names)) for name, solid, names in found]
    low, high = shape_bounds(make_compound(of.solid for of in solids))
    names = [solid.name for solid in solids]
    return mesh_named_solids(solids, names, (low.tolist(), high.tolist()), options, name=source.stem)


def _label_faces(solid: Any, names: Sequence[str]) -> tuple[str, ...]:
    """The names of the faces in their file; where they have none, "surface" with the axis that they face."""
    others = label_outer_faces(solid, "surface")
    return tuple(name or other for name, other in zip(names or others, others, strict=True))
