"""The three domains of a heat exchanger in a body: body and lattice, two networks, are cut by each other once.

What lies in the lattice is the wall. What does not falls apart into shells, each of which is bounded by one side of the lattice:
those of the upper side are the one channel, those of the lower side the other. Common faces, edges and vertices are the same by
construction.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.spatial import cKDTree

from tpmscad._typing import IntArray
from tpmscad.brep import connectivity
from tpmscad.brep.boundary_representation import Brep, drop_unused_geometry, select_faces
from tpmscad.brep.moments.integral_properties import integrate_faces
from tpmscad.errors import TrimmingError
from tpmscad.kernel.body_import.cad_body import CadBody
from tpmscad.kernel.build.solids import BrepSolids, build_regions
from tpmscad.kernel.measure.validity import is_brep_valid
from tpmscad.kernel.step.face_labels import OPENING
from tpmscad.results.certificate import Check
from tpmscad.results.domain_results import MINUS, PLUS, WALL
from tpmscad.solids.dead_ends import absorb_dead_ends
from tpmscad.solids.matter.joined_matter import JoinedMatter
from tpmscad.solids.matter.lattice_block import LatticeBlock
from tpmscad.trimming.network_boolean import DividedNetwork, divide_network
from tpmscad.trimming.rebuild.network_result import check_closed

SIDES = {"offset+": PLUS, "offset-": MINUS}
"""The channel beside each side of the lattice."""

DIVIDED_NOTE = "trimmed on the patches' parameter domains"
"""The note of a certificate on the method."""


@dataclass(frozen=True, slots=True, eq=False)
class DividedBody:
    """The solids of each domain; those whose solids are missing are not named.

    `moved`: the length by which the lattice was moved, model units. `notes` and `checks`: on the cut.
    """

    domains: Mapping[str, BrepSolids]
    moved: float
    notes: tuple[str, ...]
    checks: tuple[Check, ...] = ()


def divide_body(body: Brep, block: LatticeBlock, kept: Sequence[CadBody] = ()) -> DividedBody:
    """The body divided by the lattice of a block, joined with solids that are kept.

    TrimmingError if the intersection is not resolved, or the kernel rejects a face.
    """
    build = partial(_build_divided, n_body_tags=len(body.tags), absorbs=block.closes_channels)
    if kept:
        found = JoinedMatter(block, kept).divide(body, build)
    else:
        found = divide_network(body, block.patches, build=build, max_shift=block.max_shift, is_cover=True)
    domains, absorbed = found.built
    return DividedBody(domains, found.report.shifted, (DIVIDED_NOTE, *found.report.notes, *absorbed))


def _build_divided(
    cut: DividedNetwork, n_body_tags: int, absorbs: bool
) -> tuple[dict[str, BrepSolids], tuple[str, ...]]:
    """The solids of the domains of a body that a lattice divides."""
    domain = _assign_channels(cut)
    members = [cut.within, *(cut.beyond[domain == name] for name in (PLUS, MINUS))]
    return build_domains(cut.shared, members, cut.reversed_beyond, n_body_tags, absorbs)


def build_domains(
    shared: Brep, members: Sequence[IntArray], reversed_faces: IntArray, n_body_tags: int, absorbs: bool
) -> tuple[dict[str, BrepSolids], tuple[str, ...]]:
    """The solids of wall and channels, on common faces, and a note on dead ends of channels that the wall has absorbed.

    members: the faces of each in `shared`, of which `reversed_faces` bound a channel with the opposite sense, and the first
    `n_body_tags` tags are the body's. TrimmingError if a domain does not close, or the kernel rejects it.
    """
    absorbed: tuple[str, ...] = ()
    moments = integrate_faces(shared)
    if absorbs:
        members, absorbed = absorb_dead_ends(shared, members, reversed_faces, n_body_tags, moments)
    breps = []
    for number, own in enumerate(members):
        part = select_domain(shared, own, reversed_faces if number else None)
        if number:
            own_tags = [OPENING] * n_body_tags + list(part.tags[n_body_tags:])
            part = replace(part, tags=tuple(own_tags))
        check_closed(part)
        breps.append(drop_unused_geometry(part))
    names = [name for name, own in zip((WALL, PLUS, MINUS), members, strict=True) if len(own)]
    breps, members = [b for b in breps if len(b.faces)], [m for m in members if len(m)]
    built = build_regions(shared, breps, members, moments)
    if not all(is_brep_valid(each, of.faces) for each, of in zip(breps, built, strict=True)):
        raise TrimmingError("the kernel's check rejects a domain")
    return dict(zip(names, built, strict=True)), absorbed


def select_domain(shared: Brep, faces: IntArray, reversed_faces: IntArray | None) -> Brep:
    """Some of the faces that all domains share; those of `reversed_faces` bound a channel with the opposite sense."""
    part = select_faces(shared, faces)
    if reversed_faces is None:
        return part
    sense = np.where(np.isin(faces, reversed_faces), -part.faces.sense, part.faces.sense)
    return replace(part, faces=replace(part.faces, sense=sense))


def _assign_channels(cut: DividedNetwork) -> IntArray:
    """The channel, PLUS or MINUS, of each face of `beyond`: that of the lattice's side in its shell, or nearest to it."""
    shared = cut.shared
    beyond = select_faces(shared, cut.beyond)
    count, shell = connectivity.label_shells(beyond)
    tags = np.array(shared.tags)[shared.faces.tag[cut.beyond]]
    channel = np.full(count, "", dtype=object)
    for tag, name in SIDES.items():
        of = np.unique(shell[tags == tag])
        if (channel[of] != "").any():
            raise TrimmingError("a channel touches both sides of the lattice")
        channel[of] = name
    points = shared.vertices[shared.edges.start[shared.uses.edge]]
    face = shared.face_of_use
    all_tags = np.array(shared.tags)[shared.faces.tag[face]]
    if not np.isin(list(SIDES), all_tags).any():  # the lattice does not meet the body: it lies in one channel
        return np.full(len(shell), PLUS)
    for s in np.flatnonzero(channel == "").tolist():  # a part of the body that the lattice does not meet
        at = points[np.isin(face, cut.beyond[shell == s])][:1]
        near = {tag: cKDTree(points[all_tags == tag]).query(at)[0][0] for tag in SIDES if (all_tags == tag).any()}
        channel[s] = SIDES[min(near, key=near.__getitem__)]
    return channel[shell]
