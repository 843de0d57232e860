"""A box of planar faces on straight edges, made by hand."""

from __future__ import annotations

import numpy as np

from tpmscad._typing import Array
from tpmscad.brep.boundary_representation import Brep, Edges, EdgeUses, Faces
from tpmscad.brep.carriers import Plane
from tpmscad.rigid_motion import Motion
from tpmscad.splines.bspline import line_segment

CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
# Each face counter-clockwise as seen from outside.
SIDES = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])


def plane_box(size=(2.0, 3.0, 5.0), rotation: Array | None = None, translation=(0.0, 0.0, 0.0)) -> Brep:
    """A box of planar faces on straight edges, its corner at the origin, then moved; a mirror will do."""
    rotation = np.eye(3) if rotation is None else rotation
    translation = np.array(translation, float)
    corners = CORNERS * np.array(size)
    planes, uses, senses, edges = [], [], [], {}
    for side in SIDES:
        a, b, _, d = corners[side]
        x, y = (b - a) / np.linalg.norm(b - a), (d - a) / np.linalg.norm(d - a)
        planes.append(Plane(a, x, np.cross(x, y)))
        for i, j in zip(side, np.roll(side, -1), strict=True):
            key = (min(i, j), max(i, j))
            uses.append(edges.setdefault(key, len(edges)))
            senses.append(1 if (i, j) == key else -1)
    ends = np.array(list(edges))
    motion = {n: Motion(np.tile(rotation, (n, 1, 1)), np.tile(translation, (n, 1))) for n in (6, 12)}
    return Brep(
        carriers=tuple(planes),
        curves=tuple(line_segment(corners[i], corners[j]) for i, j in ends),
        pcurves=(),
        vertices=corners @ rotation.T + translation,
        edges=Edges(np.arange(12), motion[12], np.tile([0.0, 1.0], (12, 1)), ends[:, 0], ends[:, 1], np.zeros(12)),
        uses=EdgeUses(np.array(uses), np.array(senses), np.full(24, -1)),
        faces=Faces(
            np.arange(6),
            motion[6],
            np.full(6, round(np.linalg.det(rotation))),  # a mirror turns the normals inwards
            np.arange(6) // 2,
            np.arange(7),
            4 * np.arange(7),
        ),
        tags=("x", "y", "z"),
    )
