"""Excerpts of STEP files: the whole file but for its faces, of which only some are kept.

A reader that takes the excerpt meets every kind of entity of the file in its own text: header, product, units, assembly,
solids, and the faces kept with all they stand on. Colours are left out.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.kernel.step.entity_table import EntityTable, template_marks

_COLOURS = ("STYLED_ITEM", "MECHANICAL_DESIGN_GEOMETRIC_PRESENTATION_REPRESENTATION")

_BELOW_SHELLS = re.compile(
    "ADVANCED_FACE|FACE_(OUTER_)?BOUND|EDGE_LOOP|ORIENTED_EDGE|EDGE_CURVE|VERTEX_POINT|CARTESIAN_POINT|DIRECTION|VECTOR|LINE|CIRCLE|"
    "ELLIPSE|B_SPLINE_.*|AXIS2_PLACEMENT_3D|PLANE|(CYLINDRICAL|CONICAL|SPHERICAL|TOROIDAL)_SURFACE"
)
"""Entities that are kept only where something kept refers to them."""


def write_excerpt(source: Path, table: EntityTable, faces: Array, target: Path) -> None:
    """Write the excerpt of a file, given its entities, that keeps the faces of the given entity numbers."""
    keywords = table.keywords()
    dropped = np.array([k in _COLOURS or _BELOW_SHELLS.fullmatch(k) is not None for k in keywords])
    is_shell = np.array([k == "CLOSED_SHELL" for k in keywords])
    kept = ~dropped[table.template]
    shells = np.flatnonzero(is_shell[table.template])
    shell_faces = {}
    for at in shells.tolist():
        listed = table.values[table.start[at] : table.start[at + 1]]
        shell_faces[at] = listed[np.isin(listed, faces)].astype(np.int64)
    fresh = np.setdiff1d(np.flatnonzero(kept), shells)
    fresh = np.concatenate([fresh, *(table.positions(own) for own in shell_faces.values())])
    while len(fresh):
        kept[fresh] = True
        referred = table.positions(np.unique(_references(table, fresh)))
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


def _references(table: EntityTable, positions: IntArray) -> Array:
    """Entity numbers that the entities at the given positions refer to."""
    found = [np.zeros(0)]
    template = table.template[positions]
    for i in np.unique(template).tolist():
        columns = [k for k, mark in enumerate(template_marks(table.templates[i])) if mark == "#"]
        found.append(table.values[table.start[positions[template == i]][:, None] + np.array(columns, np.int64)].ravel())
    return np.concatenate(found)
