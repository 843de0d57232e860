"""Validity of solids that were built from a boundary representation, each thing said once.

A rigid copy of a face that the kernel accepts is as valid as the face, so that the kernel checks one face of each class
(`tpmscad.brep.face_classes`). Planar faces with loops of thousands of edges, which the kernel compares pair by pair, are held
by fattened chords first (`tpmscad.brep.planar_faces`). What the check of a whole solid adds is a matter of arrays: each edge
joins two faces in opposite directions, each loop runs from vertex to vertex, edges end at their vertices, and the nesting of
shells was found when the solids were built.
"""

from __future__ import annotations

from collections.abc import Sequence
from weakref import WeakKeyDictionary

import numpy as np
from OCP.TopoDS import TopoDS_Face

from tpmscad._typing import IntArray
from tpmscad.brep import connectivity
from tpmscad.brep.boundary_representation import Brep, drop_unused_geometry, select_faces
from tpmscad.brep.face_classes import group_congruent_faces
from tpmscad.brep.planar_faces import find_simple_planar_faces
from tpmscad.kernel.build.edges import end_misses
from tpmscad.kernel.build.solids import build_faces
from tpmscad.kernel.measure.shape_report import is_valid
from tpmscad.kernel.occt.construction import make_compound
from tpmscad.kernel.occt.convert import CONFUSION_TOLERANCE

CLASS_RESOLUTION = 0.1 * CONFUSION_TOLERANCE
"""Faces that differ by less belong to one class: a tenth of the least tolerance of the kernel's check."""

_faces_to_check: WeakKeyDictionary[Brep, IntArray] = WeakKeyDictionary()
"""What was found for solids that still exist: the check of a solid and that of its file ask for the same faces."""

MAX_END_MISS = 10.0
"""Distance of a vertex from the ends of its edges in tolerances of these. Below one in all solids measured; the tolerance of the
kernel's vertex would cover any distance, and faces that are not given to the kernel would hide it."""


def is_brep_valid(brep: Brep, faces: Sequence[TopoDS_Face] | None = None) -> bool:
    """Whether the boundary is closed, its loops are connected, and the kernel accepts a face of each class.

    `faces` are the kernel's faces of `brep`, in its order; without them those that are checked are made.
    """
    if not connectivity.is_closed(brep) or len(connectivity.find_broken_loops(brep)):
        return False
    if (end_misses(brep) > MAX_END_MISS * np.maximum(CONFUSION_TOLERANCE, brep.edges.deviation)[:, None]).any():
        return False
    checked = find_faces_to_check(brep)
    if not len(checked):
        return True
    if faces is None:
        return is_valid(make_compound(build_faces(drop_unused_geometry(select_faces(brep, checked)))))
    return is_valid(make_compound(faces[i] for i in checked.tolist()))


def find_faces_to_check(brep: Brep) -> IntArray:
    """A face of each class of congruent faces, but for the planar ones that are simple beyond doubt: (n,)."""
    if brep not in _faces_to_check:
        first = group_congruent_faces(brep, CLASS_RESOLUTION).first
        _faces_to_check[brep] = first[~find_simple_planar_faces(brep, CONFUSION_TOLERANCE, first)]
    return _faces_to_check[brep]
