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
from tpmscad.kernel.occt.exploration import ShapeKey, faces_of
from tpmscad.result_display import format_html_table

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
    solids: Sequence[TopoDS_Solid], figures: Sequence[tuple[float, BoxCorners]], names: Sequence[str] = ()
) -> tuple[SolidEntry, ...]:
    """An entry for each solid, of which volumes and boxes are known; faces of copies are looked at once."""
    known: dict[ShapeKey, tuple[dict[str, int], float]] = {}
    entries: list[SolidEntry] = []
    for solid, (volume, (low, high)), name in zip(solids, figures, names or [""] * len(solids), strict=True):
        key = ShapeKey(solid.Located(TopLoc_Location()))
        if key not in known:
            kinds = Counter(
                BRepAdaptor_Surface(face, False).GetType().name.removeprefix("GeomAbs_").lower()
                for face in faces_of(solid)
            )
            known[key] = dict(kinds.most_common()), float(BRep_Tool.MaxTolerance_s(solid, TopAbs_EDGE))
        x, y, z = np.subtract(high, low).tolist()
        entries.append(SolidEntry(len(entries) + 1, name, (x, y, z), volume, *known[key]))
    return tuple(entries)


def describe_solids(entries: Sequence[SolidEntry]) -> str:
    """The titles of the entries in a line."""
    more = f"; and {len(entries) - MAX_LISTED} more" if len(entries) > MAX_LISTED else ""
    return "; ".join(entry.title for entry in entries[:MAX_LISTED]) + more


def list_in_lines(entries: Sequence[SolidEntry]) -> list[str]:
    """The entries in lines, each whole."""
    more = [f"and {len(entries) - MAX_LISTED} more"] if len(entries) > MAX_LISTED else []
    return [*map(str, entries[:MAX_LISTED]), *more]


def tabulate_solids(file: str, entries: Sequence[SolidEntry]) -> str:
    """The solids of a file as a table for notebooks."""
    head = ("solid", "name", "size, mm", "volume, mm3", "faces", "edges within, mm")
    rows = [
        (e.number, e.name, e.size, e.volume, ", ".join(f"{n} {kind}" for kind, n in e.faces.items()), e.edge_tolerance)
        for e in entries
    ]
    return format_html_table(file, rows, head)


def title_solids(entries: Sequence[SolidEntry]) -> dict[int, str]:
    """A name of each solid by its number, no two alike: the last part of its name, with the number if others share it."""
    lasts = {entry.number: entry.name.rpartition("/")[2] or "solid" for entry in entries}
    shared = Counter(lasts.values())
    return {
        number: f"{last} {number}" if shared[last] > 1 or last == "solid" else last for number, last in lasts.items()
    }
