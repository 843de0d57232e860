"""A box of planar faces on straight edges."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tpmscad._typing import Array
from tpmscad.brep.boundary_representation import Brep, move_brep
from tpmscad.rigid_motion import Motion
from tpmscad.trimming.operands.polyhedra import polyhedron

CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
# Each face counter-clockwise as seen from outside.
SIDES = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])


def plane_box(size=(2.0, 3.0, 5.0), rotation: Array | None = None, translation=(0.0, 0.0, 0.0)) -> Brep:
    """A box of planar faces on straight edges, its corner at the origin, then moved; a mirror will do."""
    made = polyhedron(CORNERS * np.array(size), SIDES.tolist())
    place = Motion(np.eye(3) if rotation is None else rotation, np.array(translation, float))
    sense = round(np.linalg.det(place.rotation))  # a mirror turns the normals inwards
    faces = replace(made.faces, sense=np.full(6, sense), tag=np.arange(6) // 2)
    return move_brep(replace(made, faces=faces, tags=("x", "y", "z")), place)
