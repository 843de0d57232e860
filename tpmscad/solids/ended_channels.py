"""The channels of a heat exchanger that end a skin before the faces at which they do not open, with creases.

A channel is what lies beyond one side of the wall in the body eroded by the skin at its closed faces. The channels are cut out of
the body, so that the three domains have common faces, edges and vertices by construction.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from tpmscad._typing import Array, BoolArray
from tpmscad.brep.boundary_representation import Brep, drop_unused_geometry, select_faces
from tpmscad.brep.solid_properties import measure_solid
from tpmscad.erosion.hollowed_body import divide_by_voids
from tpmscad.errors import InvalidRequest, KernelError, NothingLeft, TrimmingError
from tpmscad.fallbacks import Fallback, Fallbacks, Outcome
from tpmscad.kernel.body_import.body_brep import FreeFormBody
from tpmscad.kernel.body_import.cad_body import CadBody
from tpmscad.kernel.boolean.cut_faces import SKIN
from tpmscad.kernel.boolean.hollow_body import resolve_open_faces
from tpmscad.kernel.measure.shape_sampling import contains_points
from tpmscad.requests.channel_openings import ChannelOpenings
from tpmscad.results.domain_results import MINUS, PLUS, WALL
from tpmscad.solids.bodies.kernel_body import KernelBody
from tpmscad.solids.cut import TRIMMED_NOTE, Cut, cut_on_parameters, numerical_failures, read_trimming_body
from tpmscad.solids.divided_body import DIVIDED_NOTE, DividedBody, build_domains
from tpmscad.solids.matter.lattice_block import LatticeBlock
from tpmscad.solids.skins.offset_skin import SKIN_EXCESS, erode_body
from tpmscad.trimming.network_boolean import combine_networks


@dataclass(frozen=True, slots=True)
class ChannelEnds:
    """Where channels open, and the wall (model units) between them and all other faces."""

    openings: ChannelOpenings
    skin: float

    @property
    def openings_of(self) -> dict[str, frozenset[int]]:
        """The numbers of the faces at which each channel opens."""
        return {PLUS: self.openings.plus, MINUS: self.openings.minus}


@dataclass(frozen=True, eq=False)
class ChannelSpace:
    """What a channel may fill: a part of the eroded body without solids that are kept. A `Domain` of a cut."""

    part: KernelBody
    kept: Sequence[CadBody]
    boundary: FreeFormBody

    @property
    def name(self) -> str:
        """The name in messages."""
        return self.part.name

    @property
    def volume(self) -> float:
        """Volume in model units cubed."""
        return measure_solid(self.boundary.brep).volume if self.kept else self.part.volume

    def read(self, tol: float) -> FreeFormBody:
        """The boundary representation."""
        return self.boundary

    def sample(self) -> Array:
        """An even sample (n, 3) of points in it."""
        points = self.part.sample()
        return points[self._are_free(points)]

    def contains(self, points: Array) -> BoolArray:
        """Whether points (n, 3) lie in it."""
        return self.part.contains(points) & self._are_free(points)

    def _are_free(self, points: Array) -> BoolArray:
        """Whether points (n, 3) lie in none of the solids that are kept."""
        free = np.ones(len(points), bool)
        for body in self.kept:
            free[free] = ~contains_points(body.shape, points[free])
        return free


def end_channels(body: KernelBody, block: LatticeBlock, ends: ChannelEnds, kept: Sequence[CadBody] = ()) -> DividedBody:
    """The body divided by the wall of a block into domains of which each channel ends a skin before its closed faces.

    Solids that are kept are wall. InvalidRequest if nothing is deeper than the skin, TrimmingError and KernelError as of a cut.
    """
    opened = ends.openings_of
    outcomes = {
        name: _cut_channel(body, take_side(block, tag), opened[name], ends.skin, kept)
        for name, tag in ((PLUS, "offset+"), (MINUS, "offset-"))
    }
    cuts = {name: outcome.value for name, outcome in outcomes.items()}
    read = body.read(block.measures.tol)
    with numerical_failures():
        voids = {name: [cut.built.brep for cut in of] for name, of in cuts.items()}
        is_open = np.isin(np.arange(len(body.face_labels)), [*opened[PLUS], *opened[MINUS]])
        divided = divide_by_voids(read.brep, voids[PLUS] + voids[MINUS], is_open[read.brep.faces.tag])
        n_plus = len(voids[PLUS])
        none = np.zeros(0, np.int64)
        channels = [np.concatenate([none, *of]) for of in (divided.voids[:n_plus], divided.voids[n_plus:])]
        common = np.intersect1d(np.concatenate(channels), divided.left)
        members = [divided.left, *channels]
        domains, absorbed = build_domains(divided.shared, members, common, len(read.brep.tags), absorbs=True)
    every = cuts[PLUS] + cuts[MINUS]
    deeper = [
        f"{name} ends {SKIN_EXCESS:g} of the skin deeper: {outcome.reasons}"
        for name, outcome in outcomes.items()
        if outcome.failures
    ]
    told = dict.fromkeys(note for cut in every for note in cut.notes if note != TRIMMED_NOTE)
    wall = domains[WALL].nesting.volume.sum() / body.volume
    ended = f"each channel ends {ends.skin:g} before the faces where it does not open; {wall:.0%} of the body is wall"
    return DividedBody(
        domains,
        max((cut.moved for cut in every), default=0.0),
        (DIVIDED_NOTE, ended, *deeper, *read.notes, *told, *absorbed),
        tuple(cut.check for cut in every),
    )


def take_side(block: LatticeBlock, tag: str) -> LatticeBlock:
    """The lattice up to one side of its wall, whose matter is all that the channel beyond that side is not."""
    patches = block.patches
    return replace(block, patches=drop_unused_geometry(select_faces(patches, patches.faces_with_tag(tag))))


def _cut_channel(
    body: KernelBody, matter: LatticeBlock, opened: frozenset[int], skin: float, kept: Sequence[CadBody]
) -> Outcome[list[Cut]]:
    """What the matter leaves of what a channel may fill.

    What is kept, or an edge of the lattice, may lie in a plane at just the depth asked for: then the channel ends deeper.
    """
    parts = _erode(body, opened, skin)
    remedy = "change `skin` a little, or shift the lattice by `phase`"
    methods = (
        Fallback("channels that end at the skin", lambda: _cut_parts(parts, matter, kept), "a second"),
        Fallback(
            "channels that end a ten-thousandth deeper",
            lambda: _cut_parts(_erode(body, opened, (1 + SKIN_EXCESS) * skin), matter, kept),
            "two to four seconds",
        ),
    )
    return Fallbacks(methods, retry_on=(TrimmingError, KernelError), final=(InvalidRequest,), remedy=remedy).run()


def _erode(body: KernelBody, opened: frozenset[int], skin: float) -> Sequence[CadBody]:
    """The parts of the body deeper than the skin below the faces where a channel does not open."""
    if len(opened) == len(body.face_labels):
        return [body.cad]
    try:
        return erode_body(body.cad, skin, resolve_open_faces(body.cad, sorted(opened), "openings")).parts
    except (TrimmingError, KernelError) as error:
        gradual = "give a positive `transition`, over which channels close gradually"
        raise TrimmingError(
            f"channels cannot end {skin:g} before the faces of {body.name}: {error}, or {gradual}"
        ) from error


def _cut_parts(parts: Sequence[CadBody], matter: LatticeBlock, kept: Sequence[CadBody]) -> list[Cut]:
    """What the matter, and what is kept, leave of the parts of the eroded body."""
    cuts = []
    for part in parts:
        with suppress(NothingLeft):
            cuts.append(cut_on_parameters(_free_space(KernelBody(part), kept), matter, "difference"))
    return cuts


def _free_space(part: KernelBody, kept: Sequence[CadBody]) -> ChannelSpace:
    """What a channel may fill of a part of the eroded body."""
    read = part.read(None)
    brep: Brep = replace(read.brep, tags=(SKIN,) * len(read.brep.tags))
    for body in kept:
        brep = combine_networks(brep, read_trimming_body(body).brep, "difference", may_move=False).brep
    return ChannelSpace(part, kept, replace(read, brep=brep))
