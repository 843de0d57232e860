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

from tpmscad._typing import BoolArray, IntArray
from tpmscad.brep import connectivity
from tpmscad.brep.boundary_representation import Brep, drop_unused_geometry, select_faces
from tpmscad.brep.face_classes import group_congruent_faces
from tpmscad.brep.planar_faces import find_simple_planar_faces
from tpmscad.kernel.build.edges import end_misses
from tpmscad.kernel.build.solids import build_faces
from tpmscad.kernel.measure.shape_report import is_valid
from tpmscad.kernel.occt.construction import make_compound
from tpmscad.kernel.occt.convert import CONFUSION_TOLERANCE
from tpmscad.splines.bspline import BSplineSurface

CLASS_RESOLUTION = 0.1 * CONFUSION_TOLERANCE
"""Faces that differ by less belong to one class: a tenth of the least tolerance of the kernel's check."""

MAX_UNGROUPED_FRACTION = 0.1
"""Greatest fraction of faces that may be congruent to others for which classes are not sought: to find them takes as long as the
kernel's check of half the faces, and saves that of a tenth of them at most."""

NO_POLES = (np.zeros(3), np.zeros(3))

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
        first = _find_class_representatives(brep)
        _faces_to_check[brep] = first[~find_simple_planar_faces(brep, CONFUSION_TOLERANCE, first)]
    return _faces_to_check[brep]


def _find_class_representatives(brep: Brep) -> IntArray:
    """A face of each class of congruent faces: (n,); of all faces where few of them can be congruent to another."""
    if np.count_nonzero(_have_like_carriers(brep)) > MAX_UNGROUPED_FRACTION * len(brep.faces):
        return group_congruent_faces(brep, CLASS_RESOLUTION).first
    return np.arange(len(brep.faces))


def _have_like_carriers(brep: Brep) -> BoolArray:
    """Whether the carrier of a face (F,) is that of another face, or has the same first and last pole as that of another.

    Congruent faces have equal carriers. Carriers other than spline surfaces count as equal.
    """
    ends = [(c.poles[0, 0], c.poles[-1, -1]) if isinstance(c, BSplineSurface) else NO_POLES for c in brep.carriers]
    ticks = np.rint(np.array(ends).reshape(-1, 6) / CLASS_RESOLUTION).astype(np.int64)
    _, name = np.unique(ticks, axis=0, return_inverse=True)
    face = name.ravel()[brep.faces.carrier]
    return np.asarray(np.bincount(face, minlength=1)[face] > 1)
