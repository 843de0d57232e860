"""Exact triply periodic minimal surfaces and their nodal counterparts in the unit cubic cell.

All lengths are in units of the cubic cell's edge unless a function takes a `cell`. The catalogue is `tpmscad.catalogue`.
"""

from tpmscad._lazy_import import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
