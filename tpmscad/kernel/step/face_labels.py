"""Names and colours of faces in files, by the group that a face belongs to.

The groups are the two sides of a lattice ("surface +" and "surface -"), the level set of a field ("surface"), gap faces ("gap")
and the faces of what bounds the lattice from outside ("cap", "body" or "opening"); planar ones have the axis that they face:
"cap X+".
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from OCP.BRep import BRep_Tool
from OCP.BRepAdaptor import BRepAdaptor_Surface
from OCP.BRepTools import BRepTools
from OCP.GeomAbs import GeomAbs_Plane
from OCP.gp import gp_Pnt
from OCP.TopoDS import TopoDS_Face
from scipy.spatial import cKDTree

from tpmscad._typing import Array, Colour
from tpmscad.brep.boundary_representation import Brep, spline_faces
from tpmscad.brep.carriers import Plane
from tpmscad.brep.orthogonal_projection import project_to_patch
from tpmscad.kernel.occt.exploration import ShapeKey, faces_of, orientation_sign
from tpmscad.splines.bspline import BSplineSurface

LABEL_OF_TAG = {"offset+": "surface +", "offset-": "surface -"}
"""Names of tags in files; other tags are their own names."""

OUTER_TAG = "cap"
"""Tag of the faces that close a lattice at a box or a body."""

AXIS_COSINE = 1.0 - 1e-12
"""Cosine of the angle up to which a normal is along an axis: about a millionth of a radian."""

LABEL_COLOURS: Mapping[str, Colour] = {
    "surface": (0.36, 0.56, 0.74),
    "surface +": (0.36, 0.56, 0.74),
    "surface -": (0.87, 0.60, 0.32),
    "gap": (0.62, 0.64, 0.66),
    "cap": (0.78, 0.80, 0.82),
    "body": (0.60, 0.70, 0.58),
    "opening": (0.82, 0.78, 0.50),
}
"""Colours of the groups, as red, green and blue from 0 to 1; those of "cap X+" are those of "cap"."""

OTHER_COLOUR: Colour = (0.70, 0.70, 0.72)


@dataclass(frozen=True, slots=True, eq=False)
class NamedSolid:
    """A TopoDS solid with its name, the labels of its faces in the order of `faces_of`, and its colour.

    Without a colour of its own its faces have those of their groups.
    """

    name: str
    solid: Any
    labels: tuple[str, ...]
    colour: Colour | None = None

    def colour_of(self, label: str) -> Colour:
        """Colour of the faces with a label."""
        return self.colour or find_label_colour(label)


def find_label_colour(label: str) -> Colour:
    """Colour of a group of faces."""
    return LABEL_COLOURS.get(label) or LABEL_COLOURS.get(label.split(" ")[0], OTHER_COLOUR)


def name_axis(normal: Array) -> str | None:
    """The axis along which a unit normal points, "X+" to "Z-", or None."""
    axis = int(np.abs(normal).argmax())
    if abs(normal[axis]) < AXIS_COSINE:
        return None
    return "XYZ"[axis] + ("+" if normal[axis] > 0 else "-")


def label_faces(brep: Brep, outer: str = OUTER_TAG) -> tuple[str, ...]:
    """Label of each face of a boundary representation; `outer` names the group of the faces tagged "cap"."""
    faces = brep.faces
    labels = []
    for tag, index, sense, i in zip(
        faces.tag.tolist(), faces.carrier.tolist(), faces.sense.tolist(), range(len(faces)), strict=True
    ):
        label = LABEL_OF_TAG.get(brep.tags[tag], brep.tags[tag])
        if label == OUTER_TAG:
            label, carrier = outer, brep.carriers[index]
            if isinstance(carrier, Plane):
                motion = faces.motion[i]
                normal = sense * float(motion.handedness) * motion.apply_to_vectors(carrier.normal)
                axis = name_axis(normal)
                label = outer if axis is None else f"{outer} {axis}"
        labels.append(label)
    return tuple(labels)


def order_labels(shape: Any, faces: Sequence[TopoDS_Face], labels: Sequence[str]) -> tuple[str, ...]:
    """Labels of `faces_of(shape)`, given those of the same faces in another order."""
    of_face = {ShapeKey(face): label for face, label in zip(faces, labels, strict=True)}
    return tuple(of_face[ShapeKey(face)] for face in faces_of(shape))


def label_outer_faces(shape: Any, outer: str) -> tuple[str, ...]:
    """`outer` for each face of `faces_of(shape)`, with the axis that it faces if it is planar and along one: "body X+"."""
    labels = []
    for face in faces_of(shape):
        surface, axis = BRepAdaptor_Surface(face, False), None
        if surface.GetType() == GeomAbs_Plane:
            frame = surface.Plane().Position()
            axis = name_axis(np.cross(frame.XDirection().Coord(), frame.YDirection().Coord()) * orientation_sign(face))
        labels.append(outer if axis is None else f"{outer} {axis}")
    return tuple(labels)


def label_shape_faces(shape: Any, patches: Brep, outer: str = "body") -> tuple[str, ...]:
    """Label of each face of `faces_of(shape)`: that of the lattice patch on which it lies, else `outer` with its axis.

    `patches` are those of the lattice of which OCCT made the shape.
    """
    faces = faces_of(shape)
    labels, places, free = list(label_outer_faces(shape, outer)), [], []
    for i, face in enumerate(faces):
        if BRep_Tool.Surface_s(face).DynamicType().Name() == "Geom_BSplineSurface":
            u0, u1, v0, v1 = BRepTools.UVBounds_s(face)
            point = gp_Pnt()
            BRepAdaptor_Surface(face, False).D0(0.5 * (u0 + u1), 0.5 * (v0 + v1), point)
            free.append(i)
            places.append(point.Coord())
    if free:
        for i, tag in zip(free, find_patch_tags(patches, np.array(places)), strict=True):
            if tag is not None:
                labels[i] = LABEL_OF_TAG.get(tag, tag)
    return tuple(labels)


NODES_PER_DIRECTION = 7
"""Nodes of every patch along u and v from which the foot point of a point is sought."""

ON_PATCH_REL_TOL = 1e-6
"""In sizes of the largest patch: distance at which a point lies on a patch."""


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
