"""The figures that parts and channels are designed by, measured on the finished solid.

Volume fraction, wetted surface and hydraulic diameter follow from the exact volumes and areas of the kernel's solids and from the
envelope, the box or body in which void counts. The smallest wall and the smallest pore are the least distances of opposite sides,
through the solid and through the void, bounded from below by a search that misses none. A shape is taken as material with void
around it, or as the fluid itself.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Annotated, Any

import numpy as np

from tpmscad.api.public_calls import validate_call
from tpmscad.api.shared_kinds import ANYTHING, FLAG, POSITIVE
from tpmscad.brep.least_width import LeastWidth
from tpmscad.errors import InvalidRequest
from tpmscad.kernel.body_import.cad_body import read_body
from tpmscad.kernel.measure.envelope import Envelope
from tpmscad.kernel.measure.mass_properties import face_moments
from tpmscad.kernel.measure.shape_report import ShapeReport
from tpmscad.kernel.measure.shape_sampling import sample_faces
from tpmscad.kernel.occt.exploration import faces_of
from tpmscad.kernel.printability.least_widths import measure_least_widths
from tpmscad.result_display import tabulate_summary
from tpmscad.results.model import Model
from tpmscad.studies._check_print import read_closed_solids, refuse_touching_solids

N_ENVELOPE_SAMPLES = 20_000
"""Samples by which faces on the envelope are found."""

ENVELOPE_TOL_DIAGONALS = 1e-6
"""In diagonals of the shape: distance below which a sample lies on the envelope."""


@dataclass(frozen=True, slots=True)
class LocatedWidth:
    """A least distance of opposite sides, the middle between the two places that attain it, and a bound that none is below."""

    width: float
    at: tuple[float, float, float]
    bound: float

    def __str__(self) -> str:
        at = ", ".join(f"{round(x, 9) + 0.0:.4g}" for x in self.at)
        return f"{self.width:.4g} mm at ({at}), none below {self.bound:.4g}"


@dataclass(frozen=True, slots=True, repr=False)
class Metrics:
    """The figures of a solid or of a fluid, in the unit of the shape (mm for files).

    Attributes
    ----------
    volume, area : float
        Of the shape.
    envelope : str
        What void counts in: a body, a box, or the bounding box of the shape.
    envelope_volume : float
        Its volume.
    volume_fraction : float
        `volume` / `envelope_volume`.
    wetted_area : float
        Area of the faces that do not lie on the envelope.
    surface_per_volume : float
        `wetted_area` / `envelope_volume`.
    hydraulic_diameter : float or None
        4 x fluid volume / `wetted_area`; None if no face is wetted. The fluid is the shape itself if `is_fluid`, otherwise the
        void that the shape leaves in the envelope.
    smallest_wall, smallest_pore : LocatedWidth or None
        Least distance of opposite sides of the material, or of the fluid, as in `check_print`; None if no sides are opposite. Its
        bound is at most 2 % below it, or else what could not be ruled out.
    pieces : int
        Number of solids.
    spacing : float
        Greatest distance of the samples by which faces on the envelope are found.
    is_fluid : bool
        Whether the shape was measured as fluid with walls around it.
    """

    volume: float
    area: float
    envelope: str
    envelope_volume: float
    volume_fraction: float
    wetted_area: float
    surface_per_volume: float
    hydraulic_diameter: float | None
    smallest_wall: LocatedWidth | None
    smallest_pore: LocatedWidth | None
    pieces: int
    spacing: float
    is_fluid: bool = False

    def to_dict(self) -> dict[str, Any]:
        """The metrics as plain values, ready for JSON. The attributes by name."""
        return asdict(self)

    def __repr__(self) -> str:
        diameter = "none: no wetted surface" if self.hydraulic_diameter is None else f"{self.hydraulic_diameter:.6g} mm"
        fluid = "channel" if self.is_fluid else "void"
        return "\n".join(
            [
                f"volume              {self.volume:.6g} mm3, a fraction of {self.volume_fraction:.6g} of "
                f"{self.envelope_volume:.6g} mm3, {self.envelope}",
                f"wetted surface      {self.wetted_area:.6g} mm2, {self.surface_per_volume:.6g} mm2 per mm3 of the envelope",
                f"hydraulic diameter  {diameter}, 4 x volume of the {fluid} / wetted surface",
                f"smallest wall       {self.smallest_wall or 'none: no two sides are opposite'}",
                f"smallest {'passage' if self.is_fluid else 'pore   '}    "
                f"{self.smallest_pore or 'none: no two sides are opposite'}",
                f"pieces              {self.pieces}",
            ]
        )

    def _repr_html_(self) -> str:
        return tabulate_summary(f"{self.envelope}\n{self}")


@validate_call()
def measure(
    source: Annotated[
        Any,
        ANYTHING,
        "A result of this package, a build123d, CadQuery or TopoDS shape, or the path of a STEP file, with valid "
        "closed solids.",
    ],
    *,
    within: Annotated[
        Any,
        ANYTHING,
        "The envelope in which void counts: a box or a body. By default what a model was made in, the body or the box of its "
        "cells or of its field, or else the smallest box that contains the shape.",
    ] = None,
    spacing: Annotated[
        float | None,
        POSITIVE,
        "Greatest distance of the samples by which faces on the envelope are found; by default 20,000 of them.",
    ] = None,
    is_fluid: Annotated[
        bool | None,
        FLAG,
        "Whether the shape is a channel full of fluid instead of material. By default the channels of `fluid_domains` "
        "are fluid and all other shapes are material.",
    ] = None,
) -> Metrics:
    """Measure the figures that parts are designed by: volume fraction, wetted surface, hydraulic diameter, walls and pores.

    Returns
    -------
    Metrics
        The figures, in the unit of the shape (mm for files).

    Raises
    ------
    InvalidRequest
        If the shape has no valid closed solids, if solids touch each other, or if the envelope is smaller than the solid.

    Examples
    --------
    >>> model = tpmscad.lattice("gyroid", cell=10, cells=(2, 2, 2), thickness=1)  # doctest: +SKIP
    >>> metrics = tpmscad.measure(model, within=((0, 0, 0), (20, 20, 20)))  # doctest: +SKIP
    >>> print(metrics.smallest_wall)  # doctest: +SKIP
    0.9969 mm at ...
    >>> channel = tpmscad.fluid_domains(body, "gyroid", cell=10, thickness=1).plus  # doctest: +SKIP
    >>> tpmscad.measure(channel, within=body).hydraulic_diameter  # doctest: +SKIP
    4.6...
    """
    if is_fluid is None:
        is_fluid = isinstance(source, Model) and source.is_fluid
    known = source.envelope if isinstance(source, Model) else None
    if isinstance(source, Model):
        source = source.built.shape
    shape, report = read_closed_solids(source, "measured")
    faces = faces_of(shape)
    size = float(np.linalg.norm(np.subtract(*report.bounds)))
    refuse_touching_solids(
        shape, report, "have no surface of their own there: measure one of them, or unite them first"
    )
    spacing = spacing or (report.area / N_ENVELOPE_SAMPLES) ** 0.5
    if within is not None:
        known = _read_envelope(within)
    envelope = known or Envelope.of_box("the smallest box around the solid", *report.bounds)
    wetted = _measure_wetted_area(report, faces, envelope, size, spacing)
    fluid_volume = report.volume if is_fluid else max(0.0, envelope.volume - report.volume)
    inner, outer = (None if found is None else _locate(found) for found in measure_least_widths(shape, report))
    return Metrics(
        volume=report.volume,
        area=report.area,
        envelope=envelope.name,
        envelope_volume=envelope.volume,
        volume_fraction=report.volume / envelope.volume,
        wetted_area=wetted,
        surface_per_volume=wetted / envelope.volume,
        hydraulic_diameter=4.0 * fluid_volume / wetted if wetted else None,
        smallest_wall=outer if is_fluid else inner,
        smallest_pore=inner if is_fluid else outer,
        pieces=report.solids,
        spacing=spacing,
        is_fluid=is_fluid,
    )


def _read_envelope(within: Any) -> Envelope:
    """The envelope that the caller gave."""
    try:
        low, high = np.asarray(within, float)
    except (TypeError, ValueError):
        body = read_body(within)
        return Envelope(body.name, body.volume, body.shape)
    return Envelope.of_box("the box given", low, high)


def _measure_wetted_area(report: ShapeReport, faces: Any, envelope: Envelope, size: float, spacing: float) -> float:
    """The area of the faces that do not lie on the envelope; InvalidRequest if the solid is larger than it."""
    samples = sample_faces(faces, spacing)
    if envelope.volume < report.volume * (1.0 - ENVELOPE_TOL_DIAGONALS):
        raise InvalidRequest(
            f"the envelope's volume {envelope.volume:.6g} is less than the solid's, {report.volume:.6g}: give one that "
            "contains the solid"
        )
    off = ~envelope.holds_on_surface(samples, ENVELOPE_TOL_DIAGONALS * size)
    n_off = np.bincount(samples.face[off], minlength=len(faces))
    dry = (n_off == 0) & (np.bincount(samples.face, minlength=len(faces)) > 0)
    dry_faces = [face for face, is_dry in zip(faces, dry, strict=True) if is_dry]
    wetted = report.area - float(face_moments(dry_faces)[:, 0].sum())
    return wetted if wetted > ENVELOPE_TOL_DIAGONALS * report.area else 0.0


def _locate(found: LeastWidth) -> LocatedWidth:
    x, y, z = found.places.mean(axis=0).tolist()
    return LocatedWidth(found.value, (x, y, z), found.bound)
