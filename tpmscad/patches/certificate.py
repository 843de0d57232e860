"""What is promised about a result: every figure measured on it, next to the bound that was asked for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from tpmscad.patches.complex import PatchComplex
from tpmscad.patches.summary import Piece, Summary
from tpmscad.splines.bspline import Surface

CHIP = 1e-2
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


def certificate_of(
    complex: PatchComplex, shape: Summary, shortfalls: list[str], notes: tuple[str, ...] = (), **measured: Any
) -> Certificate:
    """The certificate with what the complex and its summary say, and whatever else was `measured`, by the certificate's names."""
    splines = [c for c in complex.carriers if isinstance(c, Surface)]
    return Certificate(
        met=not shortfalls,
        shortfalls=tuple(shortfalls),
        closed=shape.closed,
        volume=shape.volume,
        area=shape.area,
        betti=shape.betti or (0, 0, 0),
        pieces=tuple(piece.volume for piece in shape.pieces),
        n_faces=len(complex.faces),
        n_primitives=len({int(i) for i in complex.faces.carrier if isinstance(complex.carriers[int(i)], Surface)}),
        n_poles=sum(s.poles.shape[0] * s.poles.shape[1] for s in splines),
        notes=(*notes, *_pieces(shape.pieces)),
        **measured,
    )


def _pieces(pieces: tuple[Piece, ...]) -> tuple[str, ...]:
    """A line on each piece beside the first: a box can cut off chips."""
    if len(pieces) < 2:
        return ()
    notes = [f"{len(pieces)} separate pieces; another phase may join or shed the small ones"]
    for piece in pieces[1:]:
        kind = "chip" if piece.volume < CHIP * pieces[0].volume else "piece"
        x, y, z = piece.near
        notes.append(f"{kind} of volume {piece.volume:.4g} near ({x:.4g}, {y:.4g}, {z:.4g})")
    return tuple(notes)
