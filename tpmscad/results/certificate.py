"""The certificate of a result: every figure measured on it, and whether it meets the request.

The figures come from two places. `PatchMeasures` holds those of the B-spline patches: the deviation from the reference in
both directions, the continuity across their edges, a-priori bounds. The others are measured on the finished solid:
closedness, validity, volume, area, Betti numbers and pieces. Each comparison of a figure with its limit is one `Check`; the
certificate is met if all checks pass, and its shortfalls are the messages of those that fail.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from tpmscad.brep.boundary_representation import Brep
from tpmscad.brep.deviation import Deviation
from tpmscad.brep.edge_continuity import EdgeContinuity
from tpmscad.brep.restricted_surfaces import whole_surfaces
from tpmscad.brep.solid_properties import SolidPiece, SolidProperties, TouchingPlace, measure_solid
from tpmscad.errors import format_point
from tpmscad.kernel.build.solids import BrepSolids
from tpmscad.kernel.measure.shape_extents import shape_bounds
from tpmscad.kernel.measure.shape_report import ShapeReport, check_shape
from tpmscad.kernel.measure.solid_topology import measure_topology
from tpmscad.kernel.measure.validity import is_brep_valid
from tpmscad.kernel.occt.construction import make_compound
from tpmscad.result_display import fit_lines, tabulate_summary

CHIP_VOLUME_FRACTION = 1e-2
"""Fraction of the largest piece's volume below which the warnings call a piece a chip."""

MAX_PIECES_LISTED = 5
"""Pieces, and places where the solid touches itself, that notes and warnings list one by one."""

ROUND_OFF = 1e-9
"""Relative round-off of volumes and areas, which are equal where a solid is a ball, or has no voids."""


@dataclass(frozen=True, slots=True)
class Check:
    """One measured value against its limit; `message` replaces the standard text of the shortfall."""

    name: str
    value: float
    limit: float
    message: str = ""

    @property
    def passed(self) -> bool:
        """Whether the value is at most the limit; NaN is not."""
        return self.value <= self.limit

    @property
    def shortfall(self) -> str:
        """The text of the certificate if the check fails."""
        return self.message or f"{self.name} {self.value:.3g} exceeds {self.limit:g}"


def require(condition: bool, message: str) -> Check:
    """The check of a condition that must hold; `message` states its opposite."""
    return Check(message, float(not condition), 0.0, message)


@dataclass(frozen=True, slots=True, eq=False)
class PatchMeasures:
    """What was measured on the B-spline patches of a result, in model units and degrees, and the checks that follow from it."""

    tol: float
    deviation: Deviation
    reference: str
    continuity: EdgeContinuity
    bounds: Mapping[str, float] = field(default_factory=dict)
    figures: Mapping[str, float] = field(default_factory=dict)
    checks: tuple[Check, ...] = ()
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, repr=False)
class Certificate:
    """What was measured on a solid, and whether it meets the request.

    Lengths are in model units (mm in files), angles in degrees. `print` shows the summary.

    Attributes
    ----------
    met : bool
        Whether every check passed.
    shortfalls : tuple of str
        The checks that failed, with value and limit; empty if `met`.
    tol : float
        The greatest deviation allowed.
    max_deviation, rms_deviation : float
        Orthogonal distance between the patches and `reference`: the greatest in both directions, and the root mean square.
    reference : str
        What the deviation is measured against: the minimal or nodal surface, or the field.
    gap, tangent_jump_deg, curvature_jump : float
        Greatest position, tangent and curvature mismatch over all edges between smooth faces, extraordinary points included. The
        curvature jump is relative to the greatest curvature.
    valid, closed : bool
        Whether the kernel's check accepts the solid, and whether its faces close.
    volume, area : float
        Of the solid.
    betti : tuple of int
        Betti numbers of the solid: pieces, tunnels, closed cavities.
    pieces : tuple of float
        Volumes of the connected components, largest first.
    dropped : tuple of float
        Volumes of the loose pieces that were left out of the solid, largest first.
    n_faces, n_primitives, n_poles : int
        Numbers of faces, of different B-spline surfaces among them, and of their control points.
    bounds : mapping of str to float
        A-priori upper bounds, each of what its name says. That of the deviation holds for the fitted surfaces and lies above the
        measured one; that of facets is the step of TPMS2STEP's eq. 4 alone, which says nothing of the deviation.
    figures : mapping of str to float
        Further measured values by name.
    notes : tuple of str
        How the solid was made, where that matters to the user.
    warnings : tuple of str
        What is wrong with many a part though the request is met: closed cavities, and pieces apart, with their places.
    seconds : mapping of str to float
        Wall time of each stage.
    """

    met: bool
    shortfalls: tuple[str, ...]
    tol: float
    max_deviation: float
    rms_deviation: float
    reference: str
    gap: float
    tangent_jump_deg: float
    curvature_jump: float
    valid: bool
    closed: bool
    volume: float
    area: float
    betti: tuple[int, int, int]
    pieces: tuple[float, ...]
    n_faces: int
    n_primitives: int
    n_poles: int
    bounds: Mapping[str, float] = field(default_factory=dict)
    figures: Mapping[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    seconds: Mapping[str, float] = field(default_factory=dict)
    dropped: tuple[float, ...] = ()
    warnings: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """The certificate as plain values, ready for JSON.

        The attributes by name, tuples as lists; it is what ``--report`` writes.
        """
        return {k: list(v) if isinstance(v, tuple) else v for k, v in asdict(self).items()}

    def with_seconds(self, seconds: Mapping[str, float]) -> Certificate:
        """The certificate with the wall time of each stage."""
        return replace(self, seconds=dict(seconds))

    def summary(self, *, verbose: bool = False) -> str:
        """The certificate in plain words, with units.

        Parameters
        ----------
        verbose : bool, optional
            Add the number of poles, the a-priori bounds, the further measured values and the time of each stage.

        Returns
        -------
        str
            A few lines: whether the request is met, what the solid is, its size, deviation, joints, notes.

        Examples
        --------
        >>> print(tpmscad.lattice("gyroid", cell=10, thickness=1).certificate.summary())  # doctest: +SKIP
        met
        solid       1 piece, 7 tunnels, no closed cavity
        ...
        """
        state = [] if self.closed else ["OPEN: not watertight"]
        state += [] if self.valid else ["INVALID: rejected by the kernel's check"]
        lines = [
            "met" if self.met else "NOT met: " + "; ".join(self.shortfalls),
            f"solid       {', '.join([describe_topology(self.betti), *state])}",
            f"size        volume {self.volume:.9g} mm3, surface {self.area:.9g} mm2, {self.n_faces} faces",
            f"deviation   at most {self.max_deviation:.3g} mm, {self.rms_deviation:.3g} mm rms, from the {self.reference}; "
            f"allowed {self.tol:g} mm",
            f"joints      apart by at most {self.gap:.2g} mm, bent by {self.tangent_jump_deg:.2g} degrees; "
            f"curvature differs by {self.curvature_jump:.2g} of its greatest value",
        ]
        lines += [f"warning     {warning}" for warning in self.warnings]
        lines += [f"note        {note}" for note in self.notes]
        if verbose:
            lines.append(f"patches     {self.n_primitives} primitives, {self.n_poles} poles")
            lines += [f"bound       {bound:.3g} mm, {name}" for name, bound in self.bounds.items()]
            lines += [f"measured    {value:.6g}, {name}" for name, value in self.figures.items()]
            if self.seconds:
                lines.append("seconds     " + ", ".join(f"{k} {v:.2f}" for k, v in self.seconds.items()))
        elif self.seconds:
            lines.append(f"seconds     {sum(self.seconds.values()):.1f}")
        return "\n".join(lines)

    def __str__(self) -> str:
        return fit_lines([self.summary()], ".summary()")

    def _repr_html_(self) -> str:
        return tabulate_summary(self.summary())

    def __repr__(self) -> str:
        verdict = "met" if self.met else f"NOT met ({len(self.shortfalls)} shortfalls)"
        return (
            f"<Certificate: {verdict}; {describe_topology(self.betti)}; volume {self.volume:.6g} mm3; "
            f"deviation {self.max_deviation:.3g} of {self.tol:g} mm>"
        )


def describe_topology(betti: tuple[int, int, int]) -> str:
    """Betti numbers in plain words, such as "1 piece, 54 tunnels, no closed cavity"."""
    names = ("piece", "pieces"), ("tunnel", "tunnels"), ("closed cavity", "closed cavities")
    return ", ".join(
        f"{count or 'no'} {singular if count < 2 else plural}"
        for count, (singular, plural) in zip(betti, names, strict=True)
    )


def _warn_of_traps(properties: SolidProperties) -> tuple[str, ...]:
    """A warning of closed cavities: what they mean to those who print the part."""
    cavities = properties.betti[2] if properties.betti else 0
    if not cavities:
        return ()
    one = cavities == 1
    return (
        f"{cavities} closed {'cavity' if one else 'cavities'}: powder or resin stays inside; "
        f"open {'it' if one else 'them'} by another thickness, phase or cell, or bore into {'it' if one else 'each'}",
    )


def certify_built_solids(
    built: BrepSolids,
    measures: PatchMeasures,
    *,
    valid: bool | None = None,
    checks: Sequence[Check] = (),
    notes: tuple[str, ...] = (),
    dropped: tuple[float, ...] = (),
) -> Certificate:
    """The certificate of solids built from a boundary representation, by its arrays and a kernel check of each class of faces.

    `measures` are the figures of the patches; `valid` is what `is_brep_valid` says, if that was asked before. `checks` and
    `notes` are added to those of `measures`; `dropped` are the volumes of the loose pieces that were left out.
    """
    brep = built.brep
    return _certify(
        brep,
        measure_solid(brep, built.nesting.moments),
        measures,
        valid=is_brep_valid(brep, built.known_faces) if valid is None else valid,
        edge_gap=float(brep.edges.deviation.max(initial=0.0)),
        n_faces=len(brep.faces),
        checks=checks,
        notes=notes,
        dropped=dropped,
    )


def certify_kernel_solids(
    solids: tuple[Any, ...],
    brep: Brep,
    measures: PatchMeasures,
    *,
    checks: Sequence[Check] = (),
    notes: tuple[str, ...] = (),
    dropped: tuple[float, ...] = (),
) -> Certificate:
    """The certificate of solids, largest first, that the kernel itself cut out of the patches of `brep`, by its own measures.

    The other arguments are those of `certify_built_solids`.
    """
    report, topology = check_shape(make_compound(solids)), measure_topology(solids)
    properties = SolidProperties(
        report.closed,
        report.volume,
        report.area,
        report.centroid,
        topology.betti,
        _locate_solids(solids, report),
        topology.euler,
        topology.contacts,
    )
    return _certify(
        brep,
        properties,
        measures,
        valid=report.valid,
        edge_gap=report.max_tolerance,
        n_faces=report.faces,
        checks=(require(report.outward, "a solid is inside out"), *checks),
        notes=notes,
        dropped=dropped,
    )


def _certify(
    brep: Brep,
    properties: SolidProperties,
    measures: PatchMeasures,
    *,
    valid: bool,
    edge_gap: float,
    n_faces: int,
    checks: Sequence[Check],
    notes: tuple[str, ...],
    dropped: tuple[float, ...],
) -> Certificate:
    """The certificate of a solid with `n_faces` faces, made of the patches of `brep`.

    `properties` are those of the solid, `valid` is the kernel's verdict, `edge_gap` the greatest distance between an edge and
    its faces.
    """
    deviation = measures.deviation
    everything = (
        Check("deviation", deviation.max, measures.tol, f"deviation {deviation.max:.3g} exceeds tol {measures.tol:g}"),
        require(properties.closed, "the faces do not close"),
        require(valid, "the kernel's check rejects the solid"),
        Check(
            "edge gap",
            edge_gap,
            measures.tol,
            f"edges are open by up to {edge_gap:.3g}, more than tol {measures.tol:g}",
        ),
        *measures.checks,
        *checks,
        *_check_possible(properties, measures),
    )
    shortfalls = tuple(check.shortfall for check in everything if not check.passed)
    primitives, primitive = whole_surfaces(brep)
    return Certificate(
        met=not shortfalls,
        shortfalls=shortfalls,
        tol=measures.tol,
        max_deviation=deviation.max,
        rms_deviation=deviation.rms,
        reference=measures.reference,
        gap=max(measures.continuity.gap, edge_gap),
        tangent_jump_deg=measures.continuity.tangent_jump_deg,
        curvature_jump=measures.continuity.curvature_jump,
        valid=valid,
        closed=properties.closed,
        volume=properties.volume,
        area=properties.area,
        betti=properties.betti or (0, 0, 0),
        pieces=tuple(piece.volume for piece in properties.pieces),
        n_faces=n_faces,
        n_primitives=len(primitives.keys() & set(primitive[brep.faces.carrier].tolist())),
        n_poles=sum(s.poles.shape[0] * s.poles.shape[1] for s in primitives.values()),
        bounds=dict(measures.bounds),
        figures=dict(measures.figures),
        notes=(*measures.notes, *notes, *_note_contacts(properties.contacts)),
        dropped=dropped,
        warnings=(*_warn_of_traps(properties), *_warn_of_pieces(properties.pieces)),
    )


def _check_possible(properties: SolidProperties, measures: PatchMeasures) -> tuple[Check, ...]:
    """Checks of figures against what any solid, and any comparison, can have: they fail where the measurement is wrong."""
    volume, area, pieces = properties.volume, properties.area, properties.pieces
    lengths = {
        **{f"{key} deviation": value for key, value in asdict(measures.deviation).items()},
        **{f"{key} across edges": value for key, value in asdict(measures.continuity).items()},
        **{f"the bound {key}": value for key, value in measures.bounds.items()},
    }
    checks = [
        require(0 < volume < np.inf, f"no solid has the volume {volume:.6g}"),
        require(
            36 * np.pi * volume**2 <= (1 + ROUND_OFF) * area**3 < np.inf,
            f"the area {area:.6g} is not that of a solid of volume {volume:.6g}: a ball has the least",
        ),
        require(
            volume <= (1 + ROUND_OFF) * sum(piece.volume for piece in pieces),
            f"the volume {volume:.6g} is more than that of all pieces",
        ),
        *(require(0 <= length < np.inf, f"{name} cannot be {length:.3g}") for name, length in lengths.items()),
        *(require(not np.isnan(value), f"{name} is not known") for name, value in measures.figures.items()),
    ]
    if properties.betti is not None:
        b0, b1, b2 = properties.betti
        of_shells = sum(1 - euler // 2 for euler in properties.euler)
        checks += [
            require(
                b0 == len(pieces) > 0 and min(b1, b2) >= 0 and len(properties.euler) == b0 + b2,
                f"{len(pieces)} pieces and {len(properties.euler)} shells do not have the Betti numbers {properties.betti}",
            ),
            require(
                b1 == of_shells and all(euler <= 2 and euler % 2 == 0 for euler in properties.euler),
                f"shells whose Euler characteristics are {', '.join(map(str, sorted(set(properties.euler))))} do not bound a "
                f"solid with {b1} tunnels",
            ),
        ]
    return tuple(checks)


def _note_contacts(contacts: tuple[TouchingPlace, ...]) -> tuple[str, ...]:
    """A note on the places where the solid touches itself or pieces touch."""
    if not contacts:
        return ()
    words = {"point": "in a point near", "edge": "along an edge near"}
    places = [
        f"{words[each.kind]} {format_point(np.round(each.near, 9) + 0.0)}" for each in contacts[:MAX_PIECES_LISTED]
    ]
    if len(contacts) > MAX_PIECES_LISTED:
        places.append(f"in {len(contacts) - MAX_PIECES_LISTED} other places")
    return (
        f"the solid only touches itself {', '.join(places)}: pieces and tunnels are counted as if it were apart there",
    )


def _locate_solids(solids: tuple[Any, ...], report: ShapeReport) -> tuple[SolidPiece, ...]:
    """The volume of each solid and the center of its bounding box; of a single solid the centroid, which is known."""
    if len(solids) == 1:
        return (SolidPiece(report.volume, report.centroid),)
    centers = [np.mean(shape_bounds(solid), axis=0).tolist() for solid in solids]
    return tuple(SolidPiece(volume, (x, y, z)) for volume, (x, y, z) in zip(report.volumes, centers, strict=True))


def _warn_of_pieces(pieces: tuple[SolidPiece, ...]) -> tuple[str, ...]:
    """A warning of pieces apart, with the places of the largest ones but the first."""
    if len(pieces) < 2:
        return ()
    listed = [
        f"{describe_piece(piece.volume, pieces[0].volume)} near {format_point(np.round(piece.near, 9) + 0.0)}"
        for piece in pieces[1 : 1 + MAX_PIECES_LISTED]
    ]
    if len(pieces) > 1 + MAX_PIECES_LISTED:
        listed.append(f"{len(pieces) - 1 - MAX_PIECES_LISTED} smaller ones")
    return (
        f"{len(pieces)} pieces, apart from the largest: {', '.join(listed)}; another phase, cell or thickness may join them",
    )


def describe_piece(volume: float, largest: float) -> str:
    """Whether a piece is a chip relative to the largest one, and its volume."""
    return f"{'chip' if volume < CHIP_VOLUME_FRACTION * largest else 'piece'} of {volume:.4g} mm3"
