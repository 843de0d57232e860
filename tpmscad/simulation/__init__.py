"""Effective properties of periodic cells: elasticity and conduction on second-order meshes, through scikit-fem.

`multigrid` solves the equations, `periodic_cell` assembles them for a mesh, `properties` holds the results and what follows from
them.
"""
