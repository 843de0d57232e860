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
from OCP.TopAbs import TopAbs_EDGE, TopAbs_FACE
from OCP.TopoDS import TopoDS_Face, TopoDS_Shape

from tpmscad._typing import Array
from tpmscad.kernel.occt.exploration import list_subshapes

QUADRATURE_REL_TOL = 1e-10
"""Relative error requested of OCCT: rational surfaces are off by 150 times as much, polynomial ones by less than it."""


WHOLE_PATCHES_REL_TOL = 1e-3
"""Relative error requested for solids of whole patches: the first refinement is already off by 2e-11 only."""


def face_areas(faces: Sequence[TopoDS_Face]) -> Array:
    """Area of each face: (F,)."""
    return np.array([_integrate(BRepGProp.SurfaceProperties_s, face).Mass() for face in faces])


def solid_moments(shape: TopoDS_Shape, rel_tol: float | None = QUADRATURE_REL_TOL) -> Array:
    """Area, volume, and volume times centroid of what the faces of a closed shape bound: (5,).

    The kernel integrates about a point amid the faces: they agree along their edges to a tolerance only, and what is missing
    between them counts with its distance. `rel_tol`: relative error requested; None for a fixed number of nodes, several times
    as fast and off by up to 2e-7.
    """
    area = _integrate(BRepGProp.SurfaceProperties_s, shape, rel_tol).Mass()
    solid = _integrate(BRepGProp.VolumeProperties_s, shape, rel_tol)
    volume = solid.Mass()
    first = volume * np.array(solid.CentreOfMass().Coord()) if volume else np.zeros(3)
    return np.array([area, volume, *first])


def solid_volume(shape: TopoDS_Shape) -> Array:
    """The volume in the place that it has in `solid_moments`, nan for the others; several times as fast.

    Faces that are cut take a fixed number of nodes (off by 3e-9 in an infill of 1114 faces), on which whole patches can be off by
    2e-7: solids of whole patches take the adaptive quadrature with a low request (off by 2e-11).
    """
    n_uses, n_faces = (len(list_subshapes(shape, kind)) for kind in (TopAbs_EDGE, TopAbs_FACE))
    rel_tol = None if n_uses > 4 * n_faces else WHOLE_PATCHES_REL_TOL
    volume = _integrate(BRepGProp.VolumeProperties_s, shape, rel_tol).Mass()
    return np.array([np.nan, volume, np.nan, np.nan, np.nan])


def _integrate(quadrature: Any, shape: TopoDS_Shape, rel_tol: float | None = QUADRATURE_REL_TOL) -> GProp_GProps:
    """The properties of a shape by one of the kernel's quadratures."""
    properties = GProp_GProps()
    quadrature(shape, properties, *(() if rel_tol is None else (rel_tol,)))
    return properties
