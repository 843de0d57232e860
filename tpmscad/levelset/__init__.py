"""Boundary representation of the solid {field < 0} in a box, from any implicit field.

1. `boundary_level_sets`: the field is decomposed into the smooth level sets that bound its solid; each is then processed by
   itself.
2. `quadmesh`: octree, dual quad mesh (dual marching cubes; Nielson 2004, Schaefer, Ju and Warren 2007), smoothing, and
   simplification by collapses (Daniels et al. 2008; Tarini et al. 2010).
3. `fit`: Bezier curves and patches fitted to the level set, joined with tangent continuity, and the measurement of the result.
4. `level_set_fit`: one mesh fitted and measured; `adaptive_search`: the octree refined where patches fail, until all pass;
   `fit_simplification`: the mesh of a fit that passes, with fewer patches; `fine_meshes`: of a mesh that is simplified first.
5. `caps`, `brep_assembly`: planar caps in the faces of the box, and the boundary representation of it all.
6. `periodic`: the level set of a periodic field and its normal offsets on one period without a
   box, one patch for each orbit of the field's isometries, and the copies that cover a box.

`field_solid` is the entry: a FieldSolid that was measured, or a LevelSetError that names the place and the cause.
"""
