"""Broad phase of the local intersection: patches that the body's boundary may intersect, and patches inside the body.

Both sides are sampled, and no surfaces are intersected. A patch is a candidate if one of its nodes is closer to a sample of the
body than the spacing of nodes and samples permits for a disjoint patch.
"""

from __future__ import annotations

import numpy as np
from OCP.BRep import BRep_Tool
from OCP.BRepClass3d import BRepClass3d_SolidClassifier
from OCP.TopAbs import TopAbs_EDGE, TopAbs_FACE, TopAbs_IN
from OCP.TopoDS import TopoDS_Solid
from scipy.spatial import cKDTree

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.brep.boundary_representation import Brep, spline_faces
from tpmscad.brep.linked_items import label_sharing
from tpmscad.kernel.measure.shape_sampling import sample_edge, sample_faces
from tpmscad.kernel.occt import convert
from tpmscad.kernel.occt.convert import CONFUSION_TOLERANCE
from tpmscad.kernel.occt.exploration import count_subshape_uses, faces_of

NODES_PER_DIRECTION = 9
"""Nodes along u and along v of each patch."""

COVERING_FACTOR = 1.1
"""Factor on half the diagonal between nodes: an upper bound on the distance from a patch point to its nearest node."""

SAMPLE_SPACING_FACTOR = 1.5
"""Spacing of the body samples in half diagonals."""

FLATNESS_FRACTION = 0.1
"""In sample spacings: deviation of the body from a sample's tangent plane, since normals turn by 4 degrees between samples."""

EDGE_LENGTH_CHORDS = 16
"""Chords by which the length of an edge is measured."""


def classify_patches(patches: Brep, solid: TopoDS_Solid) -> tuple[BoolArray, BoolArray]:
    """Masks of the candidate faces that the solid's boundary may intersect, and of the other faces inside the solid: (F,) each.

    Faces that are not B-spline patches close a block outside the body and are never candidates.
    """
    nodes, half = _patch_nodes(patches)
    spacing = SAMPLE_SPACING_FACTOR * float(np.median(half[half > 0]))
    on_faces, on_edges = sample_faces(faces_of(solid), spacing), _sample_solid_edges(solid, spacing)
    at = np.concatenate([on_faces.points, on_edges])
    normal = np.concatenate([on_faces.normals, np.zeros_like(on_edges)])
    tree = cKDTree(at)
    near = np.zeros(len(patches.faces), bool)
    for face, points in nodes:
        reach = COVERING_FACTOR * half[face[0]] + FLATNESS_FRACTION * spacing
        far, nearest = tree.query(points, distance_upper_bound=reach + spacing)
        close = np.isfinite(far)
        far, arm = far[close], points[close] - at[nearest[close]]
        height = np.abs(np.einsum("nk,nk->n", arm, normal[nearest[close]]))
        above = (nearest[close] < len(on_faces.points)) & (far**2 - height**2 < spacing**2)
        close[close] = np.where(above, height, far - 0.5 * spacing) <= reach
        near[face] = close.any(axis=1)
    return near, _classify_far_patches(patches, near, solid)


def _patch_nodes(patches: Brep) -> tuple[list[tuple[IntArray, Array]], Array]:
    """Nodes of the patches, carrier by carrier: face indices (f,) and points (f, NODES_PER_DIRECTION**2, 3).

    The second value is half the diagonal between the nodes of each face, 0 for faces without nodes: (F,).
    """
    faces = patches.faces
    result, half = [], np.zeros(len(faces))
    for own, carrier in spline_faces(patches):
        u, v = (np.linspace(*d, NODES_PER_DIRECTION) for d in carrier.domain)
        net = carrier.grid(u, v)
        diagonals = net[1:, 1:] - net[:-1, :-1], net[1:, :-1] - net[:-1, 1:]
        half[own] = 0.5 * max(float(np.linalg.norm(d, axis=-1).max()) for d in diagonals)
        placed = faces.motion[own, None, None].apply(net)
        result.append((own, placed.reshape(len(own), -1, 3)))
    return result, half


def _sample_solid_edges(solid: TopoDS_Solid, spacing: float) -> Array:
    """Points along the solid's edges, about `spacing` apart: (n, 3)."""
    points = []
    for shape, _ in count_subshape_uses(solid, TopAbs_EDGE, TopAbs_FACE):
        edge = convert.as_edge(shape)
        if BRep_Tool.Degenerated_s(edge):
            continue
        length = float(np.linalg.norm(np.diff(sample_edge(edge, EDGE_LENGTH_CHORDS), axis=0), axis=1).sum())
        points.append(sample_edge(edge, max(EDGE_LENGTH_CHORDS, 1 + int(length / spacing))))
    return np.concatenate(points) if points else np.zeros((0, 3))


def _classify_far_patches(patches: Brep, near: BoolArray, solid: TopoDS_Solid) -> BoolArray:
    """Mask of the faces inside the solid (F,), candidates excluded.

    A component of faces joined by edges lies inside or outside as a whole, so that one vertex of it is classified.
    """
    n, uses, face = len(patches.faces), patches.uses, patches.face_of_use
    far = ~near[face]
    label = label_sharing(n, face[far], uses.edge[far])
    first_use = patches.faces.use_start[patches.faces.loop_start[:-1]]
    vertex = patches.edges.start[uses.edge[first_use]]
    classifier = BRepClass3d_SolidClassifier(solid)
    inside = np.zeros(n, bool)
    for component in np.unique(label[~near]).tolist():
        members = np.flatnonzero(~near & (label == component))
        classifier.Perform(convert.point(patches.vertices[vertex[members[0]]]), CONFUSION_TOLERANCE)
        inside[members] = classifier.State() == TopAbs_IN
    return inside
