"""Conforming quad-dominant meshes of a level set inside a box, and the patch networks made from them.

1. `octree`, `refinement`: a 2:1 balanced octree, split where it would hide part of the level set.
2. `octree_faces`, `dual_mesh`: its dual mesh, a manifold by construction (dual marching cubes; Nielson 2004).
3. `smoothing`, `regular_polygons`: vertices move along the level set until the polygons are nearly regular
   (`quality` measures them).
4. `simplification`: polygons are merged while the result stays well shaped (Daniels et al. 2008; Tarini et al. 2010).
5. `patch_network`: triangles are cut in three, which gives a network of curves and four-sided patches with T-vertices.

`periodicity` keeps the periods of a periodic field congruent through all steps.
"""
