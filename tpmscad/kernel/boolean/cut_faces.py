"""Labels of the faces that the kernel leaves of a lattice and a body: by where they lie.

A face lies on a patch of the lattice, on a face of the body, or on neither: the inner side of a skin. The kernel's history of an
operation is not needed, so that one rule holds for all methods, and for faces that were split, united or made anew.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from OCP.BRep import BRep_Tool
from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeVertex
from OCP.BRepExtrema import BRepExtrema_DistShapeShape
from OCP.gp import gp_Pnt
from OCP.TopoDS import TopoDS_Face
from scipy.spatial import cKDTree

from tpmscad._typing import Array, IntArray
from tpmscad.brep.boundary_representation import Brep, spline_faces
from tpmscad.brep.orthogonal_projection import project_to_patch
from tpmscad.kernel.body_import.cad_body import CadBody
from tpmscad.kernel.boolean.boolean_operations import OcctSolids
from tpmscad.kernel.measure.shape_sampling import interior_points
from tpmscad.kernel.occt.bounding_boxes import enclosing_box
from tpmscad.kernel.occt.exploration import ShapeKey, faces_of
from tpmscad.kernel.step.face_labels import LABEL_OF_TAG
from tpmscad.splines.bspline import BSplineSurface

SKIN, UNKNOWN = "skin", "other"
"""Labels of the faces that lie neither on the lattice nor on the body: with a skin its inner side, else the kernel's own."""

NODES_PER_DIRECTION = 7
"""Nodes of every patch along u and v from which the foot point of a point is sought."""

NEAREST_NODES = 16
"""Nodes that are tried: near the side of a patch the nearest one may be its neighbour's."""

ON_PATCH_REL_TOL = 1e-6
"""In sizes of the largest patch: distance at which a point lies on a patch."""

ON_BODY_TOL = 1e-5
"""Model units: distance at which a point inside a face lies on a face of the body. The kernel keeps the surface of a face that it
splits; skins are many times as thick."""


def label_cut_solids(
    solids: Sequence[Any], placements: Sequence[Brep], body: CadBody, *, has_skin: bool = False
) -> OcctSolids:
    """Solids that the kernel made of a lattice's patches and a body, with the label of each face.

    placements: the patches as they lie in the solids, several where the lattice was moved differently for parts of the body.
    """
    counts = [len(faces_of(solid)) for solid in solids]
    faces = [face for solid in solids for face in faces_of(solid)]
    points, names = interior_points(faces), body.face_labels
    labels = [""] * len(faces)
    splines = [i for i, face in enumerate(faces) if _is_b_spline(face)]
    for patches in placements:
        sought = [i for i in splines if not labels[i]]
        for i, tag in zip(sought, find_patch_tags(patches, points[sought]), strict=True):
            labels[i] = "" if tag is None else LABEL_OF_TAG.get(tag, tag)
    others = [i for i, label in enumerate(labels) if not label]
    owners = find_body_faces([faces[i] for i in others], points[others], faces_of(body.shape))
    for i, owner in zip(others, owners.tolist(), strict=True):
        labels[i] = names[owner] if owner >= 0 else SKIN if has_skin else UNKNOWN
    ends = np.cumsum([0, *counts]).tolist()
    return OcctSolids(tuple(solids), tuple(tuple(labels[i:j]) for i, j in pairwise(ends)))


def find_body_faces(faces: Sequence[TopoDS_Face], points: Array, body_faces: Sequence[TopoDS_Face]) -> IntArray:
    """Index of the body's face on which each face lies, with a point (n, 3) inside it; -1 if it lies on none: (n,)."""
    number = {ShapeKey(face): i for i, face in enumerate(body_faces)}
    found = np.array([number.get(ShapeKey(face), -1) for face in faces], np.int64)
    low, high = (np.array(corners) for corners in zip(*map(enclosing_box, body_faces), strict=True))
    for i in np.flatnonzero(found < 0).tolist():
        near = ((points[i] > low - ON_BODY_TOL) & (points[i] < high + ON_BODY_TOL)).all(axis=1)
        distances = {b: _distance(points[i], body_faces[b]) for b in np.flatnonzero(near).tolist()}
        nearest = min(distances, key=distances.__getitem__, default=-1)
        found[i] = nearest if distances.get(nearest, np.inf) < ON_BODY_TOL else -1
    return found


def _distance(point: Array, face: TopoDS_Face) -> float:
    """Distance of a point from a face; infinite if the kernel finds no foot point."""
    measure = BRepExtrema_DistShapeShape(BRepBuilderAPI_MakeVertex(gp_Pnt(*point.tolist())).Vertex(), face)
    return float(measure.Value()) if measure.IsDone() else np.inf


def _is_b_spline(face: TopoDS_Face) -> bool:
    return bool(BRep_Tool.Surface_s(face).DynamicType().Name() == "Geom_BSplineSurface")


def find_patch_tags(patches: Brep, points: Array) -> list[str | None]:
    """Tag of the B-spline patch on which each point (n, 3) lies, None if it lies on none."""
    faces, nodes, of_face, parameters = patches.faces, [], [], []
    size = 0.0
    for own, carrier in spline_faces(patches):
        axes = (np.linspace(*domain, NODES_PER_DIRECTION) for domain in carrier.domain)
        u, v = (grid.ravel() for grid in np.meshgrid(*axes, indexing="ij"))
        local = carrier(u, v)
        size = max(size, float(np.ptp(local, axis=0).max()))
        nodes.append(faces.motion[own][:, None].apply(local).reshape(-1, 3))
        of_face.append(np.repeat(own, len(u)))
        parameters.append(np.tile(np.column_stack([u, v]), (len(own), 1)))
    if not nodes or not len(points):
        return [None] * len(points)
    face, start = np.concatenate(of_face), np.concatenate(parameters)
    _, nearest = cKDTree(np.concatenate(nodes)).query(points, min(NEAREST_NODES, len(face)))
    found = np.full(len(points), -1)
    for node in nearest.reshape(len(points), -1).T:
        for index in np.unique(faces.carrier[face[node[found < 0]]]).tolist():
            at = np.flatnonzero((found < 0) & (faces.carrier[face[node]] == index))
            patch, local = patches.carriers[index], faces.motion[face[node[at]]].apply_inverse(points[at])
            assert isinstance(patch, BSplineSurface)
            near = project_to_patch(patch, local, *start[node[at]].T)[0] < ON_PATCH_REL_TOL * size
            found[at[near]] = face[node[at[near]]]
    return [patches.tags[int(faces.tag[f])] if f >= 0 else None for f in found.tolist()]
