"""The boundary representation (Brep) that every way to a solid ends in and everything downstream starts from.

A `Brep` is a frozen value of arrays, without a kernel object: lattices and level-set meshes make one, trimming cuts one, the
kernel builds and writes one. Its data structure is described in `tpmscad.brep.boundary_representation`:

    carriers -- faces -- loops -- edge uses -- edges -- vertices
                             (half-edges)   |       |
                                       pcurves    curves

What follows from it needs no kernel either: closedness, shells and Betti numbers, volume, area and centroid, deviation from a
reference surface, continuity across edges.
"""

from tpmscad.brep.boundary_representation import (
    Brep,
    Edges,
    EdgeUses,
    Faces,
    drop_unused_geometry,
    move_brep,
    reverse_faces,
    scale_brep,
    select_faces,
    spline_faces,
    translate_brep,
)
from tpmscad.brep.carriers import Carrier, EdgeCurve, Plane, Quadric
from tpmscad.brep.conics import Circle, Ellipse
from tpmscad.brep.connectivity import euler_characteristic, find_unmatched_edges, is_closed, label_shells
from tpmscad.brep.deviation import Deviation, combine_deviations, measure_deviation, project_to_patch
from tpmscad.brep.edge_continuity import EdgeContinuity, evaluate_curvature, measure_edge_continuity
from tpmscad.brep.extents import true_bounds
from tpmscad.brep.loops import LoopError, chain_loops, nest_loops, point_in_polygon, points_in_polygons, signed_area
from tpmscad.brep.moments.integral_properties import FaceMoments, centroid, integrate_faces, volume
from tpmscad.brep.quadrics import ConicalSurface, CylindricalSurface, SphericalSurface, ToroidalSurface
from tpmscad.brep.solid_properties import SolidPiece, SolidProperties, measure_solid
from tpmscad.brep.welding import cluster_points, weld_patches

__all__ = [
    "Brep",
    "Carrier",
    "Circle",
    "ConicalSurface",
    "CylindricalSurface",
    "Deviation",
    "EdgeContinuity",
    "EdgeCurve",
    "EdgeUses",
    "Edges",
    "Ellipse",
    "FaceMoments",
    "Faces",
    "LoopError",
    "Plane",
    "Quadric",
    "SolidPiece",
    "SolidProperties",
    "SphericalSurface",
    "ToroidalSurface",
    "centroid",
    "chain_loops",
    "cluster_points",
    "combine_deviations",
    "drop_unused_geometry",
    "euler_characteristic",
    "evaluate_curvature",
    "find_unmatched_edges",
    "integrate_faces",
    "is_closed",
    "label_shells",
    "measure_deviation",
    "measure_edge_continuity",
    "measure_solid",
    "move_brep",
    "nest_loops",
    "point_in_polygon",
    "points_in_polygons",
    "project_to_patch",
    "reverse_faces",
    "scale_brep",
    "select_faces",
    "signed_area",
    "spline_faces",
    "translate_brep",
    "true_bounds",
    "volume",
    "weld_patches",
]
