"""What a kernel shape or a STEP file holds, measured: solids, faces, validity, closedness, volume, units, tolerances."""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from OCP.Bnd import Bnd_Box
from OCP.BRep import BRep_Tool
from OCP.BRepBndLib import BRepBndLib
from OCP.BRepCheck import BRepCheck_Analyzer
from OCP.Geom import Geom_BSplineSurface, Geom_Plane
from OCP.TopAbs import TopAbs_EDGE, TopAbs_FACE, TopAbs_REVERSED, TopAbs_SHELL, TopAbs_VERTEX
from OCP.TopLoc import TopLoc_Location
from OCP.TopoDS import TopoDS_Shape, TopoDS_Solid

from tpmscad._typing import Array
from tpmscad.kernel.measure.mass_properties import face_moments
from tpmscad.kernel.occt import convert
from tpmscad.kernel.step.step_reader import read_step, solids_of


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
    return bool(BRepCheck_Analyzer(getattr(shape, "wrapped", shape), True, True).IsValid())


def check_shape(shape: Any) -> ShapeReport:
    """Measure a TopoDS shape, or anything that wraps one (build123d, CadQuery). A solid placed many times is measured once."""
    topods: TopoDS_Shape = getattr(shape, "wrapped", shape)
    known: list[tuple[TopoDS_Shape, _SolidFigures]] = []
    by_hash: dict[int, list[int]] = {}
    total, volumes, figures, boxes = np.zeros(5), [], [], []
    for solid in solids_of(topods):
        bare = solid.Located(TopLoc_Location())
        key = hash(bare)
        at = next((i for i in by_hash.get(key, ()) if known[i][0].IsSame(bare)), None)
        if at is None:
            at = len(known)
            known.append((bare, _measure_solid(convert.as_solid(bare))))
            by_hash.setdefault(key, []).append(at)
        found = known[at][1]
        moments = _transform_moments(found.moments, solid)
        if solid.Orientation() == TopAbs_REVERSED and bare.Orientation() != TopAbs_REVERSED:
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


def bounding_box(shape: Any) -> tuple[Array, Array]:
    """Opposite corners of the box around the edges, and around faces on other surfaces than B-splines. Zeros for no shape.

    OCC's box of a B-spline face is that of its poles, half a cell too wide on lattices, and its optimal one takes minutes;
    a B-spline face that bulges beyond all edges is not seen to do so.
    """
    box = Bnd_Box()
    topods: TopoDS_Shape = getattr(shape, "wrapped", shape)
    for edge, _ in convert.count_subshape_uses(topods, TopAbs_EDGE, TopAbs_FACE):
        if not BRep_Tool.Degenerated_s(convert.as_edge(edge)):
            BRepBndLib.AddOptimal_s(edge, box, False, False)
    for face in convert.list_subshapes(topods, TopAbs_FACE):
        if not isinstance(BRep_Tool.Surface_s(convert.as_face(face)), (Geom_BSplineSurface, Geom_Plane)):
            BRepBndLib.Add_s(face, box)
    if box.IsVoid():
        return np.zeros(3), np.zeros(3)
    box.SetGap(0.0)
    return np.array(box.CornerMin().Coord()), np.array(box.CornerMax().Coord())


def _triple(values: Array) -> tuple[float, float, float]:
    x, y, z = values.tolist()
    return x, y, z


def _measure_solid(solid: TopoDS_Solid) -> _SolidFigures:
    faces = [convert.as_face(f) for f in convert.list_subshapes(solid, TopAbs_FACE)]
    edges = convert.count_subshape_uses(solid, TopAbs_EDGE, TopAbs_FACE)
    return _SolidFigures(
        shells=len(convert.list_subshapes(solid, TopAbs_SHELL)),
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
    motion = solid.Location().Transformation()
    matrix = np.array([[motion.Value(i, j) for j in range(1, 5)] for i in range(1, 4)])
    placed = matrix[:, :3] @ corners + matrix[:, 3:]
    return placed.min(axis=1), placed.max(axis=1)


def _transform_moments(moments: Array, solid: TopoDS_Solid) -> Array:
    """Moments of the solid where its location puts it."""
    location = solid.Location()
    if location.IsIdentity():
        return moments.copy()
    motion = location.Transformation()
    matrix = np.array([[motion.Value(i, j) for j in range(1, 5)] for i in range(1, 4)])
    scale = abs(motion.ScaleFactor())
    area, volume = moments[0] * scale**2, moments[1] * scale**3
    return np.concatenate([[area, volume], scale**3 * (matrix[:, :3] @ moments[2:] + moments[1] * matrix[:, 3])])
