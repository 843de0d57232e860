"""Faces of a body by text: numbers, and selectors by where a plane face lies or which way it faces.

">Z" are the plane faces that are highest along z and "<X" those lowest along x, square to the axis; "|Z" are all plane faces
square to z, "#Z" those parallel to it, and "+Z" and "-Z" those whose outward normal is along or against z. A comma or "or"
joins several. The signs are those of CadQuery's selectors, restricted to plane faces.
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

_TERM = re.compile(r"([<>|#+-])([XYZ])|(\d+)", re.IGNORECASE)
_SEPARATOR = re.compile(r"\s*,\s*|\s+or\s+", re.IGNORECASE)

SELECTORS = "`>Z`, `<Z` (the ends of an axis), `|Z` (square to it), `#Z` (along it), `+Z`, `-Z` (by the outward normal)"
"""What the text may hold besides numbers, for messages."""

SAMPLES_PER_FACE = 20
"""Samples of a face of mean area, from which its plane and its place are read."""

FLATNESS_DIAGONALS = 1e-7
"""In diagonals of the body: spread along the axis of the samples of a plane face, and distance of faces in one plane."""

SQUARE_COSINE = 1.0 - 1e-9
SQUARE_SINE = 5e-5
"""Least cosine between the normal of a face and the axis to which it is square, and the largest one if it is along the axis."""


def list_given_faces(faces: Any) -> tuple[Any, ...]:
    """The faces, selectors and numbers given; a single one may stand alone."""
    return (faces,) if isinstance(faces, str) or not isinstance(faces, Iterable) else tuple(faces)


def is_face_selection(text: str) -> bool:
    """Whether every term of the text is a number or a selector."""
    return all(map(_TERM.fullmatch, _split_terms(text)))


def is_numbered(text: str) -> bool:
    """Whether a term of the text is the number of a face."""
    return any(term.isdigit() for term in _split_terms(text))


def resolve_face_selectors(body: CadBody, faces: Any, argument: str = "open_faces") -> tuple[Any, ...]:
    """The faces with every text replaced by the numbers of its faces; InvalidRequest if one is unknown or finds none.

    argument: the name of the argument that gives them, for messages.
    """
    given = list_given_faces(faces)
    if not any(isinstance(face, str) for face in given):
        return given
    planes = _PlaneFaces(body, argument)
    found: list[Any] = []
    for face in given:
        for part in _split_terms(face) if isinstance(face, str) else (face,):
            found += planes.select(part) if isinstance(part, str) else [part]
    return tuple(found)


def _split_terms(text: str) -> list[str]:
    """The terms of a selection."""
    return [term.strip() for term in _SEPARATOR.split(text.strip())]


class _PlaneFaces:
    """The plane faces of a body with their outward normals, and what selects among them."""

    def __init__(self, body: CadBody, argument: str) -> None:
        own = faces_of(body.shape)
        self.body, self.n_faces, self.argument = body, len(own), argument
        self.samples = sample_faces(own, (body.report.area / (SAMPLES_PER_FACE * len(own))) ** 0.5)
        self.tol = FLATNESS_DIAGONALS * float(np.linalg.norm(np.ptp(self.samples.points, axis=0)))
        self.numbers, normals = [], []
        for number in range(len(own)):
            of = self.samples.normals[self.samples.face == number]
            if len(of) and (of @ of[0]).min() > SQUARE_COSINE:
                self.numbers.append(number)
                normals.append(of[0])
        self.normals = np.reshape(normals, (-1, 3))

    def select(self, term: str) -> list[int]:
        """The numbers of the faces that a term names."""
        match = _TERM.fullmatch(term)
        if match is None:
            raise InvalidRequest(
                f"`{self.argument}` {term!r} is no selector: give {SELECTORS}, or the number of a face, with commas between "
                "several"
            )
        if match[3]:
            return [int(match[3])]
        sign, axis = match[1], "XYZ".index(match[2].upper())
        along = self.normals[:, axis]
        if sign in "<>":
            up = 1.0 if sign == ">" else -1.0
            height = up * self.samples.points[:, axis]
            reach = [float(height[self.samples.face == number].min()) for number in self.numbers]
            chosen = (up * along > SQUARE_COSINE) & (height.max() - np.array(reach) < self.tol)
        elif sign == "|":
            chosen = np.abs(along) > SQUARE_COSINE
        elif sign == "#":
            chosen = np.abs(along) < SQUARE_SINE
        else:
            chosen = (along if sign == "+" else -along) > SQUARE_COSINE
        found = [number for number, is_chosen in zip(self.numbers, chosen, strict=True) if is_chosen]
        if not found:
            raise InvalidRequest(
                f"`{self.argument}` {term}: no plane face of {self.body.name} is there; give the number of a face, from 0 to "
                f"{self.n_faces - 1}"
            )
        return found
