"""Volume meshes of STEP files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

from tpmscad._typing import ProgressOption
from tpmscad.api.public_calls import validate_call
from tpmscad.api.shared_kinds import COUNT, FLAG, PATH, POSITIVE, PROGRESS
from tpmscad.kernel.body_import.isolated_reader import read_foreign_coloured_solids, read_foreign_step
from tpmscad.kernel.measure.shape_extents import shape_bounds
from tpmscad.kernel.occt.construction import make_compound
from tpmscad.kernel.step.face_labels import NamedSolid, label_outer_faces
from tpmscad.kernel.step.shape_writer import name_solids
from tpmscad.meshing.volume_mesh import VolumeMesh
from tpmscad.studies.volume_meshing import mesh_named_solids, read_request


@validate_call()
def mesh_step(
    path: Annotated[
        str | Path,
        PATH,
        "The file to read: .step, .stp or .brep. Each solid is a group of elements under its name in the file. Facets "
        'are in groups named as the faces in the STEP file ("cap X+"); without such a name, "surface", and "surface '
        'X+" to "surface Z-" where they are planar and face along an axis. Solids of a BREP file that share faces '
        "share the nodes there; those of a STEP file share none.",
    ],
    size: Annotated[float, POSITIVE.described_as(example="0.5"), "As in `Model.mesh`."],
    order: Annotated[int, COUNT, "As in `Model.mesh`."] = 2,
    periodic: Annotated[bool, FLAG, "As in `Model.mesh`."] = False,
    *,
    per_turn: Annotated[int | None, COUNT.described_as(example="12"), "As in `Model.mesh`."] = None,
    progress: Annotated[ProgressOption, PROGRESS, "As in `Model.mesh`."] = None,
) -> VolumeMesh:
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
    >>> from tpmscad import workflows
    >>> workflows.mesh_step("part.step", 0.5).write("part.msh")  # doctest: +SKIP
    """
    request = read_request(size, order, periodic, per_turn)
    source = Path(path)
    if source.suffix.lower() == ".brep":
        found = [(of.name, of.solid, ()) for of in name_solids(read_foreign_step(source).shape, "solid")]
    else:
        found = [
            (read.name or f"solid {number}", read.solid, read.face_names)
            for number, read in enumerate(read_foreign_coloured_solids(source), 1)
        ]
    solids = [NamedSolid(name, solid, _label_faces(solid, names)) for name, solid, names in found]
    low, high = shape_bounds(make_compound(of.solid for of in solids))
    return mesh_named_solids(
        solids,
        [of.name for of in solids],
        (low.tolist(), high.tolist()),
        request,
        name=source.stem,
        progress=progress,
    )


def _label_faces(solid: Any, names: Sequence[str]) -> tuple[str, ...]:
    """The names of the faces in their file; where they have none, "surface" with the axis that they face."""
    others = label_outer_faces(solid, "surface")
    return tuple(name or other for name, other in zip(names or others, others, strict=True))
