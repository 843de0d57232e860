"""Effective properties of periodic cells: elasticity and conduction on second-order meshes, through scikit-fem.

`multigrid` solves the equations, `periodic_cell` assembles them for a mesh, `properties` holds the results and what follows from
them.
"""

from __future__ import annotations

from tpmscad.simulation.periodic_cell import CellProperties, IsotropicMaterial, solve_cell
from tpmscad.simulation.properties import HomogenizedProperties

__all__ = ["CellProperties", "HomogenizedProperties", "IsotropicMaterial", "solve_cell"]
