"""Coordinate maps of lattices and fields: wraps, gradings, trivariate splines, and the solid between two faces of a CAD part.

A map takes lattice coordinates, in model units, to the model. `cylinder`, `sphere`, `stretching` and `grading` are formulas.
`trivariate` and `between` make a `SplineMap`, which has a domain: the block of cells of a lattice is scaled to fill it, and a
field is one of the coordinates of the domain.
"""

from tpmscad._lazy_import import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
