"""Volume meshes for simulation: the value of a mesh, its measures and its files, and gmsh's tetrahedra.

The modules from the lowest up: `element_shapes` (kinds of elements and their Jacobians), `facet_search` (faces of elements),
`volume_mesh` (the value), `msh_files`, `inp_files`, `vtu_files` and `skfem_mesh` (what other programs read), `gmsh_model` and
`tetrahedra` (meshes of solids).
"""

from __future__ import annotations

from tpmscad.meshing.facet_search import boundary_facets, find_facets, interior_facets, owners_of_facets
from tpmscad.meshing.tetrahedra import MeshRequest, SolidFaces, mesh_tetrahedra
from tpmscad.meshing.volume_mesh import (
    MeshQuality,
    VolumeMesh,
    sort_nodes,
)

__all__ = [
    "MeshQuality",
    "MeshRequest",
    "SolidFaces",
    "VolumeMesh",
    "boundary_facets",
    "find_facets",
    "interior_facets",
    "mesh_tetrahedra",
    "owners_of_facets",
    "sort_nodes",
]
