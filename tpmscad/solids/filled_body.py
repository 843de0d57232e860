"""A body filled with matter, as one certified solid."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from tpmscad.errors import InvalidRequest, KernelError, TrimmingError
from tpmscad.kernel.boolean.cut_faces import label_cut_solids
from tpmscad.kernel.build.solids import BrepSolids
from tpmscad.results.model import Model
from tpmscad.solids.bodies.body_choice import Body
from tpmscad.solids.bodies.kernel_body import KernelBody
from tpmscad.solids.cut import Finish, MadeSolids, Matter, cut_on_parameters, intersect
from tpmscad.solids.finished_model import finish_model
from tpmscad.solids.matter.joined_matter import JoinedMatter
from tpmscad.solids.passive_regions import NO_REGIONS, PassiveRegions
from tpmscad.solids.skins.filled_skin import fill_within_skin
from tpmscad.stage_timer import StageTimer, show_activity


def fill_body(
    body: Body,
    matter: Matter,
    skin: float | None,
    loose: str,
    stages: StageTimer,
    passive: PassiveRegions = NO_REGIONS,
    name: str | None = None,
) -> Model:
    """The body filled with matter, behind a skin if there is one; EmptyInfill if no matter lies in it.

    passive: what the result contains, and what stays empty. name: of the model, by default that of the matter.
    """
    remake = None
    with stages("trim"):
        if skin is not None:
            made, passive = _fill_within_skin(body, matter, skin, passive)
        else:
            made, passive, filling = _intersect(body, matter, passive)
            remake = partial(_intersect_moved, body, filling, passive)
    return finish_model(
        name or matter.name,
        replace(
            made,
            measures=body.join_measures(made.measures),
            notes=(*body.notes, *made.notes),
            label=lambda solids: label_cut_solids(solids, matter.patches, body.cad, has_skin=skin is not None),
        ),
        loose,
        stages,
        envelope=body.envelope,
        distance=matter.distance,
        passive=passive,
        remake=remake,
    )


def _intersect(body: Body, matter: Matter, passive: PassiveRegions) -> tuple[MadeSolids, PassiveRegions, Matter]:
    """What matter, joined with what is kept within a body, has in common with it; what is still to be combined; that matter."""
    cad = body.cad if isinstance(body, KernelBody) else None
    left = replace(passive, within=())
    if not passive.within:
        return intersect(body, matter, cad), left, matter
    joined = JoinedMatter(matter, passive.within)
    try:
        made = intersect(body, joined, cad)
    except (TrimmingError, KernelError) as error:
        show_activity(f"the kernel's boolean, after {error}")
        return intersect(body, matter, cad), passive.cut_within(body.cad), matter
    told = tuple(f"{each.name} is contained, as far as it lies in {body.name}" for each in passive.within)
    return replace(made, notes=(*made.notes, *told)), left, joined


def _intersect_moved(body: Body, matter: Matter, passive: PassiveRegions, finish: Finish) -> tuple[BrepSolids, float]:
    """What matter and body have in common, finished, the matter moved where that is needed.

    InvalidRequest where faces of what is kept or cleared lie in those of the body, whatever the placement of the matter.
    """
    if passive.touch(body.read(matter.measures.tol).brep):
        raise InvalidRequest("the solid is not moved")
    cut = cut_on_parameters(body, matter, finish=finish)
    return cut.built, cut.moved


def _fill_within_skin(
    body: Body, matter: Matter, skin: float, passive: PassiveRegions
) -> tuple[MadeSolids, PassiveRegions]:
    """The body filled within its skin, what is kept included, and what is still to be cleared.

    What is kept is taken from the voids, so that its faces in those of the body, as the ends of a boss have, are no matter.
    """
    if not passive.kept + passive.within:
        return fill_within_skin(body, matter, skin), passive
    passive.require_inside(body, ", which has a skin")
    made = fill_within_skin(body, matter, skin, passive.carve)
    own = replace(passive.cut_within(body.cad), cleared=())
    checked = own.check(made, made.before, made.contains, "taken from the voids within the skin")
    return replace(checked, contains=lambda p: made.contains(p) | own.hold(p)), PassiveRegions((), passive.cleared)
