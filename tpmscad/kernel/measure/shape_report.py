"""Reports on OCCT shapes and STEP files: counts, validity, closedness, mass properties, bounds, units and tolerances."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from OCP.BRep import BRep_Tool
from OCP.BRepCheck import BRepCheck_Analyzer
from OCP.TopAbs import TopAbs_EDGE, TopAbs_FACE, TopAbs_SHELL, TopAbs_VERTEX
from OCP.TopLoc import TopLoc_Location
from OCP.TopoDS import TopoDS_Solid

from tpmscad._typing import Array, triple
from tpmscad.kernel.measure.face_table import FaceEntry
from tpmscad.kernel.measure.mass_properties import solid_moments
from tpmscad.kernel.measure.shape_extents import shape_bounds
from tpmscad.kernel.measure.solid_list import SolidEntry, list_in_lines, tabulate_solids
from tpmscad.kernel.occt import convert
from tpmscad.kernel.occt.child_process import may_use_threads
from tpmscad.kernel.occt.exploration import (
    ShapeKey,
    count_subshape_uses,
    faces_of,
    list_bounding_edges,
    list_subshapes,
    orientation_sign,
    solids_of,
    unwrap,
)
from tpmscad.kernel.step.step_reader import read_step
from tpmscad.result_display import list_names

BOUNDS_ROUNDING = 10.0
"""Largest tolerances of the shape to which summaries round the corners of its bounding box."""

SQUARE_TOL = 1e-15
"""Entries of a matrix below this are zeros of a motion that takes axes to axes."""


@dataclass(frozen=True, slots=True, repr=False)
class ShapeReport:
    """Measured properties of a shape, in its own length unit (mm for STEP files).

    Placed copies of a solid are counted each time.

    Attributes
    ----------
    solids, shells, faces, edges : int
        Numbers of sub-shapes.
    valid : bool
        BRepCheck reports no error.
    closed : bool
        Every edge has two uses by faces (a seam two uses by one face), a degenerate edge one.
    outward : bool
        The volume of every solid is positive.
    volume, area : float
        Totals over all solids.
    centroid : tuple of float
        Center of mass.
    bounds : tuple
        Opposite corners of the smallest box that contains the shape.
    volumes : tuple of float
        Volume of each solid, largest first.
    max_tolerance : float
        Largest tolerance of any vertex, edge or face.
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
        """True if there is at least one solid and all solids are valid, closed and oriented outwards."""
        return self.solids > 0 and self.valid and self.closed and self.outward

    def to_dict(self) -> dict[str, Any]:
        """The report as plain values for JSON. All attributes and `ok`."""
        return {"ok": self.ok} | asdict(self)

    def __repr__(self) -> str:
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


@dataclass(frozen=True, slots=True, repr=False)
class StepReport:
    """Measured properties of a STEP file that was read back.

    Attributes
    ----------
    file : str
        Name of the file.
    shape : ShapeReport
        Report on its shape, in mm.
    units : tuple of str
        Length units of the file.
    products : tuple of str
        Names of its products.
    faces : tuple of tuple of FaceEntry
        The faces of each solid, if they were asked for.
    solids : tuple of SolidEntry
        The solids: number, name, size, volume, faces by kind, largest edge tolerance.
    accuracy : float or None
        The accuracy that the file states, mm.
    healing : tuple of str
        What reading the file as a body would repair, in words, or why it cannot; empty if nothing is wrong.
    """

    file: str
    shape: ShapeReport
    units: tuple[str, ...]
    products: tuple[str, ...]
    faces: tuple[tuple[FaceEntry, ...], ...] = ()
    solids: tuple[SolidEntry, ...] = ()
    accuracy: float | None = None
    healing: tuple[str, ...] = ()

    @property
    def ok(self) -> bool:
        """True if the shape is valid, closed and oriented outwards (`ShapeReport.ok`)."""
        return self.shape.ok

    @property
    def notes(self) -> tuple[str, ...]:
        """What a user should know of the file: that it states no unit."""
        return note_missing_unit(self.file, self.units)

    def to_dict(self) -> dict[str, Any]:
        """The report as plain values for JSON.

        `file`, `units`, `products`, `notes`, `accuracy`, `healing`, `solid_table` with the attributes of each solid, the
        entries of `ShapeReport.to_dict`, and if they were asked for `face_table`, the attributes of the faces of each solid.
        """
        of_file: dict[str, Any] = {
            "file": self.file,
            "units": list(self.units),
            "products": list(self.products),
            "notes": list(self.notes),
            "accuracy": self.accuracy,
            "solid_table": [asdict(solid) for solid in self.solids],
            "healing": list(self.healing),
        }
        if self.faces:
            of_file["face_table"] = [[asdict(face) for face in solid] for solid in self.faces]
        return of_file | self.shape.to_dict()

    def summary(self, *, verbose: bool = False) -> str:
        """The report in plain words, with units.

        Parameters
        ----------
        verbose : bool, optional
            Add shells, edges, centroid and tolerance.

        Returns
        -------
        str
            A few lines: names and units, whether the solids are sound, their size, number, volume and surface.
        """
        shape = self.shape
        wrong = [
            what
            for is_wrong, what in (
                (not shape.solids, "NO SOLID"),
                (not shape.valid, "INVALID, the kernel's check rejects it"),
                (not shape.closed, "OPEN, not watertight"),
                (not shape.outward, "INSIDE OUT"),
            )
            if is_wrong
        ]
        lines = [
            f"{self.file}: {', '.join((*self.products[:3], self._describe_units()))}",
            "ok          valid, closed, the right way out" if not wrong else f"NOT ok      {'; '.join(wrong)}",
            *(self._describe_size() if shape.solids else ()),
        ]
        lines += [f"solid       {line}" for line in list_in_lines(self.solids)]
        if self.accuracy is not None:
            lines.append(f"accuracy    {self.accuracy:.3g} mm, as the file states it")
        lines += [f"healing     {words}" for words in self.healing]
        lines += [f"warning     {note}" for note in self.notes]
        if (cavities := shape.shells - shape.solids) > 0:
            found = "1 closed cavity" if cavities == 1 else f"{cavities} closed cavities"
            lines.append(f"warning     {found} inside: powder or fluid cannot get out")
        if verbose:
            lines += [
                f"shells      {shape.shells}, with {shape.edges} edges",
                f"centroid    ({', '.join(f'{c:.9g}' for c in shape.centroid)})",
                f"tolerance   {shape.max_tolerance:.3g} mm at most",
            ]
        for number, solid in enumerate(self.faces, 1):
            lines += [f"solid       {number}"] if len(self.faces) > 1 else []
            lines += [f"face        {face}" for face in solid]
        return "\n".join(lines)

    def _describe_size(self) -> list[str]:
        """Size, numbers and volume in lines."""
        shape = self.shape
        low, high = (np.asarray(corner) for corner in shape.bounds)
        size = " x ".join(f"{edge:.6g}" for edge in high - low)
        digits = int(-np.log10(BOUNDS_ROUNDING * max(shape.max_tolerance, convert.CONFUSION_TOLERANCE)))
        corners = " to ".join(
            f"({', '.join(f'{c:.6g}' for c in np.round(corner, digits) + 0.0)})" for corner in (low, high)
        )
        solids = "1 solid" if shape.solids == 1 else f"{shape.solids} solids"
        return [
            f"size        {size} mm, from {corners}",
            f"holds       {solids}, {shape.faces} faces",
            f"volume      {shape.volume:.9g} mm3, surface {shape.area:.9g} mm2",
        ]

    def __repr__(self) -> str:
        return f"{self.file}: {list_names(self.products, 3)}, {self._describe_units()}\n{self.shape}"

    def _repr_html_(self) -> str:
        return tabulate_solids(self.file, self.solids)

    def _describe_units(self) -> str:
        """The length units in words."""
        return f"written in {', '.join(self.units)}" if self.units else "no unit"


def note_missing_unit(file: str, units: tuple[str, ...]) -> tuple[str, ...]:
    """A note on a STEP file without a length unit; empty if it has one."""
    return () if units else (f"{file} states no length unit: its numbers were read as millimetres",)


def check_step(path: str | os.PathLike[str], *, healed: bool = True) -> StepReport:
    """Report on a STEP file that is read with the kernel, with or without shape healing.

    Raises the errors of `read_step`.
    """
    content = read_step(path, healed=healed)
    return StepReport(Path(path).name, check_shape(content.shape), content.units, content.products)


@dataclass(frozen=True, slots=True, eq=False)
class _SolidFigures:
    """Properties of one solid before placement; moments are area, volume and volume times centroid."""

    shells: int
    faces: int
    edges: int
    valid: bool
    closed: bool
    moments: Array
    bounds: tuple[Array, Array]
    tolerance: float


def is_valid(shape: Any) -> bool:
    """True if BRepCheck finds no error in a TopoDS, build123d or CadQuery shape; runs in parallel."""
    return bool(BRepCheck_Analyzer(unwrap(shape), True, may_use_threads()).IsValid())


def check_shape(shape: Any) -> ShapeReport:
    """Report on a TopoDS, build123d or CadQuery shape; a solid that is placed many times is measured once."""
    return _sum_up(_measure_placed_solids(solids_of(shape)))


def check_solids(solids: Sequence[TopoDS_Solid]) -> tuple[ShapeReport, tuple[ShapeReport, ...]]:
    """Report on solids together, and on each of them; one that is placed many times is measured once."""
    measured = _measure_placed_solids(solids)
    return _sum_up(measured), tuple(_sum_up([one]) for one in measured)


@dataclass(frozen=True, slots=True, eq=False)
class _PlacedFigures:
    """Properties of a placed solid: those that its place does not change, moments and box."""

    own: _SolidFigures
    moments: Array
    bounds: tuple[Array, Array]


def _measure_placed_solids(solids: Sequence[TopoDS_Solid]) -> list[_PlacedFigures]:
    """Properties of solids, of which each that is placed many times is measured once."""
    measured: dict[ShapeKey, _SolidFigures] = {}
    placed = []
    for solid in solids:
        unplaced = solid.Located(TopLoc_Location())
        key = ShapeKey(unplaced)
        if key not in measured:
            measured[key] = _measure_solid(convert.as_solid(unplaced))
        found = measured[key]
        moments = _transform_moments(found.moments, solid)
        if orientation_sign(solid) < orientation_sign(unplaced):
            moments[1:] *= -1.0
        placed.append(_PlacedFigures(found, moments, _place_bounds(found.bounds, solid)))
    return placed


def _sum_up(placed: Sequence[_PlacedFigures]) -> ShapeReport:
    """The report on solids together."""
    total = np.sum([of.moments for of in placed], axis=0) if placed else np.zeros(5)
    low = np.min([of.bounds[0] for of in placed], axis=0) if placed else np.zeros(3)
    high = np.max([of.bounds[1] for of in placed], axis=0) if placed else np.zeros(3)
    volume, volumes = float(total[1]), [float(of.moments[1]) for of in placed]
    centroid = total[2:] / volume if volume else np.zeros(3)
    figures = [of.own for of in placed]
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
        centroid=triple(centroid.tolist()),
        bounds=(triple(low.tolist()), triple(high.tolist())),
        volumes=tuple(sorted(volumes, reverse=True)),
        max_tolerance=max((f.tolerance for f in figures), default=0.0),
    )


def _measure_solid(solid: TopoDS_Solid) -> _SolidFigures:
    """Properties of a solid without its location."""
    faces = faces_of(solid)
    edges = count_subshape_uses(solid, TopAbs_EDGE, TopAbs_FACE)
    return _SolidFigures(
        shells=len(list_subshapes(solid, TopAbs_SHELL)),
        faces=len(faces),
        edges=len(edges),
        valid=is_valid(solid),
        closed=_is_closed(edges, faces),
        moments=solid_moments(solid),
        bounds=shape_bounds(solid) if faces else (np.zeros(3), np.zeros(3)),
        tolerance=max(
            float(BRep_Tool.MaxTolerance_s(solid, kind)) for kind in (TopAbs_VERTEX, TopAbs_EDGE, TopAbs_FACE)
        ),
    )


def _is_closed(edges: Sequence[tuple[Any, int]], faces: Sequence[Any]) -> bool:
    """Whether each edge, with the number of its uses by faces, bounds two, one if it is degenerate, or lies within a face."""
    needed = {ShapeKey(edge): 1 if BRep_Tool.Degenerated_s(convert.as_edge(edge)) else 2 for edge, _ in edges}
    if all(uses == needed[ShapeKey(edge)] for edge, uses in edges):
        return True
    bounding = Counter(ShapeKey(edge) for face in faces for edge in list_bounding_edges(face))
    return all(uses == needed[edge] for edge, uses in bounding.items())


def _place_bounds(bounds: tuple[Array, Array], solid: TopoDS_Solid) -> tuple[Array, Array]:
    """True extent of a placed solid, given that of the solid without its location."""
    matrix = convert.matrix_from_occt(solid.Location().Transformation())
    if np.count_nonzero(np.abs(matrix[:, :3]) > SQUARE_TOL) > 3:  # the axes are not permuted: the extent is another one
        return shape_bounds(solid)
    placed = np.array(bounds) @ matrix[:, :3].T + matrix[:, 3]
    return placed.min(axis=0), placed.max(axis=0)


def _transform_moments(moments: Array, solid: TopoDS_Solid) -> Array:
    """Moments moved by the solid's location."""
    location = solid.Location()
    if location.IsIdentity():
        return moments.copy()
    motion = location.Transformation()
    matrix = convert.matrix_from_occt(motion)
    scale = abs(motion.ScaleFactor())
    area, volume = moments[0] * scale**2, moments[1] * scale**3
    return np.concatenate([[area, volume], scale**3 * (matrix[:, :3] @ moments[2:] + moments[1] * matrix[:, 3])])
