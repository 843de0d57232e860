"""The three domains of a heat exchanger: the wall of a sheet lattice in a body, and the two channels that it separates.

Lattice and body are cut by each other once (`divided_body`); common faces, edges and vertices are the same by construction. Where
that fails, the kernel splits the body by the lattice's surfaces. Channels that open at some faces only end a skin before the
others (`ended_channels`), or are closed by a wall that grows over a length (`closed_channels`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from tpmscad._typing import Array
from tpmscad.api.public_calls import validate_options
from tpmscad.brep.boundary_representation import Brep
from tpmscad.errors import InvalidRequest, KernelError, MissingDomain
from tpmscad.fallbacks import Fallback, Fallbacks
from tpmscad.kernel.body_import.cad_body import CadBody, read_body
from tpmscad.kernel.boolean.body_split import SplitSolid, split_body
from tpmscad.kernel.boolean.boolean_operations import OcctSolids, subtract_solid
from tpmscad.kernel.boolean.cut_faces import label_cut_solids
from tpmscad.kernel.boolean.hollow_body import is_plane
from tpmscad.kernel.build.solids import BrepSolids
from tpmscad.kernel.measure.mass_properties import measure_face
from tpmscad.kernel.occt.exploration import faces_of
from tpmscad.kernel.step.face_labels import OPENING, label_faces, label_outer_faces
from tpmscad.requests.channel_openings import ChannelOpenings, resolve_channel_openings
from tpmscad.requests.lattice_options import FluidDomainsOptions
from tpmscad.requests.lattice_request import LatticeRequest, lattice_in_body, resolve_lattice_request, rotation_matrix
from tpmscad.results.certificate import (
    Certificate,
    Check,
    certify_built_solids,
    certify_kernel_solids,
    describe_piece,
    require,
)
from tpmscad.results.domain_results import MINUS, PLUS, WALL, FaceContact, FluidDomains
from tpmscad.results.model import Model
from tpmscad.solids.bodies.body_choice import Body, find_body
from tpmscad.solids.bodies.fitted_body import FittedBody
from tpmscad.solids.bodies.kernel_body import KernelBody
from tpmscad.solids.channel_reach import require_connected
from tpmscad.solids.cut import CUT_REMEDY, KERNEL_BOOLEAN, TRIMMED_PATCHES, numerical_failures
from tpmscad.solids.divided_body import DividedBody, divide_body
from tpmscad.solids.ended_channels import ChannelEnds, end_channels
from tpmscad.solids.matter.closed_channels import build_closed_block
from tpmscad.solids.matter.lattice_block import LatticeBlock, build_lattice_block
from tpmscad.solids.passive_regions import PassiveRegions
from tpmscad.stage_timer import StageTimer

TOTAL_VOLUME_RTOL = 1e-6
"""Largest difference between the sum of the domains' volumes and the body's volume, relative to the latter."""


@validate_options(FluidDomainsOptions, 'fluid_domains(body, "gyroid", cell=10, thickness=1)')
def fluid_domains(options: FluidDomainsOptions) -> FluidDomains:
    """Divide a body into the wall of a sheet lattice and the two channels beside it, as solids that share their faces.

    Returns
    -------
    FluidDomains
        The three domains. The notes of its certificate list disconnected pieces and the domains on each face of the body.

    Raises
    ------
    InvalidRequest
        If the request cannot be carried out; the message names the value, the limit and the remedy.
    MissingDomain
        If the body holds no part of one of the domains (an InvalidRequest).
    KernelError
        If trimming and splitting fail.

    Examples
    --------
    >>> import build123d as bd, tpmscad
    >>> parts = tpmscad.fluid_domains(bd.Box(20, 10, 10), "gyroid", cell=10, thickness=1)  # doctest: +SKIP
    >>> parts.export_step("exchanger.step")  # doctest: +SKIP
    """
    stages = StageTimer(options.progress)
    asked = prepare_domains(options, stages)
    request, body, openings, ends = asked.request, asked.body, asked.openings, asked.ends
    turn, length, kept = asked.rotation, asked.length, asked.kept
    if openings is None or not length:
        block = build_lattice_block(request, turn, body.cad, stages)
    else:
        block = build_closed_block(request, turn, body.cad, openings, length, options.skin, stages)
    with stages("trim"):
        found = _compute_domains(block, body, kept, ends)
    block = replace(block, measures=body.join_measures(block.measures))
    centres = [measure_face(face)[1] for face in faces_of(body.cad.shape)] if isinstance(body, KernelBody) else []
    touches = tuple(
        FaceContact(
            face,
            label,
            {name: domain.areas[face] for name, domain in found.items() if domain.areas.get(face, 0.0) > 0},
            centres[face] if centres else None,
        )
        for face, label in body.face_labels.items()
    )
    with stages("check"):
        certificates, volume = _certify_domains(found, touches, block, body, openings)
    models = {
        name: Model(
            name,
            block.patches if domain.brep is None else domain.brep,
            certificates[name].with_seconds(stages.seconds),
            domain.built,
            trimmed_by=KERNEL_BOOLEAN if domain.brep is None else TRIMMED_PATCHES,
            is_fluid=name != WALL,
            envelope=body.envelope,
            openings=frozenset() if name == WALL else _find_openings(domain),
        )
        for name, domain in found.items()
    }
    name = f"{request.surface} exchanger"
    wall, plus, minus = (models[domain] for domain in (WALL, PLUS, MINUS))
    return FluidDomains(name, wall, plus, minus, touches, volume, request.surface, request.cell, request.even_offset)


@dataclass(frozen=True, slots=True, eq=False)
class DomainSolids:
    """The solids of a domain, largest first, its areas by face of the body, and notes on the method.

    `brep` bounds the solids if the patches were trimmed; `moved` is the length of the lattice's translation, model units;
    `checks` are those of the cut.
    """

    built: BrepSolids | OcctSolids
    brep: Brep | None
    areas: Mapping[int, float]
    notes: tuple[str, ...]
    moved: float = 0.0
    checks: tuple[Check, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class RequestedDomains:
    """What is asked of fluid domains: the lattice, turned by `rotation` (3, 3), the body, and the solids that are kept.

    `ends`: where they end abruptly; else they close over `length`, model units.
    """

    request: LatticeRequest
    body: Body
    kept: tuple[CadBody, ...]
    openings: ChannelOpenings | None
    rotation: Array
    ends: ChannelEnds | None
    length: float


def prepare_domains(options: FluidDomainsOptions, stages: StageTimer) -> RequestedDomains:
    """The valid request of the options; InvalidRequest, too, if samples say that a channel does not connect its openings."""
    request = resolve_lattice_request(lattice_in_body(options))
    body = find_body(options.body, options.box, options.solid, request.tol, stages, is_default=options.tol is None)
    with stages("read"):
        body, kept = _read_passive(body, options)
        openings = _resolve_openings(options, body)
    turn = rotation_matrix(options.rotation)
    ends, length = None, 0.0
    if openings is not None:
        assert isinstance(body, KernelBody)
        length = _resolve_transition(body, openings, options.transition, request)
        if not length:
            ends = ChannelEnds(openings, _resolve_skin(request, options.skin))
            with stages("sample"):
                require_connected(body, request, turn, ends)
    return RequestedDomains(request, body, kept, openings, turn, ends, length)


def _resolve_openings(options: FluidDomainsOptions, body: Body) -> ChannelOpenings | None:
    """The faces at which the channels open; None if they open everywhere."""
    if options.openings is None:
        if options.transition is not None:
            raise InvalidRequest("transition is the length over which channels close: give openings=, where they open")
        if options.skin is not None:
            raise InvalidRequest(
                "skin is the wall along faces where channels do not open: give openings=, where they do"
            )
        return None
    if isinstance(body, FittedBody):
        raise InvalidRequest(f"openings are faces of a CAD body; {body.name} has none: leave openings out")
    return resolve_channel_openings(body.cad, options.openings)


def _resolve_transition(
    body: KernelBody, openings: ChannelOpenings, transition: float | None, request: LatticeRequest
) -> float:
    """The length over which channels close: by default 0, or a cell if an opening is not plane, where no end is abrupt."""
    if transition is not None:
        return transition
    own = faces_of(body.cad.shape)
    return 0.0 if all(is_plane(own[number]) for number in openings.plus | openings.minus) else max(request.cell)


def _resolve_skin(request: LatticeRequest, skin: float | None) -> float:
    """The wall along faces where a channel does not open: as thick as the wall between the channels, if that has a thickness."""
    if skin is not None:
        return skin
    if request.even_offset is None:
        raise InvalidRequest(
            "openings: the thickness of this wall varies: give skin=, the wall along faces where channels do not open"
        )
    return float(np.ptp(request.offset))


def _read_passive(body: Body, options: FluidDomainsOptions) -> tuple[Body, tuple[CadBody, ...]]:
    """The body without what is cleared, and the solids in it that are kept, which are wall."""
    if options.keep is None and options.clear is None:
        return body, ()
    if isinstance(body, FittedBody):
        raise InvalidRequest(f"keep and clear are for CAD bodies, which {body.name} is not: leave them out")
    passive = PassiveRegions.read_for(body.cad, True, options.keep, options.clear)
    passive.require_inside(body)
    cad = body.cad
    for each in passive.cleared:
        left = subtract_solid(cad.shape, each.shape)
        if len(left) != 1:
            raise InvalidRequest(
                f"{each.name} leaves {len(left)} solids of {body.name}, not one: divide them one at a time"
            )
        cad = replace(read_body(left[0]), name=cad.name, notes=cad.notes, accuracy=cad.accuracy)
    return replace(body, cad=cad), passive.kept + passive.within


def _find_openings(channel: DomainSolids) -> frozenset[str]:
    """The labels of a channel's faces on the body."""
    built = channel.built
    labels = chain(*built.labels) if isinstance(built, OcctSolids) else label_faces(built.brep)
    return frozenset(label for label in labels if label.split(" ")[0] == OPENING)


def _compute_domains(
    block: LatticeBlock, body: Body, kept: Sequence[CadBody], ends: ChannelEnds | None
) -> dict[str, DomainSolids]:
    """The three domains of a body: cut on the patches' own parameters if possible, else a CAD body is split by the kernel.

    The kernel splits no body in which channels end (`ends`), or solids are kept.
    """
    if ends is not None:
        assert isinstance(body, KernelBody)
        return _collect_domains(end_channels(body, block, ends, kept), block, body)
    methods = (BY_PARAMETERS, BY_KERNEL) if isinstance(body, KernelBody) and not kept else (BY_PARAMETERS,)
    outcome = Fallbacks(methods, remedy=CUT_REMEDY).run(block, body, kept)
    if not outcome.failures:
        return outcome.value
    note = f"split by the kernel: {outcome.reasons}"
    return {name: replace(domain, notes=(note,)) for name, domain in outcome.value.items()}


def _trim_domains(block: LatticeBlock, body: Body, kept: Sequence[CadBody] = ()) -> dict[str, DomainSolids]:
    """The three domains by a cut of the body's faces and the patches; MissingDomain if one is empty."""
    read = body.read(block.measures.tol)
    with numerical_failures():
        divided = divide_body(read.brep, block, kept)
    return _collect_domains(replace(divided, notes=(*divided.notes, *read.notes)), block, body)


def _collect_domains(divided: DividedBody, block: LatticeBlock, body: Body) -> dict[str, DomainSolids]:
    """The three domains of a divided body, with their areas on its faces; MissingDomain if one is empty."""
    result = {}
    for name in (WALL, PLUS, MINUS):
        if name not in divided.domains:
            raise _missing_domain(body, name, block)
        built = divided.domains[name]
        area = np.bincount(built.brep.faces.tag, built.nesting.moments.area, len(built.brep.tags))
        on_body = {face: float(area[face]) for face in body.face_labels}  # the body's tags come first
        result[name] = DomainSolids(built, built.brep, on_body, divided.notes, divided.moved, divided.checks)
    return result


def _split_domains(block: LatticeBlock, body: Body, kept: Sequence[CadBody]) -> dict[str, DomainSolids]:
    """The three domains from the cells into which the kernel splits the body."""
    cells = split_body(body.cad.shape, block.built.shape, _tags_of_kernel_faces(block))
    result = {}
    for name in (WALL, PLUS, MINUS):
        own = [c for c in cells if classify_cell(c) == name]
        if not own:
            raise _missing_domain(body, name, block)
        areas = {face: sum(c.areas.get(face, 0.0) for c in own) for c in own for face in c.areas}
        result[name] = DomainSolids(_label_solids(name, own, block, body.cad), None, areas, ())
    return result


def _label_solids(domain: str, cells: Sequence[SplitSolid], block: LatticeBlock, body: CadBody) -> OcctSolids:
    """The solids of a domain's cells with the labels of their faces; those of a channel on the body are openings."""
    labelled = label_cut_solids([cell.solid for cell in cells], block.patches, body)
    if domain == WALL:
        return labelled
    on_body = set(body.face_labels)
    labels = tuple(
        tuple(opening if label in on_body else label for label, opening in zip(of, openings, strict=True))
        for of, openings in zip(
            labelled.labels, (label_outer_faces(solid, OPENING) for solid in labelled.solids), strict=True
        )
    )
    return replace(labelled, labels=labels)


BY_PARAMETERS: Fallback[[LatticeBlock, Body, Sequence[CadBody]], dict[str, DomainSolids]] = Fallback(
    "trimming on the patches' parameters",
    lambda block, body, kept: _trim_domains(block, body, kept),
    "about a second for ten cells; several with free-form faces",
)
BY_KERNEL: Fallback[[LatticeBlock, Body, Sequence[CadBody]], dict[str, DomainSolids]] = Fallback(
    "splitting by the kernel", _split_domains, "about ten times as long; for free-form faces that leave gaps"
)
"""How a body is divided into the domains."""


def classify_cell(cell: SplitSolid) -> str:
    """The domain of a cell of the split body, by the sides of the lattice's surfaces that bound it."""
    if cell.sides and all(side < 0 for _, side in cell.sides):
        return WALL
    if cell.sides == {("offset+", 1)}:
        return PLUS
    if cell.sides == {("offset-", 1)}:
        return MINUS
    raise KernelError(
        "fluid domains", f"a cell of the body is bounded by {sorted(cell.sides)}, which is neither wall nor channel"
    )


def _tags_of_kernel_faces(block: LatticeBlock) -> list[str]:
    """The tag of every face of the kernel's solid of the block, in the kernel's order."""
    tags = [block.closed.tags[t] for t in block.closed.faces.tag.tolist()]
    by_face = {hash(face): tag for face, tag in zip(block.built.faces, tags, strict=True)}
    return [by_face[hash(face)] for face in faces_of(block.built.shape)]


def _certify_domains(
    domains: Mapping[str, DomainSolids],
    contacts: tuple[FaceContact, ...],
    block: LatticeBlock,
    body: Body,
    openings: ChannelOpenings | None,
) -> tuple[dict[str, Certificate], float]:
    """The certificate of each domain, and the volume of all three.

    That of the wall has the checks and notes of the channels too.
    """
    found: dict[str, Certificate] = {}
    checks = list(domains[WALL].checks)
    lines = [*body.notes, *domains[WALL].notes]
    for name in (PLUS, MINUS):
        domain = domains[name]
        found[name] = own = _certify(block, domain, domain.notes)
        checks += [require(False, f"{name}: {shortfall}") for shortfall in own.shortfalls]
        lines.append(
            f"{name}: volume {own.volume:.9g} mm3, {len(own.pieces)} piece{'s' if len(own.pieces) > 1 else ''}"
        )
        lines += [f"{name}: {describe_piece(volume, own.pieces[0])} apart" for volume in own.pieces[1:]]
    if openings is not None:
        checks += _check_openings(contacts, openings, {name: len(found[name].pieces) for name in found})
    for contact in contacts:
        areas = ", ".join(f"{name} {area:.4g} mm2" for name, area in contact.areas.items())
        lines.append(f"on {contact.label}: {areas}")
    wall = _certify(block, domains[WALL], tuple(lines))
    total = wall.volume + found[PLUS].volume + found[MINUS].volume
    checks.append(
        Check(
            "total volume",
            abs(total - body.volume),
            TOTAL_VOLUME_RTOL * body.volume,
            f"the domains' volumes add up to {total:.9g}, the body's is {body.volume:.9g}",
        )
    )
    missed = tuple(check.shortfall for check in checks if not check.passed)
    shortfalls = (*wall.shortfalls, *(text for text in missed if text not in wall.shortfalls))
    found[WALL] = replace(wall, met=not shortfalls, shortfalls=shortfalls)
    return found, total


def _certify(block: LatticeBlock, domain: DomainSolids, notes: tuple[str, ...]) -> Certificate:
    """The certificate of a domain: of trimmed patches, or of solids that the kernel cut."""
    measures, built = block.measure(domain.built, domain.moved), domain.built
    if isinstance(built, OcctSolids):
        return certify_kernel_solids(built.solids, block.patches, measures, notes=notes)
    return certify_built_solids(built, measures, valid=True, notes=notes)


def _check_openings(
    contacts: tuple[FaceContact, ...], openings: ChannelOpenings, n_pieces: Mapping[str, int]
) -> list[Check]:
    """Whether each channel is one piece and reaches those faces that it opens at, and no other."""
    checks = []
    for name, opened in ((PLUS, openings.plus), (MINUS, openings.minus)):
        checks.append(
            Check(
                f"pieces of {name}",
                n_pieces[name],
                1,
                f"{name} falls into {n_pieces[name]} pieces: use a smaller cell, skin or transition, or another phase",
            )
        )
        for contact in contacts:
            area = contact.areas.get(name, 0.0)
            if contact.face in opened:
                checks.append(
                    require(
                        area > 0,
                        f"{name} does not reach {contact.label}, an opening: use a smaller cell, skin or transition",
                    )
                )
            else:
                checks.append(require(area == 0, f"{name} opens at {contact.label}, over {area:.3g} mm2"))
    return checks


def _missing_domain(body: Body, name: str, block: LatticeBlock) -> MissingDomain:
    """The error for a body that contains no part of the domain `name` of a block."""
    closed = ", or a smaller `skin` or `transition`: the closings fill the channel" if block.closes_channels else ""
    return MissingDomain(f"{body.name} holds no {name}: shift the lattice by `phase`, or use a smaller `cell`{closed}")
