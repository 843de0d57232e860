"""The solids of a shape as a list from which one is chosen: number, name, size, volume, faces by kind, largest edge tolerance."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from OCP.BRep import BRep_Tool
from OCP.BRepAdaptor import BRepAdaptor_Surface
from OCP.TopAbs import TopAbs_EDGE
from OCP.TopLoc import TopLoc_Location
from OCP.TopoDS import TopoDS_Solid

from tpmscad._typing import BoxCorners
from tpmscad.kernel.measure.mass_properties import solid_moments
from tpmscad.kernel.measure.shape_extents import shape_bounds
from tpmscad.kernel.occt import convert
from tpmscad.kernel.occt.exploration import ShapeKey, faces_of, orientation_sign

MAX_LISTED = 20
"""Solids that a message lists."""


@dataclass(frozen=True, slots=True)
class SolidEntry:
    """One solid of a file.

    Attributes
    ----------
    number : int
        Its number in the file, from 1: what `solid` takes.
    name : str
        Names of instances and products from the whole assembly down; "" if the file has none that tells.
    size : tuple of float
        Edges of the smallest box along the axes that contains it, mm.
    volume : float
        Volume, mm3.
    faces : dict
        Numbers of faces by the kind of their surfaces: "plane", "cylinder", "bsplinesurface" and so on.
    edge_tolerance : float
        Largest tolerance that the kernel gives to one of its edges, mm.
    """

    number: int
    name: str
    size: tuple[float, float, float]
    volume: float
    faces: dict[str, int]
    edge_tolerance: float

    @property
    def label(self) -> str:
        """Number and name."""
        return f"{self.number} {self.name!r}" if self.name else str(self.number)

    @property
    def title(self) -> str:
        """Number, name, size and volume in a line."""
        return f"{self.label} {' x '.join(f'{edge:.4g}' for edge in self.size)} mm, {self.volume:.6g} mm3"

    def __str__(self) -> str:
        kinds = ", ".join(f"{count} {kind}" for kind, count in self.faces.items())
        return f"{self.title}; faces: {kinds}; edges within {self.edge_tolerance:.2g} mm"


def list_solids(
    solids: Sequence[TopoDS_Solid], names: Sequence[str] = (), known: tuple[float, BoxCorners] | None = None
) -> tuple[SolidEntry, ...]:
    """An entry for each solid; copies of one are measured once, and the only one not at all if volume and box are known."""
    volumes: dict[ShapeKey, float] = {}
    alone = known if len(solids) == 1 else None
    entries = []
    for number, (solid, name) in enumerate(zip(solids, names or [""] * len(solids), strict=True), 1):
        unplaced = convert.as_solid(solid.Located(TopLoc_Location()))
        key = ShapeKey(unplaced)
        turned = orientation_sign(solid) < orientation_sign(unplaced)
        if key not in volumes:
            volumes[key] = (-alone[0] if turned else alone[0]) if alone else float(solid_moments(unplaced)[1])
        low, high = alone[1] if alone else shape_bounds(solid)
        x, y, z = np.subtract(high, low).tolist()
        kinds = Counter(
            BRepAdaptor_Surface(face, False).GetType().name.removeprefix("GeomAbs_").lower() for face in faces_of(solid)
        )
        entries.append(
            SolidEntry(
                number,
                name,
                (x, y, z),
                -volumes[key] if turned else volumes[key],
                dict(kinds.most_common()),
                float(BRep_Tool.MaxTolerance_s(solid, TopAbs_EDGE)),
            )
        )
    return tuple(entries)


def describe_solids(entries: Sequence[SolidEntry]) -> str:
    """The titles of the entries in a line."""
    more = f"; and {len(entries) - MAX_LISTED} more" if len(entries) > MAX_LISTED else ""
    return "; ".join(entry.title for entry in entries[:MAX_LISTED]) + more


def list_in_lines(entries: Sequence[SolidEntry]) -> list[str]:
    """The entries in lines, each whole."""
    more = [f"and {len(entries) - MAX_LISTED} more"] if len(entries) > MAX_LISTED else []
    return [*map(str, entries[:MAX_LISTED]), *more]
