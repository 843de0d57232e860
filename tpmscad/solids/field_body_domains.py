"""The three domains of a heat exchanger in the solid of a field: body and lattice, two networks, are cut by each other once.

What lies in the lattice is the wall. What does not falls apart into shells, each of which is bounded by one side of the lattice:
those of the upper side are the one channel, those of the lower side the other. Common faces, edges and vertices are the same by
construction.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from tpmscad._typing import IntArray
from tpmscad.brep import connectivity
from tpmscad.brep.boundary_representation import Brep, drop_unused_geometry, select_faces
from tpmscad.brep.moments import integral_properties
from tpmscad.errors import TrimmingError
from tpmscad.kernel.build.solids import BrepSolids, build_regions
from tpmscad.kernel.measure.validity import is_brep_valid
from tpmscad.kernel.step.face_labels import OPENING
from tpmscad.results.domain_results import MINUS, PLUS, WALL
from tpmscad.solids.field_bodies import FieldBody
from tpmscad.solids.field_body_infill import CUT_NOTE
from tpmscad.solids.lattice_block import LatticeBlock
from tpmscad.trimming.network_boolean import DividedNetwork, divide_network
from tpmscad.trimming.rebuild.network_result import check_closed

SIDES = {"offset+": PLUS, "offset-": MINUS}
"""The channel beside each side of the lattice."""


def divide_field_body(body: FieldBody, block: LatticeBlock) -> tuple[dict[str, BrepSolids], float, tuple[str, ...]]:
    """The solids of each domain, the length by which the lattice was moved, and notes on the cut.

    TrimmingError if the intersection is not resolved, or the kernel rejects a face.
    """
    found = divide_network(
        body.built.brep, block.patches, build=_build_domains, max_shift=block.max_shift, is_cover=True
    )
    return found.built, found.report.shifted, (CUT_NOTE, *found.report.notes)


def body_areas(brep: Brep, body: FieldBody) -> dict[int, float]:
    """The area of a domain on the faces of each tag of the body, by the tag's number."""
    own = len(body.built.brep.tags)  # the tags of the first network come first
    area = np.bincount(brep.faces.tag, integral_properties.integrate_faces(brep).area, len(brep.tags))
    return dict(enumerate(area[:own].tolist()))


def _build_domains(cut: DividedNetwork) -> dict[str, BrepSolids]:
    """The solids of the domains, on common faces."""
    shared = cut.shared
    domain = _assign_channels(cut)
    members = [cut.within, *(cut.beyond[domain == name] for name in (PLUS, MINUS))]
    breps = []
    for number, own in enumerate(members):
        own_sense = shared.faces.sense[own]
        if number:
            own_sense = np.where(np.isin(own, cut.reversed_beyond), -own_sense, own_sense)
        part = select_faces(shared, own)
        part = replace(part, faces=replace(part.faces, sense=own_sense))
        if number:
            part = replace(part, tags=tuple(tag if tag in SIDES else OPENING for tag in part.tags))
        check_closed(part)
        breps.append(drop_unused_geometry(part))
    built = build_regions(shared, breps, members)
    if not all(is_brep_valid(each, of.faces) for each, of in zip(breps, built, strict=True)):
        raise TrimmingError("the kernel's check rejects a domain")
    return dict(zip((WALL, PLUS, MINUS), built, strict=True))


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
    for s in np.flatnonzero(channel == "").tolist():  # a part of the body that the lattice does not meet
        at = points[np.isin(face, cut.beyond[shell == s])][:1]
        near = {tag: cKDTree(points[all_tags == tag]).query(at)[0][0] for tag in SIDES if (all_tags == tag).any()}
        channel[s] = SIDES[min(near, key=near.__getitem__)]
    return channel[shell]
