"""The report on a file of triangles: what it holds, whether it is closed, and what would be repaired of it."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tpmscad._typing import BoxCorners
from tpmscad.brep.triangles.closed_mesh import SolidMesh
from tpmscad.errors import InvalidRequest
from tpmscad.fields.data.mesh_shells import list_open_edges
from tpmscad.fields.data.triangle_mesh import close_mesh, read_triangles
from tpmscad.kernel.measure.shape_report import note_missing_unit
from tpmscad.result_display import fit_lines, tabulate_summary
from tpmscad.results.result_summary import count_pieces, format_size, round_corners

SUFFIXES_WITH_UNIT = (".3mf",)
"""Formats that state their unit; the triangles of others have numbers only."""


@dataclass(frozen=True, slots=True, repr=False)
class MeshReport:
    """What a file of triangles holds, as it is, in mm.

    Attributes
    ----------
    file : str
        Name of the file.
    triangles, points : int
        Their numbers; points at one place are one.
    pieces : int
        Parts that share no point.
    open_sides : int
        Sides of triangles that no neighbour in the opposite direction cancels; 0 if the mesh is closed.
    volume : float or None
        Volume enclosed, mm3, negative if the mesh is inside out; None if it is open. What lies in several shells counts as often.
    area : float
        Area of the triangles, mm2.
    bounds : pair of (float, float, float)
        Opposite corners of the box.
    healing : tuple of str
        What filling the mesh would repair, in words, shells that overlap too, or why it cannot; empty if nothing is wrong.
    notes : tuple of str
        What a user should know of the file: another unit or none, triangles without area.
    """

    file: str
    triangles: int
    points: int
    pieces: int
    open_sides: int
    volume: float | None
    area: float
    bounds: BoxCorners
    healing: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def ok(self) -> bool:
        """True if the mesh is closed and outwards."""
        return self.volume is not None and self.volume > 0

    def to_dict(self) -> dict[str, Any]:
        """The report as plain values for JSON. All attributes and `ok`."""
        return {"ok": self.ok} | asdict(self)

    def summary(self, *, verbose: bool = False) -> str:
        """The report in plain words, with units; `verbose` changes nothing."""
        if self.ok:
            state = "ok          closed, the right way out"
        elif self.volume is None:
            sides = "1 side of a triangle has" if self.open_sides == 1 else f"{self.open_sides} sides of triangles have"
            state = f"NOT ok      OPEN, not watertight: {sides} no neighbour of the opposite direction"
        else:
            state = "NOT ok      INSIDE OUT" if self.volume else "NOT ok      NO VOLUME"
        low, high = ("({:.6g}, {:.6g}, {:.6g})".format(*corner) for corner in round_corners(self.bounds))
        enclosed = "" if self.volume is None else f"{self.volume:.9g} mm3, "
        return "\n".join(
            [
                f"{self.file}: triangles",
                state,
                f"size        {format_size(self.bounds)} mm, from {low} to {high}",
                f"holds       {count_pieces(self.pieces)}, {self.triangles} triangles, {self.points} points",
                f"{'volume' if enclosed else 'area':<12}{enclosed}{'surface ' if enclosed else ''}{self.area:.9g} mm2",
                *(f"healing     {words}" for words in self.healing),
                *(f"warning     {note}" for note in self.notes),
            ]
        )

    def __repr__(self) -> str:
        return fit_lines([self.summary()], ".summary()")

    def _repr_html_(self) -> str:
        return tabulate_summary(self.summary())


def report_mesh(path: Path) -> MeshReport:
    """The report on a file of triangles; InvalidRequest if it cannot be read or holds none."""
    found = read_triangles(path)
    solid = SolidMesh(found.vertices, found.triangles, np.zeros(len(found.triangles), np.int64))
    open_sides = len(list_open_edges(found.triangles))
    low, high = found.vertices.min(axis=0).tolist(), found.vertices.max(axis=0).tolist()
    volume = None if open_sides else solid.volume
    try:
        healing = close_mesh(found.name, found.vertices, found.triangles).notes
    except InvalidRequest as error:
        healing = (f"impossible: {error}",)
    pieces = len(np.unique(solid.component))
    units = ("mm",) if path.suffix.lower() in SUFFIXES_WITH_UNIT else ()
    return MeshReport(
        found.name, len(found.triangles), len(found.vertices), pieces, open_sides, volume, solid.area,
        (tuple(low), tuple(high)), healing, (*found.notes, *note_missing_unit(found.name, units)),
    )  # fmt: skip
