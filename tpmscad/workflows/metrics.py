"""What parts are designed by, measured on the finished solid: volume fraction, surface, hydraulic diameter, walls and pores."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tpmscad import kernel
from tpmscad.brep.local_thickness import SharpEdgePoints, find_smallest_width
from tpmscad.errors import InvalidRequest
from tpmscad.kernel import Creases, FaceSamples, face_moments, faces_of, read_body
from tpmscad.workflows.model import Model

SAMPLE_SPACING_FRACTION = 0.4
"""Samples are at most so far apart, of volume / area, which is half the wall of a sheet. Walls of a gyroid come out 0.3 %
too thin at that."""

MAX_SAMPLES = 2_000_000
"""Half a gigabyte with their tree; beyond, samples are set further apart, and `spacing` says so."""

N_ENVELOPE_SAMPLES = 20_000
"""Samples to find the faces on the envelope by."""

ENVELOPE_TOL_DIAGONALS = 1e-6
"""Of the diagonal: what is nearer to the envelope than that lies on it."""


@dataclass(frozen=True, slots=True)
class LocatedWidth:
    """A diameter, and where its ball sits."""

    width: float
    at: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Metrics:
    """Lengths in the shape's unit (mm for files). The envelope is the box or the body in which void counts.

    wetted_area: of the faces that do not lie on the envelope. surface_per_volume: wetted_area / envelope_volume.
    hydraulic_diameter: 4 x void volume / wetted_area. smallest_wall, smallest_pore: the smallest ball in the solid, in the void,
    that touches two opposite sides (tapering by 5 degrees at most); None where no sides are opposite. Wedges, where the two sides
    meet in a sharp edge nearby, are left out: they run out to nothing at every cut. spacing: between the samples; widths are
    off by about spacing^2 / (8 x radius of curvature).
    """

    volume: float
    area: float
    envelope_volume: float
    volume_fraction: float
    wetted_area: float
    surface_per_volume: float
    hydraulic_diameter: float | None
    smallest_wall: LocatedWidth | None
    smallest_pore: LocatedWidth | None
    pieces: int
    spacing: float

    def to_dict(self) -> dict[str, Any]:
        """Plain values, ready for JSON."""
        return asdict(self)

    def __str__(self) -> str:
        def told(found: LocatedWidth | None) -> str:
            return (
                "no two opposite sides"
                if found is None
                else f"{found.width:.4g} at " + " ".join(f"{x:.4g}" for x in found.at)
            )

        diameter = "no wetted surface" if self.hydraulic_diameter is None else f"{self.hydraulic_diameter:.6g}"
        return "\n".join(
            [
                f"fraction    {self.volume_fraction:.6g} of {self.envelope_volume:.6g}",
                f"surface     {self.wetted_area:.6g} wetted, {self.surface_per_volume:.6g} per volume",
                f"hydraulic   {diameter}",
                f"wall        {told(self.smallest_wall)}",
                f"pore        {told(self.smallest_pore)}",
                f"pieces      {self.pieces}",
            ]
        )


def measure(source: Any, *, within: Any = None, spacing: float | None = None) -> Metrics:
    """Metrics of a Model, a build123d, CadQuery or TopoDS shape, or a STEP file.

    within: the envelope, a box ((x0, y0, z0), (x1, y1, z1)) or a body (a shape or a STEP file); by default the box around the
    shape. spacing: greatest distance of the samples, by default 0.4 of volume / area.
    InvalidRequest for a shape without valid closed solids, for solids that touch, and for an envelope that is too small.
    """
    if isinstance(source, Model):
        source = source.built.shape
    shape = kernel.read_step(source).shape if isinstance(source, str | Path) else getattr(source, "wrapped", source)
    report = kernel.check_shape(shape)
    if not report.ok:
        raise InvalidRequest(f"only valid closed solids can be measured, this is {str(report).splitlines()[0]}")
    faces = faces_of(shape)
    size = float(np.linalg.norm(np.subtract(*report.bounds)))
    coarse = kernel.sample_faces(faces, spacing or (report.area / N_ENVELOPE_SAMPLES) ** 0.5)
    envelope_volume, on_envelope = _locate_envelope(
        report.bounds if within is None else within, coarse, ENVELOPE_TOL_DIAGONALS * size
    )
    if envelope_volume < report.volume * (1.0 - ENVELOPE_TOL_DIAGONALS):
        raise InvalidRequest(
            f"the envelope's volume {envelope_volume:.6g} is less than the solid's, {report.volume:.6g}: it has to hold the solid"
        )
    off = np.bincount(coarse.face[~on_envelope], minlength=len(faces))
    dry = (off == 0) & (np.bincount(coarse.face, minlength=len(faces)) > 0)
    wetted = report.area - float(face_moments([face for face, on in zip(faces, dry, strict=True) if on])[:, 0].sum())
    wetted = wetted if wetted > ENVELOPE_TOL_DIAGONALS * report.area else 0.0
    void = max(0.0, envelope_volume - report.volume)
    spacing = spacing or max(SAMPLE_SPACING_FRACTION * report.volume / report.area, (report.area / MAX_SAMPLES) ** 0.5)
    samples, creases = kernel.sample_faces(faces, spacing), kernel.find_creases(faces, spacing)
    if kernel.have_touching_solids(shape, samples, ENVELOPE_TOL_DIAGONALS * size, spacing):
        raise InvalidRequest(
            "solids that touch have no surface of their own there: measure one of them, or unite them first"
        )
    return Metrics(
        volume=report.volume,
        area=report.area,
        envelope_volume=envelope_volume,
        volume_fraction=report.volume / envelope_volume,
        wetted_area=wetted,
        surface_per_volume=wetted / envelope_volume,
        hydraulic_diameter=4.0 * void / wetted if wetted else None,
        smallest_wall=_measure_smallest_width(samples, creases, 1.0, 2.0 * report.volume / report.area, size, spacing),
        smallest_pore=_measure_smallest_width(samples, creases, -1.0, 2.0 * report.volume / report.area, size, spacing),
        pieces=report.solids,
        spacing=spacing,
    )


def _locate_envelope(within: Any, samples: FaceSamples, near: float) -> tuple[float, NDArray[np.bool_]]:
    """The envelope's volume, and which samples lie on its surface."""
    try:
        low, high = np.asarray(within, float)
    except (TypeError, ValueError):
        body = read_body(within)
        return body.volume, kernel.lie_on_surface(body.shape, samples, near)
    if low.shape != (3,) or not (high > low).all():
        raise InvalidRequest(
            f"the envelope {within!r} must be a body or two opposite corners, ((x0, y0, z0), (x1, y1, z1))"
        )
    on = (np.abs(samples.points - low) < near) & (samples.normals < -0.5)
    on |= (np.abs(samples.points - high) < near) & (samples.normals > 0.5)
    return float((high - low).prod()), on.any(axis=1)


def _measure_smallest_width(
    samples: FaceSamples, creases: Creases, sign: float, reach: float, size: float, spacing: float
) -> LocatedWidth | None:
    """The least width between opposite sides, in the solid (sign 1) or outside (-1)."""
    found = find_smallest_width(
        np.concatenate([samples.points, creases.points, creases.points]),
        sign * np.concatenate([samples.normals, creases.normals[:, 0], creases.normals[:, 1]]),
        creases.smooth_group[np.concatenate([samples.face, creases.faces[:, 0], creases.faces[:, 1]])],
        SharpEdgePoints(creases.points, np.sort(creases.smooth_group[creases.faces], axis=1)),
        reach,
        size,
        spacing,
    )
    if found is None:
        return None
    x, y, z = found[1].tolist()
    return LocatedWidth(found[0], (x, y, z))
