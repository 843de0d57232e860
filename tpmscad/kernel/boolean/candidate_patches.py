"""Which patches of a lattice a body's faces may cross, and which lie inside the body: by samples, no face is intersected."""

from __future__ import annotations

import numpy as np
from OCP.BRep import BRep_Tool
from OCP.BRepClass3d import BRepClass3d_SolidClassifier
from OCP.TopAbs import TopAbs_EDGE, TopAbs_FACE, TopAbs_IN
from OCP.TopoDS import TopoDS_Solid
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.brep.boundary_representation import Brep, spline_faces
from tpmscad.kernel.measure.shape_sampling import sample_edge, sample_faces
from tpmscad.kernel.occt import convert
from tpmscad.kernel.occt.convert import CONFUSION_TOLERANCE
from tpmscad.kernel.occt.exploration import count_subshape_uses, faces_of

NODES_PER_DIRECTION = 9
"""Nodes along u and v of every patch."""

COVERING_FACTOR = 1.1
"""On half the diagonal between nodes: no point of a patch is farther from its nearest node."""

SAMPLE_SPACING_FACTOR = 1.5
"""Samples of the body are this many half diagonals apart."""

FLATNESS_FRACTION = 0.1
"""Of the spacing: how far the body may be off the plane of a sample next to it, whose normal turns by 4 degrees to the next."""

EDGE_LENGTH_CHORDS = 16
"""Pieces on which an edge's length is measured."""


def classify_patches(patches: Brep, solid: TopoDS_Solid) -> tuple[BoolArray, BoolArray]:
    """Faces that the solid's faces may cross, and those of the others that lie in the solid: (F,), (F,).

    Faces that are no B-spline patches, which close a block outside of all, are never near.
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
    """Faces (f,) and their nodes (f, NODES^2, 3), carrier by carrier; half the diagonal between each face's nodes, or 0 (F,)."""
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
    """Faces in the solid: what hangs together over edges, and is not near, is in or out as a whole; one vertex tells."""
    n, uses, face = len(patches.faces), patches.uses, patches.face_of_use
    far = ~near[face]
    links = coo_array(
        (np.ones(int(far.sum()), bool), (face[far], n + uses.edge[far])), shape=(n + len(patches.edges),) * 2
    )
    label = connected_components(links, directed=False)[1][:n]
    first_use = patches.faces.use_start[patches.faces.loop_start[:-1]]
    vertex = patches.edges.start[uses.edge[first_use]]
    classifier = BRepClass3d_SolidClassifier(solid)
    inside = np.zeros(n, bool)
    for component in np.unique(label[~near]).tolist():
        members = np.flatnonzero(~near & (label == component))
        classifier.Perform(convert.point(patches.vertices[vertex[members[0]]]), CONFUSION_TOLERANCE)
        inside[members] = classifier.State() == TopAbs_IN
    return inside
