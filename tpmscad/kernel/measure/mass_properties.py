"""Areas of OCCT faces, and area, volume and first moments of OCCT solids, by the kernel's adaptive quadrature.

It is independent of the moments of a boundary representation (`tpmscad.brep.moments`), with which they are compared. Relative
errors are below 1e-8 where faces agree along their edges to round-off (docs/measurements.md, `solid_moments`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from OCP.BRepGProp import BRepGProp
from OCP.GProp import GProp_GProps
from OCP.TopoDS import TopoDS_Face, TopoDS_Shape

from tpmscad._typing import Array

QUADRATURE_REL_TOL = 1e-10
"""Relative error requested of OCCT: rational surfaces are off by 150 times as much, polynomial ones by less than it."""


def face_areas(faces: Sequence[TopoDS_Face]) -> Array:
    """Area of each face: (F,)."""
    return np.array([_integrate(BRepGProp.SurfaceProperties_s, face).Mass() for face in faces])


def solid_moments(shape: TopoDS_Shape) -> Array:
    """Area, volume, and volume times centroid of what the faces of a closed shape bound: (5,).

    The kernel integrates about a point amid the faces: they agree along their edges to a tolerance only, and what is missing
    between them counts with its distance.
    """
    area = _integrate(BRepGProp.SurfaceProperties_s, shape).Mass()
    solid = _integrate(BRepGProp.VolumeProperties_s, shape)
    volume = solid.Mass()
    first = volume * np.array(solid.CentreOfMass().Coord()) if volume else np.zeros(3)
    return np.array([area, volume, *first])


def _integrate(quadrature: Any, shape: TopoDS_Shape) -> GProp_GProps:
    """The properties of a shape by one of the kernel's quadratures."""
    properties = GProp_GProps()
    quadrature(shape, properties, QUADRATURE_REL_TOL)
    return properties
