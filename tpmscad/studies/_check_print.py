"""The check of a part before printing: smallest wall, smallest gap, overhang and closed cavities, measured on the exact solid.

Walls and gaps are bounded from below by a search that misses none (`tpmscad.kernel.printability.least_widths`), overhang is
integrated over the exact faces, and cavities are closed surfaces inside the solids. None of it uses how the part was made, so
that a file of any program is checked like a model.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tpmscad._typing import triple
from tpmscad.api.public_calls import validate_options
from tpmscad.brep.least_width import RESOLUTION, LeastWidth
from tpmscad.errors import InvalidRequest
from tpmscad.fields.periods_and_directions import as_unit_vector
from tpmscad.kernel.body_import.isolated_reader import read_foreign_step
from tpmscad.kernel.measure.shape_report import ShapeReport, check_shape
from tpmscad.kernel.measure.shape_sampling import have_touching_solids, sample_faces
from tpmscad.kernel.occt.exploration import faces_of, require_shape
from tpmscad.kernel.printability.cavities import find_cavities
from tpmscad.kernel.printability.least_widths import measure_least_widths
from tpmscad.kernel.printability.overhang import measure_overhang
from tpmscad.requests.study_options import CheckPrintOptions
from tpmscad.result_display import format_html_table

CONTACT_SPACING_FRACTION = 0.4
"""Greatest distance of the samples by which touching solids are found, in units of volume / area, half the wall of a sheet."""

MAX_SAMPLES = 2_000_000
"""Greatest number of these samples, about half a gigabyte with their search tree."""

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
    bound : float or None
        No wall or gap is smaller than this, mm; the value is attained by two places. At most 2 % below the value, or else what
        could not be ruled out.
    limit : float or None
        The least wall or gap, the greatest overhang, or 0 cavities; None if it was not given.
    place : (float, float, float) or None
        Middle of the wall or gap, the steepest place, or a point in the largest cavity.
    area : float or None
        Of the faces beyond the limit of overhang, mm2.
    volume : float or None
        Of all cavities, mm3.
    places : pair of (float, float, float) or None
        The two places between which the wall or gap has its value.
    """

    check: str
    met: bool
    value: float | None
    limit: float | None
    place: Place | None
    area: float | None = None
    volume: float | None = None
    bound: float | None = None
    places: tuple[Place, Place] | None = None

    def __str__(self) -> str:
        at = "" if self.place is None else f" at {_format_place(self.place)}"
        if self.check == "cavities":
            found = f"{self.value:g} closed, {self.volume:.6g} mm3 in all,{at}" if self.value else "none closed"
        elif self.value is None:
            found = "none: no two sides are opposite"
        elif self.check == "overhang":
            beyond = "" if self.area is None else f", {self.area:.6g} mm2 beyond the limit"
            found = f"{self.value:.4g} degrees{at}{beyond}"
        else:
            if self.places is not None:
                at = " from {} to {}".format(*map(_format_place, self.places))
            found = f"{self.value:.4g} mm{at}" + (
                "" if self.bound is None else f", proven: none below {self.bound:.4g}"
            )
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
        By how much of its value the bound of a wall or gap may stay below it.
    """

    met: bool
    findings: tuple[PrintFinding, ...]
    build_direction: Place
    plate_area: float
    resolution: float

    @property
    def faults(self) -> tuple[PrintFinding, ...]:
        """The findings that do not keep their limits."""
        return tuple(finding for finding in self.findings if not finding.met)

    @property
    def smallest_wall(self) -> PrintFinding:
        """The finding of the smallest wall: `bound`, `value`, `places`."""
        return self["wall"]

    @property
    def smallest_gap(self) -> PrintFinding:
        """The finding of the smallest gap."""
        return self["gap"]

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
                f"walls and gaps to {100 * self.resolution:g} %, {self.plate_area:.6g} mm2 on the build plate",
            ]
        )

    def _repr_html_(self) -> str:
        head = ("check", "kept", "value", "proven bound", "limit", "place, mm")
        rows = [
            (TITLES[found.check], found.met, found.value, found.bound, found.limit, found.place)
            for found in self.findings
        ]
        return format_html_table(str(self).splitlines()[0], rows, head)


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
    A wall is the distance between two sides of the material along their common normal, or along the normal of one of them where
    a sharp edge ends the other, which may taper by 20 degrees; a gap is that of two sides of the void, or of two solids. Sides
    that meet in a sharp edge nearby form a wedge, whose width goes to zero at every cut, and do not count. A limit is kept if
    the value keeps it and no wall or gap is more than 2 % below it.
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
    refuse_touching_solids(shape, report, "are printed as one: unite them first, or check one of them")
    wall, gap = measure_least_widths(shape, report)
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
            triple(overhang.place.tolist()) if overhang.angle > 0.0 else None,
            area=None if max_overhang is None else overhang.area,
        ),
        PrintFinding(
            "cavities",
            not cavities,
            len(cavities),
            0,
            triple(cavities[0].place.tolist()) if cavities else None,
            volume=float(sum(cavity.volume for cavity in cavities)),
        ),
    )
    met = all(finding.met for finding in findings)
    return PrintReport(met, findings, upwards, overhang.plate_area, RESOLUTION)


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


def refuse_touching_solids(shape: Any, report: ShapeReport, why: str) -> None:
    """InvalidRequest if faces of different solids lie on each other."""
    size = float(np.linalg.norm(np.subtract(*report.bounds)))
    spacing = max(CONTACT_SPACING_FRACTION * report.volume / report.area, (report.area / MAX_SAMPLES) ** 0.5)
    if report.solids > 1 and have_touching_solids(
        shape, sample_faces(faces_of(shape), spacing), CONTACT_DIAGONALS * size, spacing
    ):
        raise InvalidRequest(f"solids that touch {why}")


def _judge_width(check: str, found: LeastWidth | None, limit: float | None) -> PrintFinding:
    """The finding of a smallest wall or gap."""
    if found is None:
        return PrintFinding(check, True, None, limit, None)
    met = limit is None or (found.value >= limit and found.bound >= limit * (1.0 - RESOLUTION))
    first, second = found.places
    return PrintFinding(
        check,
        met,
        found.value,
        limit,
        triple(found.places.mean(axis=0).tolist()),
        bound=found.bound,
        places=(triple(first.tolist()), triple(second.tolist())),
    )


def _format_place(place: Place) -> str:
    """A place in words, to four digits."""
    return "(" + ", ".join(f"{round(x, 9) + 0.0:.4g}" for x in place) + ")"
