"""Names and colours of faces in files, by the group that a face belongs to.

The groups are the two sides of a lattice ("surface +" and "surface -"), the level set of a field ("surface"), gap faces ("gap"),
each face of a body that was filled ("body 3", with the name that its file gives it: "body 3 mounting face"), the inner side of a
skin ("skin"), and what closes a lattice at a box ("cap") or a channel at a body ("opening"); the planar ones of the last two have
the axis that they face: "cap X+".
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from OCP.BRepAdaptor import BRepAdaptor_Surface
from OCP.GeomAbs import GeomAbs_Plane

from tpmscad._typing import Array, Colour
from tpmscad.brep.boundary_representation import Brep
from tpmscad.brep.carriers import Plane
from tpmscad.kernel.occt.exploration import faces_of, orientation_sign

LABEL_OF_TAG = {"offset+": "surface +", "offset-": "surface -"}
"""Names of tags in files; other tags are their own names."""

OPENING = "opening"
GROUPS_BY_AXIS = ("cap", OPENING)
"""Tags of faces whose label tells the axis that they face."""

MAX_NAME_CHARACTERS = 50
"""Of a face's name in a file: the names of sets in CalculiX and Abaqus have at most 80, region and number included."""

AXIS_COSINE = 1.0 - 1e-12
"""Cosine of the angle up to which a normal is along an axis: about a millionth of a radian."""

LABEL_COLOURS: Mapping[str, Colour] = {
    "surface": (0.36, 0.56, 0.74),
    "surface +": (0.36, 0.56, 0.74),
    "surface -": (0.87, 0.60, 0.32),
    "gap": (0.62, 0.64, 0.66),
    "cap": (0.78, 0.80, 0.82),
    "body": (0.60, 0.70, 0.58),
    "kept": (0.52, 0.62, 0.50),
    "cleared": (0.66, 0.70, 0.58),
    "skin": (0.72, 0.62, 0.52),
    "opening": (0.82, 0.78, 0.50),
}
"""Colours of the groups, as red, green and blue from 0 to 1; those of "cap X+" are those of "cap"."""

OTHER_COLOUR: Colour = (0.70, 0.70, 0.72)


@dataclass(frozen=True, slots=True, eq=False)
class NamedSolid:
    """A TopoDS solid with its name, the labels of its faces in the order of `faces_of`, and its colour.

    source: the solid, or solids built from arrays, which are made when they are asked for, and its number among them. Without a
    colour of its own its faces have those of their groups. openings: the labels of faces through which a fluid flows.
    """

    name: str
    source: Any
    labels: tuple[str, ...]
    colour: Colour | None = None
    openings: frozenset[str] = frozenset()

    @property
    def solid(self) -> Any:
        """The TopoDS solid."""
        return self.source[0].solids[self.source[1]] if isinstance(self.source, tuple) else self.source

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


def label_faces(brep: Brep) -> tuple[str, ...]:
    """Label of each face of a boundary representation: its tag, with the axis that it faces if it is a planar cap or opening."""
    faces = brep.faces
    labels = []
    for i, (tag, index, sense) in enumerate(
        zip(faces.tag.tolist(), faces.carrier.tolist(), faces.sense.tolist(), strict=True)
    ):
        label, carrier = LABEL_OF_TAG.get(brep.tags[tag], brep.tags[tag]), brep.carriers[index]
        if label in GROUPS_BY_AXIS and isinstance(carrier, Plane):
            motion = faces.motion[i]
            normal = sense * float(motion.handedness) * motion.apply_to_vectors(carrier.normal)
            label = _add_axis(label, normal)
        labels.append(label)
    return tuple(labels)


def _add_axis(label: str, normal: Array) -> str:
    """The label, with the axis if the normal is along one."""
    axis = name_axis(normal)
    return label if axis is None else f"{label} {axis}"


def name_body_face(index: int, name: str = "", role: str = "body") -> str:
    """Label of a face of a body, by its index and its name in the file: "body 3 mounting face" for index 3.

    The number is that of `open_faces` and of `faces()` of the shape. Of the name, letters, digits and the signs _ . - are kept,
    which mesh formats allow, as many as set names hold.
    """
    words = " ".join(re.findall(r"[\w.-]+", name))[:MAX_NAME_CHARACTERS]
    return f"{role} {index} {words}".rstrip()


def label_outer_faces(shape: Any, outer: str) -> tuple[str, ...]:
    """`outer` for each face of `faces_of(shape)`, with the axis that it faces if it is planar and along one: "body X+"."""
    labels = []
    for face in faces_of(shape):
        surface, label = BRepAdaptor_Surface(face, False), outer
        if surface.GetType() == GeomAbs_Plane:
            frame = surface.Plane().Position()
            normal = np.cross(frame.XDirection().Coord(), frame.YDirection().Coord()) * orientation_sign(face)
            label = _add_axis(outer, normal)
        labels.append(label)
    return tuple(labels)
