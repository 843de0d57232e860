"""Axis-aligned bounding boxes of OCCT shapes; each function states what its box guarantees.

OCCT bounds a B-spline face by its poles, which on lattices is half a cell too wide. Its optimal box of such a face takes minutes.
"""

from __future__ import annotations

import numpy as np
from OCP.Bnd import Bnd_Box
from OCP.BRep import BRep_Tool
from OCP.BRepBndLib import BRepBndLib
from OCP.Geom import Geom_OffsetSurface, Geom_Surface, Geom_SweptSurface, Geom_ToroidalSurface
from OCP.TopAbs import TopAbs_EDGE, TopAbs_FACE
from OCP.TopoDS import TopoDS_Face, TopoDS_Shape

from tpmscad._typing import Array
from tpmscad.kernel.occt import convert
from tpmscad.kernel.occt.exploration import count_subshape_uses, faces_of


def enclosing_box(shape: TopoDS_Shape) -> tuple[Array, Array]:
    """Opposite corners (3,), (3,) of a box that contains the shape.

    The box is exact for plane and quadric faces and too large for splines. It is infinite for an unbounded shape. OCCT 7.9
    samples swept and offset surfaces and bounds the samples only, and the box of a torus that intersects itself does not move
    with it, so that these have the kernel's optimal box, too.
    """
    box = Bnd_Box()
    BRepBndLib.Add_s(shape, box, False)
    for face in faces_of(shape):
        if _is_bounded_badly(BRep_Tool.Surface_s(face)):
            BRepBndLib.AddOptimal_s(face, box, False, False)
    if box.IsVoid() or box.IsOpen():
        return np.full(3, -np.inf), np.full(3, np.inf)
    return box_corners(box)


def _is_bounded_badly(surface: Geom_Surface) -> bool:
    """Whether the kernel's plain box of a face on a surface may not contain it."""
    if isinstance(surface, Geom_ToroidalSurface):
        return bool(surface.MajorRadius() <= surface.MinorRadius())
    return isinstance(surface, Geom_SweptSurface | Geom_OffsetSurface)


def box_of_edges(shape: TopoDS_Shape) -> Bnd_Box:
    """The tight box of the edges that bound faces, but for degenerate ones."""
    box = Bnd_Box()
    for edge, _ in count_subshape_uses(shape, TopAbs_EDGE, TopAbs_FACE):
        if not BRep_Tool.Degenerated_s(convert.as_edge(edge)):
            BRepBndLib.AddOptimal_s(edge, box, False, False)
    return box


def box_diagonal(shape: TopoDS_Shape) -> float:
    """Diagonal of the enclosing box, its tolerance gap included: the size of a shape for relative tolerances."""
    box = Bnd_Box()
    BRepBndLib.Add_s(shape, box, False)
    return float(np.linalg.norm(np.subtract(box.CornerMax().Coord(), box.CornerMin().Coord())))


def box_center(face: TopoDS_Face) -> Array:
    """Center (3,) of the face's box, for error messages."""
    box = Bnd_Box()
    BRepBndLib.Add_s(face, box)
    return np.asarray(0.5 * np.add(box.CornerMin().Coord(), box.CornerMax().Coord()))


def box_corners(box: Bnd_Box) -> tuple[Array, Array]:
    """Opposite corners (3,), (3,) of a box without its gap."""
    box.SetGap(0.0)
    return np.array(box.CornerMin().Coord()), np.array(box.CornerMax().Coord())
