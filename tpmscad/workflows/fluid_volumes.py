"""The three domains of a heat exchanger: the wall of a sheet lattice in a body, and the two channels that it separates.

If the body consists of planes and quadrics, lattice and body are intersected once on the patches' parameter domains, and the
three domains are rebuilt from that arrangement; common faces, edges and vertices are the same by construction. Otherwise the
kernel splits the body by the lattice's surfaces.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from tpmscad._typing import Progress
from tpmscad.brep.moments import integral_properties
from tpmscad.errors import KernelError, MissingDomain, TrimmingError
from tpmscad.kernel import (
    CadBody,
    KernelSolids,
    SplitSolid,
    brep_and_source_faces,
    build_regions,
    check_shape,
    faces_of,
    is_valid,
    make_compound,
    read_body,
    split_body,
)
from tpmscad.stage_timer import StageTimer
from tpmscad.trimming import LatticeDomain, trim_domains
from tpmscad.workflows.attempts import Attempt, first_success
from tpmscad.workflows.certificate import (
    Certificate,
    Check,
    certify_kernel_solids,
    check_kernel_solids,
    describe_piece,
    require,
)
from tpmscad.workflows.checked_write import write_checked_shape
from tpmscad.workflows.lattice_block import LatticeBlock, build_lattice_block
from tpmscad.workflows.lattice_request import resolve_lattice_request, rotation_matrix

WALL, PLUS, MINUS = "wall", "channel +", "channel -"
"""Names of the domains; a channel is named by the sign of the surface's nodal value in it."""

TOTAL_VOLUME_RTOL = 1e-6
"""Largest difference between the sum of the domains' volumes and the body's volume, relative to the latter."""


@dataclass(frozen=True, slots=True, eq=False)
class FaceContact:
    """One face of the body, by its number in the body's order, and the area of each domain on it, model units squared."""

    face: int
    areas: Mapping[str, float]


@dataclass(frozen=True, slots=True, eq=False)
class FluidDomains:
    """The wall and the two channels as conformal solids: adjacent domains share TopoDS faces, edges and vertices.

    Attributes
    ----------
    name : str
        Name of the whole, used in STEP files.
    pieces : mapping
        The TopoDS solids of each domain, largest first, by the names "wall", "channel +" and "channel -".
    touches : tuple of FaceContact
        For every face of the body, the domains that reach it and their areas on it.
    certificate : Certificate
        The certificate of the wall, with the checks and notes of the channels.
    body_volume : float
        Volume of the three domains together, model units cubed.
    """

    name: str
    pieces: Mapping[str, tuple[Any, ...]]
    touches: tuple[FaceContact, ...]
    certificate: Certificate
    body_volume: float

    @property
    def wall(self) -> Any:
        """The wall as a build123d Solid, or a Compound of its pieces, largest first."""
        return KernelSolids(self.pieces[WALL]).solid

    @property
    def plus(self) -> Any:
        """The channel in which the nodal value is positive, as a build123d Solid or Compound."""
        return KernelSolids(self.pieces[PLUS]).solid

    @property
    def minus(self) -> Any:
        """The channel in which the nodal value is negative, as a build123d Solid or Compound."""
        return KernelSolids(self.pieces[MINUS]).solid

    @property
    def wrapped(self) -> Any:
        """All solids as one TopoDS compound with shared faces, in the order wall, channel +, channel -."""
        return make_compound(solid for solids in self.pieces.values() for solid in solids)

    def export_step(self, path: str | Path, *, schema: str = "ap242") -> None:
        """Write the named solids to a STEP file, which is read back and checked.

        Parameters
        ----------
        path : str or Path
            The file to write. It is left unchanged if the check fails.
        schema : {"ap242", "ap214"}, optional
            Application protocol of the file.

        Raises
        ------
        KernelError
            If the file does not read back as it was written.
        """
        names = [
            name if number == 0 else f"{name} {number + 1}"
            for name, solids in self.pieces.items()
            for number in range(len(solids))
        ]
        write_checked_shape(self.wrapped, path, schema=schema, name=self.name, volume=self.body_volume, names=names)


def fluid_domains(
    body: Any,
    surface: str,
    *,
    cell: float | Sequence[float],
    thickness: float | None = None,
    offset: Sequence[float] | None = None,
    volume_fraction: float | None = None,
    reference: str | None = None,
    phase: Sequence[float] = (0.0, 0.0, 0.0),
    rotation: Sequence[float] = (0.0, 0.0, 0.0),
    tol: float | None = None,
    progress: Progress | None = None,
) -> FluidDomains:
    """Divide a body into the wall of a sheet lattice and the two channels beside it, as solids that share their faces.

    Parameters
    ----------
    body : shape, str or Path
        One closed solid: a build123d, CadQuery or TopoDS shape, or the path of a STEP file.
    surface : str
        Name of a surface (see ``tpmscad surfaces``).
    cell : float or (3,) floats
        Edge length of the cell, or one for each axis, model units.
    thickness : float, optional
        Wall thickness along the normal, model units. Give exactly one of `thickness`, `offset` and `volume_fraction`.
    offset : (float, float), optional
        Signed normal distances of the two sides of the wall, the lower first, model units.
    volume_fraction : float, optional
        Fraction of the whole cell that is wall, between 0 and 1.
    reference : {"minimal", "nodal"}, optional
        The exact minimal surface (the default if the catalogue has it), or the trigonometric surface of its name.
    phase : (3,) floats, optional
        Shift of the lattice, in cells.
    rotation : (3,) floats, optional
        Rotation of the lattice about the origin: degrees about x, then about its own y, then about its own z.
    tol : float, optional
        Greatest orthogonal deviation from the surface, model units; by default a thousandth of the cell.
    progress : callable, optional
        Called with the name of a stage and the fraction of it that is done.

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
    stages = StageTimer(progress)
    with stages("read"):
        read = read_body(body)
    request = resolve_lattice_request(
        surface,
        cell=cell,
        thickness=thickness,
        offset=offset,
        volume_fraction=volume_fraction,
        reference=reference,
        phase=phase,
        tol=tol,
    )
    block = build_lattice_block(request, rotation_matrix(rotation), read, stages)
    with stages("trim"):
        found = _compute_domains(block, read)
    touches = tuple(
        FaceContact(
            face, {name: domain.areas[face] for name, domain in found.items() if domain.areas.get(face, 0.0) > 0}
        )
        for face in range(len(faces_of(read.shape)))
    )
    with stages("check"):
        pieces = {name: domain.solids for name, domain in found.items()}
        certificate, volume = _certify_domains(pieces, touches, block, read, found[WALL].notes)
    return FluidDomains(
        f"{request.surface} exchanger", pieces, touches, certificate.with_seconds(stages.seconds), volume
    )


@dataclass(frozen=True, slots=True, eq=False)
class DomainSolids:
    """The solids of a domain, largest first, its areas by face of the body, and notes on the method."""

    solids: tuple[Any, ...]
    areas: Mapping[int, float]
    notes: tuple[str, ...]


def _compute_domains(block: LatticeBlock, body: CadBody) -> dict[str, DomainSolids]:
    """The three domains: trimmed on the patches' own parameters if possible, else split by the kernel."""
    outcome = first_success(
        [
            Attempt("trimming on the patches' parameters", lambda: _trim_domains(block, body)),
            Attempt("splitting by the kernel", lambda: _split_domains(block, body)),
        ]
    )
    if not outcome.failures:
        return outcome.value
    note = f"split by the kernel: {outcome.reasons}"
    return {name: replace(domain, notes=(note,)) for name, domain in outcome.value.items()}


def _trim_domains(block: LatticeBlock, body: CadBody) -> dict[str, DomainSolids]:
    """The three domains rebuilt from one arrangement of the patches and the body."""
    brep, source_face = brep_and_source_faces(body.shape)
    patches = block.patches
    bounds = {
        WALL: LatticeDomain(np.arange(len(patches.faces)), 1),
        PLUS: LatticeDomain(patches.faces_with_tag("offset+"), -1),
        MINUS: LatticeDomain(patches.faces_with_tag("offset-"), -1),
    }
    trimmed, _ = trim_domains(patches, brep, list(bounds.values()))
    for name, domain in zip(bounds, trimmed.breps, strict=True):
        if not len(domain.faces):
            raise _missing_domain(body, name)
    solids = build_regions(trimmed.shared, trimmed.breps, trimmed.members)
    if not all(is_valid(solid) for of in solids for solid in of):
        raise TrimmingError("the kernel's check rejects a domain")
    result = {}
    for name, domain, of in zip(bounds, trimmed.breps, solids, strict=True):
        caps = domain.faces_with_tag("cap")
        face = source_face[domain.faces.carrier[caps] - len(patches.carriers)]
        areas = np.bincount(face, integral_properties.integrate_faces(domain).area[caps])
        result[name] = DomainSolids(of, dict(enumerate(areas.tolist())), ("trimmed on the patches' parameter domains",))
    return result


def _split_domains(block: LatticeBlock, body: CadBody) -> dict[str, DomainSolids]:
    """The three domains from the cells into which the kernel splits the body."""
    cells = split_body(body.shape, block.shape, _tags_of_kernel_faces(block))
    result = {}
    for name in (WALL, PLUS, MINUS):
        own = [c for c in cells if classify_cell(c) == name]
        if not own:
            raise _missing_domain(body, name)
        areas = {face: sum(c.areas.get(face, 0.0) for c in own) for c in own for face in c.areas}
        result[name] = DomainSolids(tuple(c.solid for c in own), areas, ())
    return result


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
    return [by_face[hash(face)] for face in faces_of(block.shape)]


def _certify_domains(
    pieces: Mapping[str, tuple[Any, ...]],
    contacts: tuple[FaceContact, ...],
    block: LatticeBlock,
    body: CadBody,
    notes: tuple[str, ...],
) -> tuple[Certificate, float]:
    """The certificate of the wall, with checks and notes of the channels, and the volume of all three domains."""
    checks: list[Check] = []
    total = 0.0
    lines = list(notes)
    for name, solids in pieces.items():
        report = check_shape(make_compound(solids))
        total += report.volume
        if name == WALL:
            continue
        own = [
            require(report.closed, "the faces do not close"),
            require(report.valid, "the kernel's check rejects the solid"),
            *check_kernel_solids(report, block.measures.tol),
        ]
        checks += [replace(check, message=f"{name}: {check.shortfall}") for check in own]
        lines.append(f"{name}: volume {report.volume:.9g}, {len(solids)} connected")
        lines += [f"{name}: {describe_piece(v, report.volumes[0])} apart" for v in report.volumes[1:]]
    for contact in contacts:
        areas = ", ".join(f"{name} {area:.4g}" for name, area in contact.areas.items())
        lines.append(f"face {contact.face}: {areas}")
    checks.append(
        Check(
            "total volume",
            abs(total - body.volume),
            TOTAL_VOLUME_RTOL * body.volume,
            f"the domains' volumes add up to {total:.9g}, the body's is {body.volume:.9g}",
        )
    )
    wall = certify_kernel_solids(pieces[WALL], block.patches, block.measures, checks=checks, notes=tuple(lines))
    return wall, total


def _missing_domain(body: CadBody, name: str) -> MissingDomain:
    """The error for a body that contains no part of the domain `name`."""
    return MissingDomain(f"{body.name} holds no {name}: shift the lattice by `phase`, or use a smaller `cell`")
