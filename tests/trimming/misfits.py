"""How far the curves of a complex are from its carriers and vertices, measured."""

from __future__ import annotations

import numpy as np

from tpmscad.patches.carriers import Plane
from tpmscad.patches.complex import PatchComplex


def misfit(complex: PatchComplex) -> np.ndarray:
    """For every use, how far the carrier at its parameter curve is from the edge's curve, and that from the edge's vertices."""
    result = []
    faces, edges, uses = complex.faces, complex.edges, complex.uses
    for use, face in enumerate(complex.face_of_use):
        edge = uses.edge[use]
        t = np.linspace(*edges.span[edge], 14)
        points = complex.curves[edges.curve[edge]](t) @ edges.rotation[edge].T + edges.translation[edge]
        carrier = complex.carriers[faces.carrier[face]]
        if isinstance(carrier, Plane):
            off = np.abs(((points - faces.translation[face]) @ faces.rotation[face] - carrier.origin) @ carrier.normal)
        else:
            on_patch = carrier(*complex.pcurves[uses.pcurve[use]](t).T)
            off = np.linalg.norm(on_patch @ faces.rotation[face].T + faces.translation[face] - points, axis=1)
        ends = complex.vertices[[edges.start[edge], edges.end[edge]]]
        result.append(max(off.max(), np.linalg.norm(points[[0, -1]] - ends, axis=1).max()))
    return np.array(result)
