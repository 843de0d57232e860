"""Pieces of a channel that only the cut by the body separates, and through which nothing flows: they become wall.

A piece that meets at most one face of the body is a dead end, and so is a chip. The wall takes it in: the faces between both are
dropped, and the piece's faces on the body become the wall's, with an edge where the two meet. Greater pieces stay what they are.
"""

from __future__ import annotations

import numpy as np

from tpmscad._typing import BoolArray, IntArray
from tpmscad.brep import connectivity
from tpmscad.brep.boundary_representation import Brep, drop_unused_geometry, select_faces
from tpmscad.brep.moments import integral_properties
from tpmscad.results.certificate import CHIP_VOLUME_FRACTION
from tpmscad.trimming.rebuild.trimmed_brep import TrimmedDomains

MAX_DEAD_END_VOLUME_FRACTION = 0.1
"""Volume of a piece at one face of the body, relative to the greatest of its channel, up to which it becomes wall."""


def absorb_dead_ends(trimmed: TrimmedDomains, n_lattice_tags: int) -> tuple[TrimmedDomains, tuple[str, ...]]:
    """The wall, the first domain, with the dead ends of the channels, the others, and a note on these.

    Faces with tags from `n_lattice_tags` on lie on the body.
    """
    volumes: list[float] = []
    wall, members, breps = trimmed.members[0], [], []
    for brep, own in zip(trimmed.breps[1:], trimmed.members[1:], strict=True):
        is_dead, found = _find_dead_ends(brep, n_lattice_tags)
        volumes += found
        wall = np.setxor1d(wall, own[is_dead])
        members.append(own[~is_dead])
        breps.append(_select(brep, np.flatnonzero(~is_dead)) if found else brep)
    if not volumes:
        return trimmed, ()
    what = f"{len(volumes)} dead ends" if len(volumes) > 1 else "a dead end"
    note = f"{what} of the channels, of up to {max(volumes):.3g} mm3, that the body cuts off became wall"
    return TrimmedDomains((_select(trimmed.shared, wall), *breps), trimmed.shared, (wall, *members)), (note,)


def _select(brep: Brep, faces: IntArray) -> Brep:
    """Some faces, in their order."""
    return drop_unused_geometry(select_faces(brep, faces))


def _find_dead_ends(channel: Brep, n_lattice_tags: int) -> tuple[BoolArray, list[float]]:
    """Whether each face bounds a dead end, and the volumes of the dead ends, model units cubed."""
    count, shell = connectivity.label_shells(channel)
    if count < 2:
        return np.zeros(len(channel.faces), bool), []
    volume = integral_properties.volume(integral_properties.integrate_faces(channel), shell)
    tag = channel.faces.tag
    n_faces = np.array([len(np.unique(tag[(shell == k) & (tag >= n_lattice_tags)])) for k in range(count)])
    limit = np.where(n_faces < 2, MAX_DEAD_END_VOLUME_FRACTION, CHIP_VOLUME_FRACTION) * volume.max()
    is_dead = (volume > 0) & (volume <= limit)
    return is_dead[shell], volume[is_dead].tolist()
