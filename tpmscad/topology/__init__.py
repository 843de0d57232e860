"""Topology of sampled fields: components, cavities, Betti numbers and persistent homology.

The solid of samples f at a level c is {f <= c}. The union-find sweeps count and pair components (dimension 0) and cavities
(dimension 2) fast enough for an optimisation loop; their loops are compiled by numba on first use and cached on disk.
`persistence_diagram` computes all three dimensions with gudhi, for inspection.
"""

from tpmscad._lazy_import import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
