"""Measures of boundary representations: their volume, and how far their curves are from their carriers and vertices."""

from __future__ import annotations

import numpy as np

from tpmscad.brep.boundary_representation import Brep
from tpmscad.brep.carriers import Plane
from tpmscad.brep.moments import integral_properties


def volume(brep: Brep) -> float:
    """Inside of all shells; none without faces."""
    return (
        float(integral_properties.volume(integral_properties.integrate_faces(brep)).sum()) if len(brep.faces) else 0.0
    )


def misfit(brep: Brep) -> np.ndarray:
    """For every use, how far the carrier at its parameter curve is from the edge's curve, and that from the edge's vertices."""
    result = []
    faces, edges, uses = brep.faces, brep.edges, brep.uses
    for use, face in enumerate(brep.face_of_use):
        edge = uses.edge[use]
        t = np.linspace(*edges.span[edge], 14)
        points = edges.motion[edge].apply(brep.curves[edges.curve[edge]](t))
        carrier = brep.carriers[faces.carrier[face]]
        if isinstance(carrier, Plane):
            off = np.abs((faces.motion[face].apply_inverse(points) - carrier.origin) @ carrier.normal)
        else:
            on_patch = carrier(*brep.pcurves[uses.pcurve[use]](t).T)
            off = np.linalg.norm(faces.motion[face].apply(on_patch) - points, axis=1)
        ends = brep.vertices[[edges.start[edge], edges.end[edge]]]
        result.append(max(off.max(), np.linalg.norm(points[[0, -1]] - ends, axis=1).max()))
    return np.array(result)
