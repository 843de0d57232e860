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

from tpmscad._typing import Array, IntArray
from tpmscad.brep.boundary_representation import Brep
from tpmscad.brep.patch_nodes import place_nodes, project_from_nodes
from tpmscad.kernel.body_import.cad_body import CadBody
from tpmscad.kernel.boolean.boolean_operations import OcctSolids
from tpmscad.kernel.measure.shape_sampling import interior_points
from tpmscad.kernel.occt.bounding_boxes import enclosing_box
from tpmscad.kernel.occt.exploration import ShapeKey, faces_of
from tpmscad.kernel.step.face_labels import LABEL_OF_TAG

SKIN, UNKNOWN = "skin", "other"
"""Labels of the faces that lie neither on the lattice nor on the body: with a skin its inner side, else the kernel's own."""

NEAREST_NODES = 16
"""Nodes that are tried: near the side of a patch the nearest one may be its neighbour's."""

ON_PATCH_REL_TOL = 1e-6
"""In sizes of the largest patch: distance at which a point lies on a patch."""

ON_BODY_TOL = 1e-5
"""Model units: distance at which a point inside a face lies on a face of the body. The kernel keeps the surface of a face that it
splits; skins are many times as thick."""


def label_cut_solids(solids: Sequence[Any], patches: Brep, body: CadBody, *, has_skin: bool = False) -> OcctSolids:
    """Solids that the kernel made of a lattice's patches and a body, with the label of each face."""
    counts = [len(faces_of(solid)) for solid in solids]
    faces = [face for solid in solids for face in faces_of(solid)]
    points, names = interior_points(faces), body.face_labels
    labels = [""] * len(faces)
    splines = [i for i, face in enumerate(faces) if _is_b_spline(face)]
    for i, tag in zip(splines, find_patch_tags(patches, points[splines]), strict=True):
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
    nodes, found = place_nodes(patches), np.full(len(points), -1)
    if len(nodes.points) and len(points):
        for face, distance in project_from_nodes(patches, nodes, points, NEAREST_NODES):
            found = np.where((found < 0) & (distance < ON_PATCH_REL_TOL * nodes.size), face, found)
    return [patches.tags[int(patches.faces.tag[f])] if f >= 0 else None for f in found.tolist()]
