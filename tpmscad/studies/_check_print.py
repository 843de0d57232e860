"""The check of a part before printing: smallest wall, smallest gap, overhang and closed cavities, measured on the exact solid.

Walls and gaps are found on samples of the surface and refined on the exact faces (`tpmscad.kernel`, opposite sides), overhang is
integrated over the exact faces, and cavities are closed surfaces inside the solids. None of it uses how the part was made, so
that a file of any program is checked like a model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tpmscad._typing import Array
from tpmscad.api.public_calls import validate_options
from tpmscad.errors import InvalidRequest
from tpmscad.fields.periods_and_directions import as_unit_vector
from tpmscad.kernel.body_import.isolated_reader import read_foreign_step
from tpmscad.kernel.measure.shape_report import ShapeReport, check_shape
from tpmscad.kernel.measure.shape_sampling import find_creases, have_touching_solids, sample_faces
from tpmscad.kernel.occt.exploration import faces_of, require_shape, solids_of
from tpmscad.kernel.printability.cavities import find_cavities
from tpmscad.kernel.printability.opposite_sides import SampledSurface, Width, find_least_solid_gap, find_least_width
from tpmscad.kernel.printability.overhang import measure_overhang
from tpmscad.requests.study_options import CheckPrintOptions

SAMPLE_SPACING_FRACTION = 0.4
"""Without limits: greatest distance of neighbouring samples, in units of volume / area, which is half the wall of a sheet."""

SAMPLE_SPACING_LIMITS = 0.5
"""Greatest distance of neighbouring samples in units of the smaller limit: a ball of 1.2 limits then meets a sample of any
opposite side within the limit, as far as the side is flat over this distance."""

MAX_SAMPLES = 2_000_000
"""Greatest number of samples, about half a gigabyte with their search tree."""

CONTACT_DIAGONALS = 1e-6
"""In diagonals of the part: distance within which faces of two solids touch."""

Place = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class PrintFinding:
    """What one check of a part before printing found.

    Attributes
    ----------
    check : {"wall", "gap", "overhang", "cavities"}
        What was measured.
    met : bool
        Whether the value keeps the limit; True without a limit.
    value : float or None
        Smallest wall or gap in mm, greatest overhang in degrees, or number of closed cavities; None for a wall or gap if no two
        sides are opposite.
    limit : float or None
        The least wall or gap, the greatest overhang, or 0 cavities; None if it was not given.
    place : (float, float, float) or None
        Middle of the wall or gap, the steepest place, or a point in the largest cavity.
    area : float or None
        Of the faces beyond the limit of overhang, mm2.
    volume : float or None
        Of all cavities, mm3.
    """

    check: str
    met: bool
    value: float | None
    limit: float | None
    place: Place | None
    area: float | None = None
    volume: float | None = None

    def __str__(self) -> str:
        at = "" if self.place is None else " at (" + ", ".join(f"{x:.4g}" for x in self.place) + ")"
        if self.check == "cavities":
            found = f"{self.value:g} closed, {self.volume:.6g} mm3 in all,{at}" if self.value else "none closed"
        elif self.value is None:
            found = "none: no two sides are opposite"
        elif self.check == "overhang":
            beyond = "" if self.area is None else f", {self.area:.6g} mm2 beyond the limit"
            found = f"{self.value:.4g} degrees{at}{beyond}"
        else:
            found = f"{self.value:.4g} mm{at}"
        limit = "" if self.limit is None or self.check == "cavities" else f", limit {self.limit:g}"
        return f"{'ok   ' if self.met else 'FAULT'} {TITLES[self.check]:15} {found}{limit}"


TITLES = {"wall": "smallest wall", "gap": "smallest gap", "overhang": "overhang", "cavities": "cavities"}


@dataclass(frozen=True, slots=True, repr=False)
class PrintReport:
    """The check of a part before printing.

    Attributes
    ----------
    met : bool
        Whether every finding keeps its limit.
    findings : tuple of PrintFinding
        Wall, gap, overhang, cavities.
    build_direction : (float, float, float)
        Unit vector from the build plate upwards.
    plate_area : float
        Area of the faces that stand on the build plate and do not count as overhang, mm2.
    resolution : float
        Greatest distance of neighbouring samples on the surface, mm. Opposite sides that are smaller than this in both
        directions may be missed; the widths found are exact to the faces.
    notes : tuple of str
        What limits the check.
    """

    met: bool
    findings: tuple[PrintFinding, ...]
    build_direction: Place
    plate_area: float
    resolution: float
    notes: tuple[str, ...] = ()

    @property
    def faults(self) -> tuple[PrintFinding, ...]:
        """The findings that do not keep their limits."""
        return tuple(finding for finding in self.findings if not finding.met)

    def __getitem__(self, check: str) -> PrintFinding:
        return {finding.check: finding for finding in self.findings}[check]

    def to_dict(self) -> dict[str, Any]:
        """The report as plain values, ready for JSON.

        The attributes by name; it is what ``tpmscad check --print --report`` writes.
        """
        return asdict(self)

    def __repr__(self) -> str:
        direction = ", ".join(f"{x:.4g}" for x in self.build_direction)
        return "\n".join(
            [
                f"{'printable' if self.met else 'NOT printable'} within the limits, built along ({direction})",
                *map(str, self.findings),
                f"sampled every {self.resolution:.3g} mm, {self.plate_area:.6g} mm2 on the build plate",
                *(f"note: {note}" for note in self.notes),
            ]
        )


@validate_options(CheckPrintOptions, 'check_print("part.step", min_wall=0.3)')
def check_print(options: CheckPrintOptions) -> PrintReport:
    """Check a part before printing: smallest wall, smallest gap, overhang and closed cavities.

    Returns
    -------
    PrintReport
        Four findings, each with value, limit and place; `met` is True if all limits are kept and there is no closed cavity.

    Raises
    ------
    InvalidRequest
        If the part has no valid closed solids, if solids touch each other, or if an argument is not understood.
    KernelError
        If the kernel cannot triangulate the part.

    Notes
    -----
    A wall is the distance between two sides of the material whose normals are opposite within 20 degrees, a gap that of two sides
    of the void. Sides that meet in a sharp edge nearby form a wedge, whose width goes to zero at every cut, and do not count.
    Faces within 1e-5 of the part's size of its lowest point stand on the build plate and are no overhang.

    Examples
    --------
    >>> model = tpmscad.lattice("gyroid", cell=10, cells=(2, 2, 2), thickness=1)  # doctest: +SKIP
    >>> tpmscad.check_print(model, min_wall=0.3, min_gap=0.3, max_overhang=45).met  # doctest: +SKIP
    False
    """
    min_wall, min_gap, max_overhang = options.min_wall, options.min_gap, options.max_overhang
    shape, report = read_closed_solids(options.source, "checked before printing")
    upwards = as_unit_vector(options.build_direction)
    surface, notes = _sample(shape, report, [limit for limit in (min_wall, min_gap) if limit is not None])
    reach = 2.0 * report.volume / report.area
    wall = find_least_width(surface, 1.0, min_wall, reach)
    solids = solids_of(shape)
    owner = np.repeat(np.arange(len(solids)), [len(faces_of(solid)) for solid in solids])
    gaps = [find_least_width(surface, -1.0, min_gap, reach), find_least_solid_gap(surface, owner)]
    gap = min((found for found in gaps if found is not None), key=lambda found: found.value, default=None)
    overhang = measure_overhang(shape, np.array(upwards), 90.0 if max_overhang is None else max_overhang)
    cavities = find_cavities(shape)
    findings = (
        _judge_width("wall", wall, min_wall),
        _judge_width("gap", gap, min_gap),
        PrintFinding(
            "overhang",
            max_overhang is None or not overhang.area > 0.0,
            overhang.angle,
            max_overhang,
            _place(overhang.place) if overhang.angle > 0.0 else None,
            area=None if max_overhang is None else overhang.area,
        ),
        PrintFinding(
            "cavities",
            not cavities,
            len(cavities),
            0,
            _place(cavities[0].place) if cavities else None,
            volume=float(sum(cavity.volume for cavity in cavities)),
        ),
    )
    met = all(finding.met for finding in findings)
    return PrintReport(met, findings, upwards, overhang.plate_area, surface.spacing, notes)


def read_closed_solids(source: Any, purpose: str) -> tuple[Any, ShapeReport]:
    """The TopoDS shape of a model, shape or file, and its report; InvalidRequest unless it consists of valid closed solids."""
    shape = read_foreign_step(source).shape if isinstance(source, str | Path) else require_shape(source)
    report = check_shape(shape)
    if not report.ok:
        found = str(report).splitlines()[0] if report.solids else "a shape that holds no solid"
        raise InvalidRequest(
            f"only valid closed solids can be {purpose}, this is {found}: repair it where it was modelled"
        )
    return shape, report


def _sample(shape: Any, report: ShapeReport, limits: Sequence[float]) -> tuple[SampledSurface, tuple[str, ...]]:
    """Samples of the surface as dense as the limits ask for, and a note if that would be too many."""
    size = float(np.linalg.norm(np.subtract(*report.bounds)))
    wanted = SAMPLE_SPACING_LIMITS * min(limits) if limits else SAMPLE_SPACING_FRACTION * report.volume / report.area
    spacing = max(wanted, (report.area / MAX_SAMPLES) ** 0.5)
    notes = (
        ()
        if spacing <= wanted
        else (
            f"the surface is sampled every {spacing:.3g} mm instead of {wanted:.3g}: walls and gaps may be missed where "
            "they are smaller than that in both directions",
        )
    )
    faces = faces_of(shape)
    samples = sample_faces(faces, spacing)
    if have_touching_solids(shape, samples, CONTACT_DIAGONALS * size, spacing):
        raise InvalidRequest("solids that touch are printed as one: unite them first, or check one of them")
    return SampledSurface.join(faces, samples, find_creases(faces, spacing), spacing, size), notes


def _judge_width(check: str, found: Width | None, limit: float | None) -> PrintFinding:
    """The finding of a smallest wall or gap."""
    if found is None:
        return PrintFinding(check, True, None, limit, None)
    return PrintFinding(check, limit is None or found.value >= limit, found.value, limit, _place(found.place))


def _place(point: Array) -> Place:
    """A point (3,) as plain numbers."""
    x, y, z = point.tolist()
    return x, y, z
