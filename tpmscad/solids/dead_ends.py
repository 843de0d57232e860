"""Pieces of a channel that only the cut by the body separates, and through which nothing flows: they become wall.

A piece that meets no face of the body is a dead end, and so is a small one that meets one, and a chip. The wall takes it in: the
faces between both are dropped, and the piece's faces on the body become the wall's, with an edge where the two meet. Greater
pieces stay what they are.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tpmscad._typing import BoolArray, IntArray
from tpmscad.brep import connectivity
from tpmscad.brep.boundary_representation import Brep, select_faces
from tpmscad.brep.moments import integral_properties
from tpmscad.results.certificate import CHIP_VOLUME_FRACTION

MAX_DEAD_END_VOLUME_FRACTION = 0.1
"""Volume of a piece at one face of the body, relative to the greatest of its channel, up to which it becomes wall."""


def absorb_dead_ends(
    shared: Brep,
    members: Sequence[IntArray],
    reversed_faces: IntArray,
    n_body_tags: int,
    moments: integral_properties.FaceMoments,
) -> tuple[list[IntArray], tuple[str, ...]]:
    """The faces of the wall, the first domain, with the dead ends of the channels, those of the channels, and a note on these.

    Those of `reversed_faces` have the opposite sense in the channels. Faces with the first `n_body_tags` tags lie on the body.
    `moments` are those of the faces of `shared`.
    """
    volumes: list[float] = []
    wall, channels = members[0], []
    for own in members[1:]:
        measured = moments.select(own, np.isin(own, reversed_faces))
        is_dead, found = _find_dead_ends(select_faces(shared, own), n_body_tags, measured)
        volumes += found
        wall = np.setxor1d(wall, own[is_dead])
        channels.append(own[~is_dead])
    if not volumes:
        return list(members), ()
    what = f"{len(volumes)} dead ends" if len(volumes) > 1 else "a dead end"
    note = f"{what} of the channels, of up to {max(volumes):.3g} mm3, that the body cuts off became wall"
    return [wall, *channels], (note,)


def _find_dead_ends(
    channel: Brep, n_body_tags: int, moments: integral_properties.FaceMoments
) -> tuple[BoolArray, list[float]]:
    """Whether each face of a channel bounds a dead end, and the volumes of the dead ends, model units cubed."""
    count, shell = connectivity.label_shells(channel)
    if count < 2:
        return np.zeros(len(channel.faces), bool), []
    volume = integral_properties.volume(moments, shell)
    tag = channel.faces.tag
    n_faces = np.array([len(np.unique(tag[(shell == k) & (tag < n_body_tags)])) for k in range(count)])
    fractions = np.array([np.inf, MAX_DEAD_END_VOLUME_FRACTION, CHIP_VOLUME_FRACTION])
    limit = fractions[np.minimum(n_faces, 2)] * volume.max()
    is_dead = (volume > 0) & (volume <= limit)
    return is_dead[shell], volume[is_dead].tolist()
