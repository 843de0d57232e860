"""Coordinate maps of lattices and fields: wraps, gradings, trivariate splines, and the solid between two faces of a CAD part.

A map takes lattice coordinates, in model units, to the model. `cylinder`, `sphere`, `stretching` and `grading` are formulas.
`trivariate` and `between` make a `SplineMap`, which has a domain: the block of cells of a lattice is scaled to fill it, and a
field is one of the coordinates of the domain.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from tpmscad._lazy_import import lazy_attributes

if TYPE_CHECKING:
    from tpmscad.lattices.coordinate_maps import Map, as_map, composition, cylinder, grading, sphere, stretching
    from tpmscad.lattices.spline_maps import SplineMap, trivariate
    from tpmscad.workflows.face_maps import between

__all__ = [
    "Map",
    "SplineMap",
    "as_map",
    "between",
    "composition",
    "cylinder",
    "grading",
    "sphere",
    "stretching",
    "trivariate",
]

_HOMES = {
    "tpmscad.lattices.coordinate_maps": (
        "Map",
        "as_map",
        "composition",
        "cylinder",
        "grading",
        "sphere",
        "stretching",
    ),
    "tpmscad.lattices.spline_maps": ("SplineMap", "trivariate"),
    "tpmscad.workflows.face_maps": ("between",),
}

__getattr__, __dir__ = lazy_attributes(__name__, {name: home for home, names in _HOMES.items() for name in names})
