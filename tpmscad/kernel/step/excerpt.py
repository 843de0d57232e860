"""Excerpts of STEP files: the whole file but for its faces, of which only some are kept.

A reader that takes the excerpt meets every kind of entity of the file in its own text: header, product, units, assembly,
solids, and the faces kept with all they stand on. Colours are left out.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from tpmscad._typing import Array, BoolArray
from tpmscad.kernel.step.entity_table import EntityTable
from tpmscad.kernel.step.text_check import template_marks

_COLOURS = ("STYLED_ITEM", "MECHANICAL_DESIGN_GEOMETRIC_PRESENTATION_REPRESENTATION")

_BELOW_SHELLS = re.compile(
    "ADVANCED_FACE|FACE_(OUTER_)?BOUND|EDGE_LOOP|ORIENTED_EDGE|EDGE_CURVE|VERTEX_POINT|CARTESIAN_POINT|DIRECTION|VECTOR|LINE|CIRCLE|"
    "ELLIPSE|B_SPLINE_.*|AXIS2_PLACEMENT_3D|PLANE|(CYLINDRICAL|CONICAL|SPHERICAL|TOROIDAL)_SURFACE"
)
"""Entities that are kept only where something kept refers to them."""


def write_excerpt(source: Path, table: EntityTable, faces: Array, target: Path) -> None:
    """Write the excerpt of a file, given its entities, that keeps the faces of the given entity numbers."""
    keyword = np.array(table.keywords())[table.template]
    shells = np.flatnonzero(keyword == "CLOSED_SHELL")
    dropped = [k for k in np.unique(keyword).tolist() if k in _COLOURS or _BELOW_SHELLS.fullmatch(k)]
    kept = ~np.isin(keyword, dropped)
    shell_faces = {}
    for at in shells.tolist():
        listed = table.values[table.start[at] : table.start[at + 1]]
        shell_faces[at] = listed[np.isin(listed, faces)].astype(np.int64)
    reference = _is_reference(table)
    fresh = np.setdiff1d(np.flatnonzero(kept), shells)
    fresh = np.concatenate([fresh, *(table.positions(own) for own in shell_faces.values())])
    while len(fresh):
        kept[fresh] = True
        count = table.start[fresh + 1] - table.start[fresh]
        index = np.repeat(table.start[fresh] - np.cumsum(count) + count, count) + np.arange(int(count.sum()))
        referred = table.positions(np.unique(table.values[index[reference[index]]]))
        fresh = referred[~kept[referred]]
    with source.open("rb") as file, target.open("wb") as out:
        out.write(table.frame[0])
        for at in np.flatnonzero(kept).tolist():
            if at in shell_faces:
                listed_text = ",".join(f"#{n}" for n in shell_faces[at].tolist())
                out.write(f"#{table.number[at]}=CLOSED_SHELL('',({listed_text}));\n".encode("ascii"))
            else:
                first, end = table.place[at].tolist()
                file.seek(first)
                out.write(file.read(end - first))
        out.write(table.frame[1])


def _is_reference(table: EntityTable) -> BoolArray:
    """Whether each value is a reference."""
    result = np.zeros(len(table.values), bool)
    for i, template in enumerate(table.templates):
        marks = template_marks(template)
        own = table.start[:-1][table.template == i]
        for k in (k for k, mark in enumerate(marks) if mark == "#"):
            result[own + k] = True
    return result
