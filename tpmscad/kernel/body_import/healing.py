"""Invalid solids of files made valid, and what was done in words; nothing is taken on trust.

In order: a solid that is inside out is turned; `ShapeFix_Shape` of OCCT may change tolerances, small edges and loops; circular
edges of a STEP file that run the long way round are turned in the file (`step.long_arcs`), which is read again. A result counts
if the kernel's check finds nothing, each edge joins two faces, no tolerance of an edge was raised above 1e-5 of the size, and
the volume is that of the points that the kernel's classifier finds in it. Of three invalid files of other programs one was
healed by ShapeFix, two by turned arcs.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np
from OCP.BRep import BRep_Tool
from OCP.BRepCheck import BRepCheck_Analyzer
from OCP.ShapeFix import ShapeFix_Shape
from OCP.TopAbs import TopAbs_EDGE, TopAbs_FACE, TopAbs_WIRE
from OCP.TopoDS import TopoDS_Face, TopoDS_Shape, TopoDS_Solid

from tpmscad.kernel.body_import.closed_shells import list_free_edges, turn_outward
from tpmscad.kernel.measure.invalid_faces import describe_invalid_face
from tpmscad.kernel.measure.shape_report import ShapeReport, check_shape
from tpmscad.kernel.measure.shape_sampling import contains_points
from tpmscad.kernel.occt.bounding_boxes import box_diagonal
from tpmscad.kernel.occt.exploration import faces_of, list_subshapes, solids_of
from tpmscad.kernel.step.long_arcs import CircularEdges
from tpmscad.kernel.step.step_reader import list_circular_edges

FIXING_PRECISION, MAX_FIXED_TOLERANCE = 1e-5, 1e-3
"""Millimetres, of ShapeFix. Its largest tolerance is 1e-7 by default, at which it may not change anything."""

MAX_FIXED_SIZE = 1e-5
"""In body sizes: largest tolerance that healing may give to an edge, as sewing may."""

VOLUME_SAMPLES = 1500
"""Random points in a solid's box, by which its volume is measured once more."""

VOLUME_DEVIATIONS = 5.0
"""Standard deviations of that volume within which the integrated one has to be."""

MAX_ARC_READINGS, MAX_ARC_SECONDS = 60, 40.0
"""Readings of a file in search of the arcs that are to be turned, and their time: two thirds of the least that a child has."""


@dataclass(frozen=True, slots=True, eq=False)
class StepArcs:
    """The STEP file of a solid, and what reads the solid again with some of its circular edges turned; None if it is lost."""

    path: str | os.PathLike[str]
    read_turned: Callable[[Collection[int]], TopoDS_Solid | None]


@dataclass(frozen=True, slots=True, eq=False)
class Healed:
    """A sound solid with its report, and what was done to it, in words, "" if nothing was."""

    solid: TopoDS_Solid
    report: ShapeReport
    words: str


def describe_faults(solid: TopoDS_Solid, report: ShapeReport) -> str:
    """What is wrong with a solid, in words, with the place; "" if it is valid, closed and not inside out."""
    if not report.closed:
        free = list_free_edges(solid)
        return (
            f"is not closed: {len(free)} of its edges bound one face only"
            if free
            else "is not closed: some of its edges bound more than two faces"
        )
    if not report.valid:
        where = describe_invalid_face(solid)
        return "is invalid for the kernel (BRepCheck)" + (f": {where}" if where else "")
    if report.volume <= 0:
        return f"is inside out: its volume is {report.volume:.6g}"
    return ""


def heal_solid(solid: TopoDS_Solid, report: ShapeReport, arcs: StepArcs | None) -> Healed | None:
    """An unsound solid made sound; None if no way is found. `arcs`: of its file, if that is STEP.

    ShapeFix changes the tolerances of `solid` itself, and exceeds the largest that it is given.
    """
    fault = f"it {describe_faults(solid, report)}"
    largest = max(MAX_FIXED_SIZE * box_diagonal(solid), BRep_Tool.MaxTolerance_s(solid, TopAbs_EDGE))

    def accept(healed: Sequence[TopoDS_Solid], words: str) -> Healed | None:
        """What was healed, with the volumes before and after; None unless it is one solid, sound, and within `largest`."""
        if len(healed) != 1 or BRep_Tool.MaxTolerance_s(healed[0], TopAbs_EDGE) > largest:
            return None
        after = check_shape(healed[0])
        if not after.ok or not volume_agrees(healed[0], after):
            return None
        volumes = f"its volume was {report.volume:.9g} mm3 and is {after.volume:.9g} mm3"
        return Healed(healed[0], after, f"{fault}; {words}; {volumes}")

    if report.valid and report.closed:
        return accept([turn_outward(solid)], "turned round")
    if healed := accept(_fix(solid), "changed by the kernel's shape healing"):
        return healed
    if arcs is None:
        return None
    edges = list_circular_edges(arcs.path, find_rejected_faces)
    turned = find_turned_arcs(edges, lambda numbers: count_rejected(arcs.read_turned(numbers)))
    found = arcs.read_turned(turned) if turned else None
    if found is None:
        return None
    edge = "circular edges, which run" if len(turned) > 1 else "circular edge, which runs"
    numbers = ", ".join(map(str, sorted(turned)))
    return accept([found], f"turned {len(turned)} {edge} the wrong way round: entity {numbers} of the file")


def find_turned_arcs(
    arcs: CircularEdges, count_faults: Callable[[Collection[int]], float], seconds: float = MAX_ARC_SECONDS
) -> frozenset[int]:
    """The fewest circular edges without faults when they are turned; none if MAX_ARC_READINGS calls, or `seconds`, do not do.

    The search begins with the long arcs at the faults, or with all long arcs if these leave fewer faults. One group after the
    other is turned, or turned back, if that lowers the number of faults. Then those are turned back that are not needed: a boss
    with a flat, whose arc is long, has as valid a twin without most of it.
    """
    end = time.monotonic() + seconds
    starts = {frozenset(chain(*groups)): 0.0 for groups in (arcs.suspect, arcs.long)}
    starts = {start: count_faults(start) for start in starts}
    turned = min(starts, key=starts.__getitem__)
    faults, readings = starts[turned], len(starts)
    groups = [frozenset(group) for group in (*arcs.long, *arcs.closed)]
    for group in groups:
        if faults == 0 or readings >= MAX_ARC_READINGS or time.monotonic() > end:
            break
        left = count_faults(turned ^ group)
        readings += 1
        if left < faults:
            turned, faults = turned ^ group, left
    for group in [group for group in groups if group < turned] if faults == 0 else ():
        if time.monotonic() > end:
            return frozenset()
        if count_faults(turned - group) == 0:
            turned -= group
    return turned if faults == 0 else frozenset()


def find_rejected_faces(shape: TopoDS_Shape) -> list[TopoDS_Face]:
    """The faces of a shape that the kernel's check rejects."""
    return [face for face in faces_of(shape) if not BRepCheck_Analyzer(face).IsValid()]


def count_rejected(solid: TopoDS_Solid | None) -> float:
    """Number of faces, loops and edges of a solid that the kernel's check rejects, at least 1; 0 if the solid is sound."""
    if solid is None:
        return float("inf")
    report = check_shape(solid)
    if report.ok:
        return 0
    analyzer = BRepCheck_Analyzer(solid)
    parts = [part for kind in (TopAbs_FACE, TopAbs_WIRE, TopAbs_EDGE) for part in list_subshapes(solid, kind)]
    return max(1, sum(not analyzer.IsValid(part) for part in parts) + (report.volume <= 0))


def volume_agrees(solid: TopoDS_Solid, report: ShapeReport) -> bool:
    """Whether the volume is that of the random points of the solid's box that are in it."""
    low, high = np.array(report.bounds)
    points = low + (high - low) * np.random.default_rng(0).random((VOLUME_SAMPLES, 3))
    inside = int(contains_points(solid, points).sum())
    part = report.volume / float((high - low).prod())
    deviation = np.sqrt(max(part * (1.0 - part), 1.0 / VOLUME_SAMPLES) / VOLUME_SAMPLES)
    return bool(abs(inside / VOLUME_SAMPLES - part) <= VOLUME_DEVIATIONS * deviation)


def _fix(solid: TopoDS_Solid) -> Sequence[TopoDS_Solid]:
    """The solids of ShapeFix_Shape; none if it fails."""
    largest = min(MAX_FIXED_TOLERANCE, MAX_FIXED_SIZE * box_diagonal(solid))
    fixing = ShapeFix_Shape(solid)
    fixing.SetPrecision(min(FIXING_PRECISION, largest))
    fixing.SetMaxTolerance(largest)
    try:
        fixing.Perform()
        return solids_of(fixing.Shape())
    except Exception:  # OCCT's exceptions have no common base class
        return ()
