"""What is promised about a result: every figure measured on it, next to the bound that was asked for.

The certificate of a result: every figure measured on the complex and on the kernel's solid, then held against the request.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from tpmscad.brep.boundary_representation import Brep
from tpmscad.brep.deviation import Deviation
from tpmscad.brep.edge_continuity import measure_edge_continuity
from tpmscad.brep.moments.integral_properties import FaceMoments
from tpmscad.brep.solid_properties import SolidPiece, SolidProperties, measure_solid
from tpmscad.lattices.maps import Map
from tpmscad.splines.bspline import BSplineSurface
from tpmscad.workflows.lattice_request import LatticeRequest

CHIP_VOLUME_FRACTION = 1e-2
"""A piece below this fraction of the largest is named a chip in the notes."""


@dataclass(frozen=True, slots=True)
class Certificate:
    """Measured figures of a solid; lengths in model units, angles in degrees.

    `met` says whether all that was asked for holds; `shortfalls` names what does not, and is empty otherwise. Deviations are
    orthogonal, in both directions, against `reference`. `gap`, `tangent_jump_deg` and `curvature_jump` (relative to the
    greatest curvature) are the worst over all joints between smooth faces, extraordinary points included. `betti` are the
    solid's Betti numbers (pieces, tunnels, voids), `pieces` the volumes of its parts. `bounds` are upper bounds on
    the deviation by their names, far above what is measured; `figures` what else was measured, by name.
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

    def to_dict(self) -> dict[str, Any]:
        """Plain values, ready for JSON."""
        return {k: list(v) if isinstance(v, tuple) else v for k, v in asdict(self).items()}

    def __str__(self) -> str:
        verdict = "met" if self.met else "NOT met: " + "; ".join(self.shortfalls)
        lines = [
            verdict,
            f"deviation   max {self.max_deviation:.3g}, rms {self.rms_deviation:.3g} (asked {self.tol:g}) "
            f"from the {self.reference}",
            f"joints      gap {self.gap:.2g}, tangent {self.tangent_jump_deg:.2g} deg, "
            f"curvature {self.curvature_jump:.2g} relative",
            f"solid       {'valid' if self.valid else 'INVALID'}, {'closed' if self.closed else 'OPEN'}, "
            f"volume {self.volume:.9g}, area {self.area:.9g}, Betti numbers {self.betti}",
            f"size        {self.n_faces} faces, {self.n_primitives} primitives, {self.n_poles} poles",
        ]
        lines += [f"bound       {bound:.3g}, {name}" for name, bound in self.bounds.items()]
        lines += [f"measured    {value:.6g}, {name}" for name, value in self.figures.items()]
        lines += [f"note        {note}" for note in self.notes]
        if self.seconds:
            lines.append("seconds     " + ", ".join(f"{k} {v:.2f}" for k, v in self.seconds.items()))
        return "\n".join(lines)


def build_certificate(
    brep: Brep, shape: SolidProperties, shortfalls: list[str], notes: tuple[str, ...] = (), **measured: Any
) -> Certificate:
    """The certificate with what the complex and its summary say, and whatever else was `measured`, by the certificate's names."""
    splines = [c for c in brep.carriers if isinstance(c, BSplineSurface)]
    return Certificate(
        met=not shortfalls,
        shortfalls=tuple(shortfalls),
        closed=shape.closed,
        volume=shape.volume,
        area=shape.area,
        betti=shape.betti or (0, 0, 0),
        pieces=tuple(piece.volume for piece in shape.pieces),
        n_faces=len(brep.faces),
        n_primitives=len({int(i) for i in brep.faces.carrier if isinstance(brep.carriers[int(i)], BSplineSurface)}),
        n_poles=sum(s.poles.shape[0] * s.poles.shape[1] for s in splines),
        notes=(*notes, *_piece_notes(shape.pieces)),
        **measured,
    )


def _piece_notes(pieces: tuple[SolidPiece, ...]) -> tuple[str, ...]:
    """A line on each piece beside the first: a box can cut off chips."""
    if len(pieces) < 2:
        return ()
    notes = [f"{len(pieces)} separate pieces; another phase may join or shed the small ones"]
    for piece in pieces[1:]:
        kind = "chip" if piece.volume < CHIP_VOLUME_FRACTION * pieces[0].volume else "piece"
        x, y, z = piece.near
        notes.append(f"{kind} of volume {piece.volume:.4g} near ({x:.4g}, {y:.4g}, {z:.4g})")
    return tuple(notes)


MAX_GAP_CELLS, MAX_TANGENT_JUMP_DEG, MAX_RELATIVE_CURVATURE_JUMP = 1e-9, 1e-6, 1e-6
"""Joints of copied patches: gap in cells, tangent jump in degrees, curvature jump over the greatest curvature."""

MAX_MAPPED_TANGENT_JUMP_DEG, MAX_MAPPED_RELATIVE_CURVATURE_JUMP = 1e-4, 1e-4
"""Joints of patches under a map, whose derivatives come from the user's function by differences."""

KERNEL_POINT_TOL = 1e-7
"""Model units: where the kernel takes two points for one."""


def certify_lattice(
    request: LatticeRequest,
    bend: Map | None,
    brep: Brep,
    deviation: Deviation,
    bounds: Mapping[str, float],
    moments: FaceMoments,
    valid: bool,
    notes: tuple[str, ...] = (),
) -> Certificate:
    """Measure and compare; `moments` are those of the complex's faces, `valid` is the kernel's verdict on the built solid,
    `deviation` in model units, `notes` what else is to be told."""
    shape = measure_solid(brep, moments)
    smooth = measure_edge_continuity(brep, ("offset+", "offset-"))
    reference = f"{request.reference} {request.surface} surface"
    if bend is not None:
        reference += f" under {bend.name}"
    widest = float(brep.edges.deviation.max(initial=0.0))

    shortfalls = []
    if deviation.max > request.tol:
        shortfalls.append(f"deviation {deviation.max:.3g} exceeds tol {request.tol:g}")
    if not shape.closed:
        shortfalls.append("the faces do not close")
    if not valid:
        shortfalls.append("the kernel's check rejects the solid")
    gap, tangent, curvature = (
        (MAX_GAP_CELLS * request.cell[0], MAX_TANGENT_JUMP_DEG, MAX_RELATIVE_CURVATURE_JUMP)
        if bend is None
        else (KERNEL_POINT_TOL, MAX_MAPPED_TANGENT_JUMP_DEG, MAX_MAPPED_RELATIVE_CURVATURE_JUMP)
    )
    for label, value, limit in (
        ("gap", smooth.gap, gap),
        ("tangent jump in degrees", smooth.tangent_jump_deg, tangent),
        ("relative curvature jump", smooth.curvature_jump, curvature),
    ):
        if value > limit:
            shortfalls.append(f"{label} {value:.3g} exceeds {limit:g}")

    return build_certificate(
        brep,
        shape,
        shortfalls,
        notes,
        tol=request.tol,
        max_deviation=deviation.max,
        rms_deviation=deviation.rms,
        reference=reference,
        gap=max(smooth.gap, widest),
        tangent_jump_deg=smooth.tangent_jump_deg,
        curvature_jump=smooth.curvature_jump,
        valid=valid,
        bounds=dict(bounds),
    )
