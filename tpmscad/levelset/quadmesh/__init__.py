"""Conforming all-quadrilateral layouts of a level set inside a box: octree, dual mesh, relaxation, simplification."""
