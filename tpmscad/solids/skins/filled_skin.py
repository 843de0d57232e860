"""A body filled with matter behind a solid skin: the body without what the matter leaves of the cavity within its skin.

The cavity is the part of the body that is deeper than the skin: by offset faces, which keep the thickness exactly, or else by the
distance, up to 1.6 times as thick at edges. The voids that the matter leaves in it touch the body in open faces only, so that
their boundary, reversed, is further shells of the result.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tpmscad._typing import Array, BoolArray
from tpmscad.brep.boundary_representation import Brep, drop_unused_geometry, select_faces
from tpmscad.erosion.hollowed_body import hollow_body
from tpmscad.errors import InvalidRequest, KernelError, LevelSetError, NothingLeft, TrimmingError
from tpmscad.fallbacks import Fallback, Fallbacks
from tpmscad.kernel.boolean.cut_faces import SKIN
from tpmscad.kernel.build.solids import build_faces
from tpmscad.kernel.measure.skin_depth import measure_skin_thickness
from tpmscad.results.certificate import Check
from tpmscad.solids.bodies.body_choice import Body
from tpmscad.solids.bodies.fitted_body import FittedBody
from tpmscad.solids.bodies.kernel_body import KernelBody
from tpmscad.solids.cut import (
    Domain,
    Finish,
    MadeSolids,
    Matter,
    build_valid_solids,
    cut_on_parameters,
    numerical_failures,
)
from tpmscad.solids.skins.distance_skin import erode_by_distance
from tpmscad.solids.skins.offset_skin import check_skin_thickness, describe_thickness, erode_body

Told = tuple[tuple[str, ...], tuple[Check, ...]]
"""Notes on a skin and its checks."""


@dataclass(frozen=True, slots=True, eq=False)
class CavityOfSkin:
    """The parts of a body deeper than its skin, and what is told of the skin, measured on the finished solid's faces."""

    parts: Sequence[Domain]
    describe: Callable[[Brep], Told]

    def contains(self, points: Array) -> BoolArray:
        """Whether points (n, 3) lie in one of the parts."""
        return np.any([part.contains(points) for part in self.parts], axis=0)


def fill_within_skin(body: Body, matter: Matter, skin: float, finish: Finish = build_valid_solids) -> MadeSolids:
    """The body without the voids that the matter leaves in it deeper than the skin, by the first method that succeeds.

    The voids become shells inside one solid, or reach the outside through the open faces. The checks of the result hold the
    measured thickness of the skin. finish: what is made of the voids.
    """
    methods: tuple[Fallback[[Body, Matter, float, Finish], MadeSolids], ...]
    methods = (OFFSET_FACES, DISTANCE) if isinstance(body, KernelBody) else (DISTANCE,)
    return (
        Fallbacks(
            methods,
            retry_on=(KernelError, TrimmingError, LevelSetError),
            final=(InvalidRequest,),
            remedy="shift the lattice by `phase`, or give a larger `tol`",
        )
        .run(body, matter, skin, finish)
        .value
    )


def _fill_cavity(body: Body, matter: Matter, skin: float, cavity: CavityOfSkin, finish: Finish) -> MadeSolids:
    """The body without what the matter leaves of the cavity within its skin."""
    cuts, voids = [], []
    for part in cavity.parts:
        try:
            cut = cut_on_parameters(part, matter, "difference", finish)
        except NothingLeft:
            continue
        cuts.append(cut)
        brep = cut.built.brep
        voids.append(replace(brep, tags=tuple(SKIN if tag in cut.own_tags else tag for tag in brep.tags)))
    if not cuts:
        raise InvalidRequest(f"the lattice leaves no void within a skin of {skin:g}: the body would stay as it is")
    read, is_open = body.read(matter.measures.tol), np.array(body.is_open)
    with numerical_failures():
        brep = hollow_body(read.brep, voids, is_open[read.brep.faces.tag])
        built = build_valid_solids(brep)
    notes, checks = cavity.describe(brep)
    closed = describe_closed_voids(built.n_cavities, body.count_closed_cavities(), bool(is_open.any()))
    told = dict.fromkeys(note for cut in cuts for note in cut.notes)
    moved = max(cut.moved for cut in cuts)
    return MadeSolids(
        built,
        brep,
        matter.measure(built, moved),
        lambda points: body.contains(points) & (matter.contains(points) | ~cavity.contains(points)),
        (*told, *read.notes, *notes, *closed),
        (*(cut.check for cut in cuts), *checks),
        before=body.volume - sum(cut.volume for cut in cuts),
    )


def _fill_by_offset_faces(body: Body, matter: Matter, skin: float, finish: Finish) -> MadeSolids:
    assert isinstance(body, KernelBody)
    eroded = erode_body(body.cad, skin, body.open_faces)

    def describe(brep: Brep) -> Told:
        inner = drop_unused_geometry(select_faces(brep, brep.faces_with_tag(SKIN)))
        measured = measure_skin_thickness(build_faces(inner), eroded.depth)
        return (describe_thickness(measured, skin),), check_skin_thickness(measured, skin)

    return _fill_cavity(body, matter, skin, CavityOfSkin(tuple(map(KernelBody, eroded.parts)), describe), finish)


def _fill_by_distance(body: Body, matter: Matter, skin: float, finish: Finish) -> MadeSolids:
    """As by offset faces, with the skin's inner side on patches of the distance; open faces are refused."""
    if any(body.is_open):
        raise KernelError("skin by the distance", "it cannot leave out open faces")
    try:
        cavity = erode_by_distance(body, skin)
    except InvalidRequest as error:
        if isinstance(body, FittedBody):
            raise  # else offset faces found points that are deeper, between these samples
        raise KernelError("skin by the distance", str(error)) from error
    return _fill_cavity(body, matter, skin, CavityOfSkin((cavity,), lambda _: (cavity.notes, cavity.checks)), finish)


OFFSET_FACES = Fallback("offset faces", _fill_by_offset_faces, "one to three seconds")
DISTANCE = Fallback("the distance from the body's triangles", _fill_by_distance, "one to five minutes")


def describe_closed_voids(voids: int, own: int, opened: bool) -> tuple[str, ...]:
    """Notes on closed voids of the result: `own` of them are cavities of the body itself, the others channels.

    opened: whether the skin has open faces, which the channels then do not reach.
    """
    notes = []
    if voids > own:
        one = voids == own + 1
        count = "a channel" if one else f"{voids - own} channels that do not meet"
        cut_off = (" that no open face reaches" if one else " and that no open face reaches") if opened else ""
        bounded = "it is bounded by a shell" if one else "each is bounded by a shell"
        name = "open another face" if opened else "name open_faces"
        notes.append(
            f"the skin closes off {count}{cut_off}: {bounded} of its own inside the solid; "
            f"{name}, or bore through the skin, to let powder or fluid out"
        )
    if own:
        count = "the body's own cavity stays" if own == 1 else f"the body's own {own} cavities stay"
        notes.append(f"{count} closed: bore into {'it' if own == 1 else 'them'} to let powder or fluid out")
    return tuple(notes)
