"""Beam lattices of 3MF files, and struts along the edges of meshes, as fields."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.api.public_calls import validate_call
from tpmscad.api.shared_kinds import MESH, PATH
from tpmscad.errors import InvalidRequest
from tpmscad.fields.data.beam_files import join_equal_points, read_beam_file
from tpmscad.fields.data.mesh_files import read_mesh_file
from tpmscad.fields.data.triangle_mesh import close_mesh
from tpmscad.fields.field import Field, UnaryField
from tpmscad.fields.kinds.booleans import difference, intersection, union
from tpmscad.fields.kinds.strut_graphs import STRUT_DIAMETERS, StrutsField, build_struts, struts
from tpmscad.fields.kinds.triangle_meshes import interpolate_mesh
from tpmscad.fields.tape.tape_nodes import Node


@dataclass(frozen=True, slots=True, eq=False)
class BeamsField(UnaryField):
    """What a file makes of its beams and of the triangles beside them, as one field; `struts` are the beams without clipping."""

    struts: StrutsField
    notes: tuple[str, ...]

    @property
    def points(self) -> Array:
        """Nodes of the beams (n, 3), mm."""
        return self.struts.points

    @property
    def edges(self) -> IntArray:
        """The two nodes of each beam (m, 2)."""
        return self.struts.edges

    @property
    def diameters(self) -> Array:
        """The diameter of each beam at both ends (m, 2), mm."""
        return self.struts.diameters

    def trace(self, x: Node, y: Node, z: Node) -> Node:
        """The formula on the nodes of a tape."""
        return self.field.trace(x, y, z)

    def __repr__(self) -> str:
        return f"BeamsField({len(self.points)} nodes, {len(self.edges)} beams)"


@validate_call()
def beams(
    path: Annotated[str | Path, PATH, "A ``.3mf`` file with beams (Beam Lattice Extension)."],
) -> BeamsField:
    """Return the beam lattices of a 3MF file as a field: beams, balls at nodes, clipping, and the triangles beside them.

    Returns
    -------
    BeamsField
        Negative inside; in millimetres, placed as the build of the file says. `points`, `edges` and `diameters` are those of all
        beams, `notes` tell what is not as in the file.

    Raises
    ------
    InvalidRequest
        If the file cannot be read or holds no beams, or places beams by a transform that does not leave them round.

    Notes
    -----
    Beams of two radii are cones that touch the balls at both ends; ends are round. Coordinates of 3MF files are read in single
    precision. Supports are left out, as are meshes that only represent beams.

    Examples
    --------
    >>> lattice = fields.beams("implant.3mf")  # doctest: +SKIP
    >>> tpmscad.infill_triangles(body, lattice, tol=0.01).write("implant.stl")  # doctest: +SKIP
    """
    path = Path(path)
    found = read_beam_file(path)
    free = [lattice for lattice in found.lattices if lattice.clipping is None]
    parts: list[Field] = [_join_lattices(free)] if free else []
    for number, lattice in enumerate(found.lattices, 1):
        if lattice.clipping is not None:
            clip = interpolate_mesh(close_mesh(f"the clipping mesh {number} of {path.name}", *lattice.clipping))
            kept = intersection if lattice.keeps_inside else difference
            parts.append(kept(_join_lattices([lattice]), clip))
    for number, (vertices, triangles) in enumerate(found.meshes, 1):
        parts.append(interpolate_mesh(close_mesh(f"the mesh {number} of {path.name}", vertices, triangles)))
    return BeamsField(union(*parts), _join_lattices(found.lattices), found.notes)


def _join_lattices(lattices: Any) -> StrutsField:
    """The beams of several lattices as one field."""
    first = np.cumsum([0, *(len(lattice.points) for lattice in lattices)])
    return build_struts(
        np.concatenate([lattice.points for lattice in lattices]),
        np.concatenate([lattice.edges + start for lattice, start in zip(lattices, first, strict=False)]),
        np.concatenate([lattice.radii for lattice in lattices]),
        np.concatenate([lattice.balls for lattice in lattices]),
    )


@validate_call()
def wireframe(
    source: Annotated[
        Any,
        MESH,
        "The path of an ``.obj``, ``.stl``, ``.ply`` or ``.3mf`` file; or an object with arrays `vertices` (k, 3) and `faces`, "
        "sequences of vertex numbers of any length.",
    ],
    diameter: Annotated[
        float | Any,
        STRUT_DIAMETERS,
        "Diameter of all struts, or one for each edge, as `fields.struts` takes it, model units.",
    ],
) -> StrutsField:
    """Return round struts along the edges of a mesh of triangles or polygons.

    Returns
    -------
    StrutsField
        The signed distance; edges that two polygons share are one strut, and vertices in one place one node.

    Raises
    ------
    InvalidRequest
        If the mesh cannot be read or has no polygons.

    Examples
    --------
    >>> from types import SimpleNamespace
    >>> square = SimpleNamespace(vertices=[[0, 0, 0], [9, 0, 0], [9, 9, 0], [0, 9, 0]], faces=[[0, 1, 2, 3]])
    >>> len(fields.wireframe(square, 1.0).edges)
    4
    """
    vertices, polygons = _read_polygons(source)
    nodes, number = join_equal_points(vertices)
    loops = [number[list(polygon)] for polygon in polygons]
    edges = np.concatenate([np.column_stack([loop, np.roll(loop, -1)]) for loop in loops])
    edges = np.unique(np.sort(edges[edges[:, 0] != edges[:, 1]], axis=1), axis=0)
    return struts(nodes, edges, diameter)


def _read_polygons(source: Any) -> tuple[Array, Sequence[Sequence[int]]]:
    """Vertices (k, 3) and polygons of a mesh; InvalidRequest if it has none, or a polygon names no vertex."""
    if hasattr(source, "vertices") and hasattr(source, "faces"):
        name, vertices, polygons = "the mesh", np.asarray(source.vertices, float), [list(face) for face in source.faces]
    elif not isinstance(source, str | Path):
        raise InvalidRequest(
            f"{type(source).__name__} is no mesh: give the path of a file, or an object with `vertices` (k, 3) and `faces`"
        )
    elif Path(source).suffix.lower() == ".obj" and Path(source).is_file():
        name, vertices, polygons = Path(source).name, *_read_obj(Path(source))
    else:
        name, vertices, triangles, _ = read_mesh_file(Path(source))
        polygons = triangles.tolist()
    if not polygons:
        raise InvalidRequest(f"{name} has no polygons, along whose edges struts would lie")
    numbers = [number for polygon in polygons for number in polygon]
    if not 0 <= min(numbers) <= max(numbers) < len(vertices):
        wrong = next(number for number in numbers if not 0 <= number < len(vertices))
        raise InvalidRequest(f"{name} has a polygon with vertex {wrong}: its {len(vertices)} are numbered from 0")
    return vertices, polygons


def _read_obj(file: Path) -> tuple[Array, list[list[int]]]:
    """Vertices and polygons of an OBJ file, whose polygons stay whole."""
    vertices: list[list[float]] = []
    polygons: list[list[int]] = []
    for line in file.read_text("utf-8", "replace").splitlines():
        word, *values = line.split() or [""]
        if word == "v":
            vertices.append([float(value) for value in values[:3]])
        elif word == "f":
            numbers = [int(value.split("/")[0]) for value in values]
            polygons.append([number - 1 if number > 0 else len(vertices) + number for number in numbers])
    return np.array(vertices, float).reshape(-1, 3), polygons
