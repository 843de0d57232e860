"""The faces of a body at which each channel of a heat exchanger opens."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from tpmscad.errors import InvalidRequest
from tpmscad.kernel.body_import.cad_body import CadBody
from tpmscad.kernel.occt.exploration import faces_of, unwrap
from tpmscad.requests.face_selection import resolve_face_selectors


@dataclass(frozen=True, slots=True)
class ChannelOpenings:
    """Numbers of the faces of a body at which the channels + and - open; a face may be in both."""

    plus: frozenset[int]
    minus: frozenset[int]


def resolve_channel_openings(body: CadBody, openings: Mapping[str, Any]) -> ChannelOpenings:
    """The faces that are named for each channel; InvalidRequest if a channel has none or a face is not the body's."""
    found = {sign: _number_faces(body, openings.get(sign, ())) for sign in "+-"}
    for sign, faces in found.items():
        if not faces:
            raise InvalidRequest(
                f"openings: the channel {sign} opens nowhere, so that no fluid enters it: name its faces, as in "
                """openings={"+": "<X,>X", "-": "<Y,>Y"}"""
            )
    return ChannelOpenings(found["+"], found["-"])


def _number_faces(body: CadBody, faces: Any) -> frozenset[int]:
    """The numbers of faces given as such, as shapes or by selectors."""
    own = faces_of(body.shape)
    numbers = set()
    for face in resolve_face_selectors(body, faces, "openings"):
        shape = unwrap(face)
        if isinstance(shape, int | np.integer):
            matching = [int(shape)] if 0 <= shape < len(own) else []
        else:
            matching = [i for i, each in enumerate(own) if hasattr(shape, "IsSame") and each.IsSame(shape)]
        if not matching:
            raise InvalidRequest(
                f"openings: {face!r} is no face of {body.name}: pass faces of the same shape object, or numbers from 0 to "
                f"{len(own) - 1} in its order"
            )
        numbers.update(matching)
    return frozenset(numbers)
