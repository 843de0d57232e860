"""Labels of the faces that the kernel leaves of a lattice and a body: by where they lie.

A face lies on a patch of the lattice, on a face of the body, or on neither: the inner side of a skin. The kernel's history of an
operation is not needed, so that one rule holds for all methods, and for faces that were split, united or made anew.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from OCP.BRep import BRep_Tool
from OCP.BRepAdaptor import BRepAdaptor_Surface
from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeVertex
from OCP.BRepExtrema import BRepExtrema_DistShapeShape
from OCP.BRepTools import BRepTools
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

SKIN = "skin"
"""Label of the faces that lie neither on the lattice nor on the body."""

NODES_PER_DIRECTION = 7
"""Nodes of every patch along u and v from which the foot point of a point is sought."""

ON_PATCH_REL_TOL = 1e-6
"""In sizes of the largest patch: distance at which a point lies on a patch."""

ON_BODY_TOL = 1e-5
"""Model units: distance at which a point inside a face lies on a face of the body. The kernel keeps the surface of a face that it
splits; skins are many times as thick."""


def label_cut_solids(solids: Sequence[Any], patches: Brep, body: CadBody) -> OcctSolids:
    """Solids that the kernel made of a lattice's patches and a body, with the label of each face."""
    faces = [faces_of(solid) for solid in solids]
    flat = [face for own in faces for face in own]
    labels = [SKIN] * len(flat)
    splines = [i for i, face in enumerate(flat) if _is_b_spline(face)]
    tags = find_patch_tags(patches, np.array([_mid_point(flat[i]) for i in splines]).reshape(-1, 3))
    on_patch = {i: tag for i, tag in zip(splines, tags, strict=True) if tag is not None}
    others = [i for i in range(len(flat)) if i not in on_patch]
    names = body.face_labels
    for i, owner in zip(others, find_body_faces([flat[i] for i in others], faces_of(body.shape)), strict=True):
        labels[i] = names[owner] if owner >= 0 else SKIN
    for i, tag in on_patch.items():
        labels[i] = LABEL_OF_TAG.get(tag, tag)
    rest = iter(labels)
    return OcctSolids(tuple(solids), tuple(tuple(next(rest) for _ in own) for own in faces))


def find_body_faces(faces: Sequence[TopoDS_Face], body_faces: Sequence[TopoDS_Face]) -> IntArray:
    """Index of the body's face on which each face lies, -1 if it lies on none: (n,)."""
    number = {ShapeKey(face): i for i, face in enumerate(body_faces)}
    found = np.array([number.get(ShapeKey(face), -1) for face in faces], np.int64)
    unknown = np.flatnonzero(found < 0)
    points = interior_points([faces[i] for i in unknown.tolist()])
    low, high = (np.array(corners) for corners in zip(*map(enclosing_box, body_faces), strict=True))
    for i, point in zip(unknown.tolist(), points, strict=True):
        near = ((point > low - ON_BODY_TOL) & (point < high + ON_BODY_TOL)).all(axis=1)
        distances = {b: _distance(point, body_faces[b]) for b in np.flatnonzero(near).tolist()}
        nearest = min(distances, key=distances.__getitem__, default=-1)
        found[i] = nearest if distances.get(nearest, np.inf) < ON_BODY_TOL else -1
    return found


def _distance(point: Array, face: TopoDS_Face) -> float:
    """Distance of a point from a face; infinite if the kernel finds no foot point."""
    measure = BRepExtrema_DistShapeShape(BRepBuilderAPI_MakeVertex(gp_Pnt(*point.tolist())).Vertex(), face)
    return float(measure.Value()) if measure.IsDone() else np.inf


def _is_b_spline(face: TopoDS_Face) -> bool:
    return bool(BRep_Tool.Surface_s(face).DynamicType().Name() == "Geom_BSplineSurface")


def _mid_point(face: TopoDS_Face) -> tuple[float, float, float]:
    """The point of a face's surface in the middle of its parameters."""
    u0, u1, v0, v1 = BRepTools.UVBounds_s(face)
    point = gp_Pnt()
    BRepAdaptor_Surface(face, False).D0(0.5 * (u0 + u1), 0.5 * (v0 + v1), point)
    return point.Coord()


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
    if not nodes:
        return [None] * len(points)
    _, nearest = cKDTree(np.concatenate(nodes)).query(points)
    face, start = np.concatenate(of_face)[nearest], np.concatenate(parameters)[nearest]
    near = np.full(len(points), False)
    for index in np.unique(faces.carrier[face]).tolist():
        at = np.flatnonzero(faces.carrier[face] == index)
        patch, local = patches.carriers[index], faces.motion[face[at]].apply_inverse(points[at])
        assert isinstance(patch, BSplineSurface)
        near[at] = project_to_patch(patch, local, *start[at].T)[0] < ON_PATCH_REL_TOL * size
    return [patches.tags[int(faces.tag[f])] if on else None for f, on in zip(face, near, strict=True)]
