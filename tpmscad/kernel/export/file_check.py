"""Checks of STEP files that were written from a boundary representation: each thing once.

The text is held against the boundary representation to the last bit (`tpmscad.kernel.step.text_check`). That the kernel reads
such text is shown on an excerpt of the same file with a face of each class, whose validity and area it confirms. A reader that
takes the excerpt meets every kind of entity of the file in its own text: header, product, units, assembly, solids, and the faces
kept with all they stand on. Colours are left out.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.brep.boundary_representation import Brep
from tpmscad.brep.carriers import Carrier
from tpmscad.errors import InvalidRequest, KernelError
from tpmscad.kernel.build.shell_nesting import ShellNesting
from tpmscad.kernel.measure.mass_properties import face_moments
from tpmscad.kernel.measure.shape_report import is_valid
from tpmscad.kernel.measure.validity import find_faces_to_check
from tpmscad.kernel.occt.construction import make_compound
from tpmscad.kernel.occt.convert import CONFUSION_TOLERANCE
from tpmscad.kernel.occt.exploration import faces_of
from tpmscad.kernel.step.entity_table import EntityTable, template_marks
from tpmscad.kernel.step.step_reader import read_step
from tpmscad.kernel.step.text_check import check_text
from tpmscad.rigid_motion import Motion
from tpmscad.splines.bspline import BSplineSurface

MAX_EXCERPT_FACES = 150
"""Faces of an excerpt besides one of each shell and of each kind of surface; the kernel reads them in a second."""

UNEVEN_EXCERPT_FACES = 30
"""Faces added to them: those with the most uneven control nets. The kernel bounds the speed of a surface by its
poles, and closes gaps between the ends of pcurves by that bound."""

MAX_PROJECTIONS = 10_000
"""Edges of a face times poles of its surface, of faces of which more than one on each surface is taken: the kernel, which is told
no pcurves, projects an edge on 2,375 poles in .2 s, and on 166 in 3 ms."""

SLOW_EXCERPT_FACES = 2
"""Faces with more projections that are taken nevertheless: one of eight edges on 2,375 poles takes the kernel 1.6 s."""

MAX_EXCERPT_EDGES = 300
"""Edges of a face that stands for its kind; the kernel compares the edges of a face pair by pair."""

AREA_RTOL = 1e-6
"""Relative difference allowed between areas of faces. They are integrals of square roots, not of polynomials: on patches of
degree 16 two rules differ by 2e-8. That the numbers in the file are those that were meant is compared bit by bit."""

MILLIMETRE = "millimetre"

_COLOURS = ("STYLED_ITEM", "MECHANICAL_DESIGN_GEOMETRIC_PRESENTATION_REPRESENTATION")

_BELOW_SHELLS = re.compile(
    "ADVANCED_FACE|FACE_(OUTER_)?BOUND|EDGE_LOOP|ORIENTED_EDGE|EDGE_CURVE|VERTEX_POINT|CARTESIAN_POINT|DIRECTION|VECTOR|LINE|CIRCLE|"
    "ELLIPSE|B_SPLINE_.*|AXIS2_PLACEMENT_3D|PLANE|(CYLINDRICAL|CONICAL|SPHERICAL|TOROIDAL)_SURFACE"
)
"""Entities that are kept only where something kept refers to them."""


def carries_gaps(brep: Brep) -> bool:
    """Whether edges are off their faces by more than half the kernel's confusion, so that they need tolerances of their own.

    The pcurves that the kernel finds for a file's edges are off, too.
    """
    return bool(brep.edges.deviation.max(initial=0.0) > 0.5 * CONFUSION_TOLERANCE)


def check_excerpt(path: Path, brep: Brep, nesting: ShellNesting, instances: Sequence[Motion] = ()) -> None:
    """KernelError unless the text holds what was meant and the kernel reads an excerpt of the file as valid faces."""
    table, numbers = check_text(path, brep, nesting, instances)
    chosen = choose_faces(brep, nesting)
    n_placements = math.prod(map(len, instances))
    with TemporaryDirectory() as folder:
        part = Path(folder) / "excerpt.step"
        write_excerpt(path, table, numbers[chosen], part)
        try:
            # a file states no tolerances of edges, which healing finds; it makes a shell of a solid that is open
            content = read_step(part, healed=carries_gaps(brep), require_solid=False)
        except InvalidRequest as error:
            raise KernelError("export_step", str(error)) from error
    faces = faces_of(content.shape)
    if set(content.units) != {MILLIMETRE} or len(faces) != n_placements * len(chosen):
        raise KernelError(
            "export_step",
            f"of {n_placements * len(chosen)} faces in mm the kernel reads {len(faces)} in {', '.join(content.units)}",
        )
    if not is_valid(make_compound(faces)):
        raise KernelError("export_step", "the kernel's check rejects a face of the file")
    area, meant = float(face_moments(faces)[:, 0].sum()), n_placements * float(nesting.moments.area[chosen].sum())
    if abs(area - meant) > AREA_RTOL * meant:
        raise KernelError("export_step", f"faces of area {meant:.12g} read back with area {area:.12g}")


def choose_faces(brep: Brep, nesting: ShellNesting) -> IntArray:
    """Faces for an excerpt, among them the simplest of each shell and each kind of face.

    Of those that the kernel has to check and reads fast, some are spread evenly, and some have the most uneven nets; of the
    others it takes those that it reads the fastest, on surfaces of their own.
    """
    checked = find_faces_to_check(brep)
    n_edges = np.diff(brep.faces.use_start[brep.faces.loop_start])
    n_poles = np.array([c.poles.size // 3 if isinstance(c, BSplineSurface) else 1 for c in brep.carriers])
    projections = (n_edges * n_poles[brep.faces.carrier])[checked]
    first = checked[projections <= MAX_PROJECTIONS]
    slow = checked[np.argsort(projections, kind="stable")][len(first) :]
    slow = slow[np.sort(np.unique(brep.faces.carrier[slow], return_index=True)[1])[:SLOW_EXCERPT_FACES]]
    some = first[np.linspace(0, len(first) - 1, min(len(first), MAX_EXCERPT_FACES)).astype(int)]
    unevenness = _measure_unevenness(brep.carriers)[brep.faces.carrier[first]]
    uneven = first[np.argsort(-unevenness, kind="stable")[:UNEVEN_EXCERPT_FACES]]
    _, carrier_kind = np.unique([_kind_of_carrier(c) for c in brep.carriers], return_inverse=True)
    n_loops = np.diff(brep.faces.loop_start)
    order = np.argsort(n_edges, kind="stable")
    kind = np.column_stack([carrier_kind[brep.faces.carrier], n_loops > 1])[order]
    _, of_kinds = np.unique(kind, axis=0, return_index=True)
    _, of_shells = np.unique(nesting.shell_of_face[order], return_index=True)
    simplest = order[of_kinds]
    return np.unique(
        np.concatenate([some, uneven, slow, simplest[n_edges[simplest] <= MAX_EXCERPT_EDGES], order[of_shells]])
    )


def _measure_unevenness(carriers: Sequence[Carrier]) -> Array:
    """The greatest step (n,) between neighbouring poles of each carrier over the median one; 1 without poles."""
    result = np.ones(len(carriers))
    shapes: dict[tuple[int, ...], list[int]] = {}
    for i, carrier in enumerate(carriers):
        if isinstance(carrier, BSplineSurface):
            shapes.setdefault(carrier.poles.shape, []).append(i)
    for alike in shapes.values():
        nets = np.stack([carriers[i].poles for i in alike])  # type: ignore[union-attr]
        steps = np.concatenate(
            [np.linalg.norm(np.diff(nets, axis=axis), axis=-1).reshape(len(alike), -1) for axis in (1, 2)], axis=1
        )
        result[alike] = steps.max(axis=1) / np.maximum(np.median(steps, axis=1), np.finfo(float).tiny)
    return result


def _kind_of_carrier(carrier: Carrier) -> str:
    """What the text of a carrier depends on: its type, and the degrees and the numbers of poles of a spline."""
    if isinstance(carrier, BSplineSurface):
        return f"spline {carrier.degree_u} {carrier.degree_v} {carrier.poles.shape}"
    return type(carrier).__name__


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
