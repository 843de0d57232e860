"""Parts with what is kept and what is cleared, within skins with open faces: kept volumes and skins judged on the solid.

    python -m benchmarks.kept_parts [mount | flange | stem | bracket | housing | FILE:RADIUS:WIDTH] ...

A file is filled within a skin, and the holes of its solid up to a radius keep walls of a width. Columns: CPU seconds; whether the
request is met; the volume of what is kept that the kernel finds in the solid, relative to the whole, less one; the volume of what
is cleared in the solid; how many points that are less deep than .98 skins lie outside the solid, of how many; pieces.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import build123d as bd
import numpy as np

import tpmscad
from tpmscad.kernel.body_import.cad_body import read_bodies
from tpmscad.kernel.boolean.boolean_operations import intersect_solids
from tpmscad.kernel.boolean.kept_solids import find_holes
from tpmscad.kernel.measure.mass_properties import solid_moments
from tpmscad.kernel.measure.shape_sampling import contains_points
from tpmscad.kernel.measure.skin_depth import SkinDepth
from tpmscad.kernel.occt.bounding_boxes import box_diagonal, enclosing_box
from tpmscad.kernel.occt.exploration import faces_of, solids_of, unwrap
from tpmscad.requests.face_selection import resolve_face_selectors

POINTS, NEARLY = 4000, 0.98
"""Points in the box of a body; part of the skin within which every point of the body is solid."""


@dataclass(frozen=True)
class Part:
    """A body, its filling, and what is kept and cleared of it as solids that the judge takes for granted."""

    body: Any
    options: dict[str, Any]
    kept: list[Any] = field(default_factory=list)
    cleared: list[Any] = field(default_factory=list)


def _bore(places: list[tuple[float, float]], radius: float, height: float) -> list[Any]:
    return [bd.Pos(x, y, 0) * bd.Cylinder(radius, height) for x, y in places]


def _make_mount() -> Part:
    """A motor mount: four screws and a shaft, bosses round the screws, open above."""
    corners = [(x, y) for x in (-15.5, 15.5) for y in (-15.5, 15.5)]
    plate = bd.Box(42, 42, 12) - _bore([(0, 0)], 11, 20) - _bore(corners, 1.6, 20)
    bosses = [ring - hole for ring, hole in zip(_bore(corners, 4.6, 12), _bore(corners, 1.6, 12), strict=True)]
    return Part(plate, {"cell": 8, "skin": 0.8, "open_faces": ">Z", "keep": ("bosses", 3.0, 1.6)}, bosses)


def _make_flange() -> Part:
    """A flange on a pipe: six bolts with seats that are kept, and a groove for a ring that is cleared."""
    places = [(24 * np.cos(a), 24 * np.sin(a)) for a in np.arange(6) * np.pi / 3]
    body = bd.Cylinder(31, 12) + bd.Pos(0, 0, 12) * bd.Cylinder(15, 24) - bd.Cylinder(11, 60) - _bore(places, 2.7, 20)
    seats = [ring - hole for ring, hole in zip(_bore(places, 5.7, 12), _bore(places, 2.7, 12), strict=True)]
    groove = bd.Pos(0, 0, -5) * (bd.Cylinder(17, 2.4) - bd.Cylinder(14.6, 2.4))
    return Part(body, {"cell": 9, "skin": 1.0, "keep": ("bosses", 3.0, 2.7), "clear": groove}, seats, [groove.solid()])


def _make_stem() -> Part:
    """The stem of a hip, a loft, with a taper in its neck that is kept, and a hole for a tool that is cleared."""
    profiles = [
        bd.Pos(0, 0, 0) * bd.Ellipse(4, 3.2).face(),
        bd.Pos(0.6, 0, 14) * bd.Ellipse(5, 4).face(),
        bd.Pos(2.2, 0, 28) * bd.Ellipse(7.5, 5.2).face(),
        bd.Pos(4.5, 0, 40) * bd.Ellipse(11, 6.5).face(),
    ]
    taper = bd.Pos(4.5, 0, 35) * bd.Cone(3.2, 3.8, 10)
    tool = bd.Pos(-2.5, 0, 38) * bd.Cylinder(1.0, 6)
    return Part(
        bd.loft(profiles).solid(),
        {"cell": 6, "skin": 0.6, "open_faces": "<Z", "keep": taper, "clear": tool},
        [taper.solid()],
        [tool.solid()],
    )


def _make_bracket() -> Part:
    """A bracket with a rounded edge: a kept block shares two of its faces, and a cleared bore touches the block."""
    body = bd.Box(40, 20, 10) + bd.Pos(-15, 0, 15) * bd.Box(10, 20, 20)
    body = bd.fillet(body.edges().filter_by(bd.Axis.Y).filter_by_position(bd.Axis.Z, 4.9, 5.1).sort_by(bd.Axis.X)[0], 4)
    block = bd.Pos(15, 0, 0) * bd.Box(10, 12, 10)
    bore = bd.Pos(7, 0, 0) * bd.Cylinder(3, 20)
    return Part(body, {"cell": 7, "skin": 0.7, "keep": block, "clear": bore}, [block.solid()], [bore.solid()])


def _make_housing() -> Part:
    """A ball on a foot: a kept plate within it, and a cleared port through its skin."""
    body = bd.Sphere(14) + bd.Pos(0, 0, -13) * bd.Cylinder(9, 8)
    plate = bd.Pos(0, 0, -15.5) * bd.Cylinder(9, 3)
    port = bd.Pos(10, 0, 2) * bd.Rot(0, 90, 0) * bd.Cylinder(3, 14)
    return Part(body, {"cell": 8, "skin": 0.8, "keep": plate, "clear": port}, [plate.solid()], [port.solid()])


PARTS: dict[str, Callable[[], Part]] = {
    "mount": _make_mount,
    "flange": _make_flange,
    "stem": _make_stem,
    "bracket": _make_bracket,
    "housing": _make_housing,
}


def _read_part(words: str) -> Part:
    """A file whose round holes of a radius keep walls of a width."""
    path, radius, width = words.rsplit(":", 2)
    (body,) = read_bodies(path)
    size = box_diagonal(body.shape)
    holes = [hole for hole in find_holes(body.shape) if abs(hole.radius - float(radius)) < 1e-3]
    bosses = [solid for hole in holes for solid in intersect_solids(hole.grow(float(width)), body.shape)]
    options = {"cell": size / 10, "skin": size / 100, "keep": ("bosses", float(width), float(radius))}
    return Part(path, options, bosses)


def judge(name: str, part: Part) -> str:
    """A row of the table."""
    cell, skin = part.options["cell"], part.options["skin"]
    begun = time.process_time()
    model = tpmscad.infill(part.body, "gyroid", thickness=0.1 * cell, tol=0.01 * cell, progress=False, **part.options)
    spent = time.process_time() - begun
    solids = solids_of(unwrap(model.solid))
    kept, cleared = (_measure(part_of, solids) for part_of in (part.kept, part.cleared))
    (body,) = read_bodies(part.body)
    faces = faces_of(body.shape)
    opened = resolve_face_selectors(body, part.options.get("open_faces", ()))
    faces = [face for number, face in enumerate(faces) if number not in opened]
    low, high = (np.array(corner) for corner in enclosing_box(body.shape))
    points = np.random.default_rng(1).uniform(low, high, (POINTS, 3))
    points = points[contains_points(body.shape, points)]
    points = points[SkinDepth(body.shape, faces).distances(points) < NEARLY * skin]
    for region in part.cleared:
        points = points[~contains_points(unwrap(region), points)]
    held = np.any([contains_points(solid, points) for solid in solids], axis=0)
    whole = sum(solid_moments(unwrap(region))[1] for region in part.kept)
    return (
        f"{name:24s} {spent:6.1f} s {'met' if model.certificate.met else 'NOT met'}  kept {kept / whole - 1:+.1e}  "
        f"cleared {cleared:.1e} mm3  skin {int((~held).sum())} of {len(points)} outside  {len(solids)} piece"
    )


def _measure(regions: list[Any], solids: list[Any]) -> float:
    """The volume of regions that lies in solids, by the kernel."""
    common = (part for region in regions for solid in solids for part in intersect_solids(unwrap(region), solid))
    return float(sum(solid_moments(part)[1] for part in common))


if __name__ == "__main__":
    for word in sys.argv[1:] or PARTS:
        print(judge(Path(word).name, PARTS[word]() if word in PARTS else _read_part(word)), flush=True)
