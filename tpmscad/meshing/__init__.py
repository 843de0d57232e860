"""Volume meshes for simulation: the value of a mesh, its measures and its files, and gmsh's tetrahedra.

The modules from the lowest up: `element_shapes` (kinds of elements and their Jacobians), `facet_search` (faces of elements),
`mesh_arrays` (the arrays), `msh_files`, `inp_files`, `openfoam_case` and `library_meshes` (what other programs read),
`volume_mesh` (the value), `gmsh_model`, `tetrahedra` and `hexahedra` (meshes of solids).
"""
