"""Volume meshes for simulation: the value of a mesh, its measures and its files, and gmsh's tetrahedra.

The modules from the lowest up: `element_shapes` (kinds of elements and their Jacobians), `facet_search` (faces of elements),
`volume_mesh` (the value), `msh_files`, `inp_files`, `vtu_files` and `skfem_mesh` (what other programs read), `gmsh_model` and
`tetrahedra` (meshes of solids).
"""
