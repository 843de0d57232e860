"""Volume meshes for simulation: the value of a mesh, its measures and its files.

The modules from the lowest up: `element_shapes` (kinds of elements and their Jacobians), `volume_mesh` (the value), `msh_files`,
`inp_files`, `vtu_files` and `skfem_mesh` (what other programs read).
"""

from __future__ import annotations

from tpmscad.meshing.volume_mesh import (
    MeshQuality,
    VolumeMesh,
    boundary_facets,
    owners_of_facets,
    sort_nodes,
)

__all__ = ["MeshQuality", "VolumeMesh", "boundary_facets", "owners_of_facets", "sort_nodes"]
