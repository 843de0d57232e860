"""What a kernel shape or a STEP file holds, measured: solids, faces, validity, closedness, volume, units, tolerances."""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from OCP.BRep import BRep_Tool
from OCP.BRepCheck import BRepCheck_Analyzer
from OCP.TopAbs import TopAbs_EDGE, TopAbs_FACE, TopAbs_SHELL, TopAbs_VERTEX
from OCP.TopLoc import TopLoc_Location
from OCP.TopoDS import TopoDS_Solid

from tpmscad._typing import Array
from tpmscad.kernel.measure.mass_properties import face_moments
from tpmscad.kernel.occt import convert
from tpmscad.kernel.occt.bounding_boxes import bounding_box
from tpmscad.kernel.occt.exploration import (
    ShapeKey,
    count_subshape_uses,
    faces_of,
    list_subshapes,
    orientation_sign,
    solids_of,
    unwrap,
)
from tpmscad.kernel.step.step_reader import read_step


@dataclass(frozen=True, slots=True)
class ShapeReport:
    """What is in a shape, in its own length unit (mm for files). Placed copies count each time.

    valid: BRepCheck finds nothing. closed: every edge is used by two faces, a seam twice by one, a degenerated edge once.
    outward: every solid's volume is positive. max_tolerance: the greatest of any vertex, edge or face.
    """

    solids: int
    shells: int
    faces: int
    edges: int
    valid: bool
    closed: bool
    outward: bool
    volume: float
    area: float
    centroid: tuple[float, float, float]
    bounds: tuple[tuple[float, float, float], tuple[float, float, float]]
    volumes: tuple[float, ...]
    max_tolerance: float

    @property
    def ok(self) -> bool:
        """Whether there are solids, all of them valid, closed and the right way out."""
        return self.solids > 0 and self.valid and self.closed and self.outward

    def to_dict(self) -> dict[str, Any]:
        """Plain values, ready for JSON."""
        return {"ok": self.ok} | asdict(self)

    def __str__(self) -> str:
        (x0, y0, z0), (x1, y1, z1) = self.bounds
        x, y, z = self.centroid
        return "\n".join(
            [
                f"{'ok' if self.ok else 'NOT ok'}: {'valid' if self.valid else 'INVALID'}, "
                f"{'closed' if self.closed else 'OPEN'}, {'outward' if self.outward else 'INSIDE OUT'}",
                f"holds       {self.solids} solids, {self.shells} shells, {self.faces} faces, {self.edges} edges",
                f"volume      {self.volume:.12g}, area {self.area:.12g}",
                f"centroid    {x:.9g} {y:.9g} {z:.9g}",
                f"box         {x0:.6g} {y0:.6g} {z0:.6g} to {x1:.6g} {y1:.6g} {z1:.6g}",
                f"tolerance   {self.max_tolerance:.3g} at most",
            ]
        )


@dataclass(frozen=True, slots=True)
class StepReport:
    """A STEP file re-read: its shape's report (in mm), the length units it is written in, its products' names."""

    file: str
    shape: ShapeReport
    units: tuple[str, ...]
    products: tuple[str, ...]

    @property
    def ok(self) -> bool:
        return self.shape.ok

    def to_dict(self) -> dict[str, Any]:
        """Plain values, ready for JSON."""
        return {"file": self.file, "units": list(self.units), "products": list(self.products)} | self.shape.to_dict()

    def __str__(self) -> str:
        names = ", ".join(self.products[:3]) + (f" and {len(self.products) - 3} more" if len(self.products) > 3 else "")
        return f"{self.file}: {names}, in {', '.join(self.units)}\n{self.shape}"


def check_step(path: str | os.PathLike[str], *, healed: bool = True) -> StepReport:
    """Read a STEP file, mended by the kernel's reader or not, and look at what is in it; errors as `read_step`."""
    content = read_step(path, healed=healed)
    return StepReport(Path(path).name, check_shape(content.shape), content.units, content.products)


@dataclass(frozen=True, slots=True, eq=False)
class _SolidFigures:
    """Figures of one solid where it was modelled, before it is placed: moments are area, volume, volume x centroid."""

    shells: int
    faces: int
    edges: int
    valid: bool
    closed: bool
    moments: Array
    bounds: tuple[Array, Array]
    tolerance: float


def is_valid(shape: Any) -> bool:
    """Whether BRepCheck finds nothing wrong with a TopoDS shape, or anything that wraps one; on all cores."""
    return bool(BRepCheck_Analyzer(unwrap(shape), True, True).IsValid())


def check_shape(shape: Any) -> ShapeReport:
    """Measure a TopoDS shape, or anything that wraps one (build123d, CadQuery). A solid placed many times is measured once."""
    measured: dict[ShapeKey, _SolidFigures] = {}
    total, volumes, figures, boxes = np.zeros(5), [], [], []
    for solid in solids_of(shape):
        unplaced = solid.Located(TopLoc_Location())
        key = ShapeKey(unplaced)
        if key not in measured:
            measured[key] = _measure_solid(convert.as_solid(unplaced))
        found = measured[key]
        moments = _transform_moments(found.moments, solid)
        if orientation_sign(solid) < orientation_sign(unplaced):
            moments[1:] *= -1.0
        total += moments
        volumes.append(float(moments[1]))
        figures.append(found)
        boxes.append(_transform_box(found.bounds, solid))
    low = np.min([low for low, _ in boxes], axis=0) if boxes else np.zeros(3)
    high = np.max([high for _, high in boxes], axis=0) if boxes else np.zeros(3)
    volume = float(total[1])
    centroid = total[2:] / volume if volume else np.zeros(3)
    return ShapeReport(
        solids=len(figures),
        shells=sum(f.shells for f in figures),
        faces=sum(f.faces for f in figures),
        edges=sum(f.edges for f in figures),
        valid=all(f.valid for f in figures),
        closed=all(f.closed for f in figures),
        outward=all(v > 0 for v in volumes),
        volume=volume,
        area=float(total[0]),
        centroid=_triple(centroid),
        bounds=(_triple(low), _triple(high)),
        volumes=tuple(sorted(volumes, reverse=True)),
        max_tolerance=max((f.tolerance for f in figures), default=0.0),
    )


def _triple(values: Array) -> tuple[float, float, float]:
    x, y, z = values.tolist()
    return x, y, z


def _measure_solid(solid: TopoDS_Solid) -> _SolidFigures:
    faces = faces_of(solid)
    edges = count_subshape_uses(solid, TopAbs_EDGE, TopAbs_FACE)
    return _SolidFigures(
        shells=len(list_subshapes(solid, TopAbs_SHELL)),
        faces=len(faces),
        edges=len(edges),
        valid=is_valid(solid),
        closed=all(uses == (1 if BRep_Tool.Degenerated_s(convert.as_edge(edge)) else 2) for edge, uses in edges),
        moments=face_moments(faces).sum(axis=0),
        bounds=bounding_box(solid),
        tolerance=max(
            float(BRep_Tool.MaxTolerance_s(solid, kind)) for kind in (TopAbs_VERTEX, TopAbs_EDGE, TopAbs_FACE)
        ),
    )


def _transform_box(bounds: tuple[Array, Array], solid: TopoDS_Solid) -> tuple[Array, Array]:
    """The box around a box where the solid's location puts it."""
    corners = np.array(np.meshgrid(*np.transpose(bounds))).reshape(3, -1)
    matrix = convert.matrix_from_occt(solid.Location().Transformation())
    placed = matrix[:, :3] @ corners + matrix[:, 3:]
    return placed.min(axis=1), placed.max(axis=1)


def _transform_moments(moments: Array, solid: TopoDS_Solid) -> Array:
    """Moments of the solid where its location puts it."""
    location = solid.Location()
    if location.IsIdentity():
        return moments.copy()
    motion = location.Transformation()
    matrix = convert.matrix_from_occt(motion)
    scale = abs(motion.ScaleFactor())
    area, volume = moments[0] * scale**2, moments[1] * scale**3
    return np.concatenate([[area, volume], scale**3 * (matrix[:, :3] @ moments[2:] + moments[1] * matrix[:, 3])])
