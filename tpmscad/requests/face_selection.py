"""Faces of a body by where they lie: ">Z" for the plane faces that are highest along z, "<X" for those lowest along x.

The selectors are those of CadQuery and build123d for the ends of an axis, restricted to plane faces square to it.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any

import numpy as np

from tpmscad.errors import InvalidRequest
from tpmscad.kernel.body_import.cad_body import CadBody
from tpmscad.kernel.measure.shape_sampling import sample_faces
from tpmscad.kernel.occt.exploration import faces_of

_SELECTOR = re.compile(r"([<>])([XYZ])", re.IGNORECASE)

SAMPLES_PER_FACE = 20
"""Samples of a face of mean area, from which its plane and its place are read."""

FLATNESS_DIAGONALS = 1e-7
"""In diagonals of the body: spread along the axis of the samples of a plane face, and distance of faces in one plane."""

SQUARE_COSINE = 1.0 - 1e-9
"""Least cosine between the normal of a face and the axis to which it is square."""


def list_given_faces(faces: Any) -> tuple[Any, ...]:
    """The faces, selectors and numbers given; a single one may stand alone."""
    return (faces,) if isinstance(faces, str) or not isinstance(faces, Iterable) else tuple(faces)


def resolve_face_selectors(body: CadBody, faces: Any) -> tuple[Any, ...]:
    """The faces with every selector replaced by the numbers of its faces; InvalidRequest if one is unknown or finds none."""
    given = list_given_faces(faces)
    if not any(isinstance(face, str) for face in given):
        return given
    found: list[Any] = []
    for face in given:
        found += _select_extreme_faces(body, face) if isinstance(face, str) else [face]
    return tuple(found)


def _select_extreme_faces(body: CadBody, selector: str) -> list[int]:
    """The numbers of the plane faces that bound the body at one end of an axis."""
    match = _SELECTOR.fullmatch(selector.strip())
    if match is None:
        raise InvalidRequest(
            f"`open_faces` {selector!r} is no selector: give one of >X, <X, >Y, <Y, >Z, <Z, or the number of a face"
        )
    axis, sign = "XYZ".index(match[2].upper()), 1.0 if match[1] == ">" else -1.0
    own = faces_of(body.shape)
    samples = sample_faces(own, (body.report.area / (SAMPLES_PER_FACE * len(own))) ** 0.5)
    tol = FLATNESS_DIAGONALS * float(np.linalg.norm(np.ptp(samples.points, axis=0)))
    height = sign * samples.points[:, axis]
    is_square = sign * samples.normals[:, axis] > SQUARE_COSINE
    top = float(height.max())
    chosen = [
        number
        for number in range(len(own))
        if (own_samples := samples.face == number).any()
        and is_square[own_samples].all()
        and top - height[own_samples].min() < tol
    ]
    if not chosen:
        raise InvalidRequest(
            f"`open_faces` {selector}: no plane face bounds {body.name} there; give the number of a face, from 0 to "
            f"{len(own) - 1}"
        )
    return chosen
