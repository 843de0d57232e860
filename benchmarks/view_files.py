"""Files of parts for the view in 3-D of the guide (docs/static/viewer.js): scripts that call showPart with a packed mesh.

A page opened from a folder may load scripts, but no other files, so that the mesh is a base64 text within a script. The stream of
bytes, before gzip, holds for each part the coordinates x, y and z of its points, on a grid of GRID steps, as differences to the
point before (16 bits, low bytes first), and the corners of its triangles, counted down from the smallest index not used yet
(24 bits, 0 is that index itself). Points are numbered in the order of their first use, which keeps both small numbers.
"""

from __future__ import annotations

import base64
import gzip
import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import build123d as bd
import meshio
import numpy as np

from tpmscad.brep.triangles.closed_mesh import SolidMesh
from tpmscad.kernel.export.solid_mesh import mesh_solids
from tpmscad.kernel.render.palette import DOMAIN_COLOURS, SURFACE_COLOUR, piece_colour
from tpmscad.kernel.render.picture import draw_scene
from tpmscad.kernel.render.scene import Scene

GRID = 2**14
"""Steps of the grid along the longest side of all parts."""

VIEW_BYTES = 480_000
"""Greatest size of a file."""

VIEW_DEVIATION, VIEW_ANGLE = 1.5e-3, np.radians(20.0)
"""Deviation of the meshes of views in diagonals of the part, and the turn between facets; more if a file is too large."""

RIM = 0.035
"""Width of the drawn sides of the triangles of a mesh, in mean sides."""

WITHIN_RIM = [[3, 4, 5], [0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4], [2, 0, 3], [2, 3, 5]]
"""A triangle 0, 1, 2 cut into its inner part 3, 4, 5 and the rim round it."""

COARSENING = 1.4
MAX_ANGLE = np.radians(80.0)


@dataclass(frozen=True)
class ViewPart:
    """A named and coloured mesh: points (n, 3), triangles (m, 3), and the group (m,) within which each is shaded smoothly.

    With `edges` each triangle is flat, and its sides are drawn.
    """

    name: str
    colour: tuple[float, float, float]
    points: np.ndarray
    triangles: np.ndarray
    group: np.ndarray
    edges: bool = False


def split_groups(part: ViewPart) -> tuple[np.ndarray, np.ndarray]:
    """Points (k, 3), one for each group that uses a point, in the order of first use, and the triangles (m, 3) on them."""
    uses = np.column_stack([part.triangles.ravel(), np.repeat(part.group, 3)])
    _, first, own = np.unique(uses, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return part.points[uses[first[order], 0]], rank[own.ravel()].reshape(-1, 3)


def pack_bytes(values: np.ndarray, width: int) -> bytes:
    """Whole numbers (n,), each of `width` bytes: the low bytes of all, then the next ones."""
    return values.astype("<u4").view(np.uint8).reshape(-1, 4)[:, :width].T.tobytes()


def pack_parts(parts: Sequence[ViewPart]) -> dict[str, Any]:
    """The model that showPart takes."""
    corners = np.concatenate([part.points for part in parts])
    low = corners.min(axis=0)
    step = float((corners.max(axis=0) - low).max()) / (GRID - 1)
    heads, stream = [], b""
    for part in parts:
        points, triangles = split_groups(part)
        steps = np.rint((points - low) / step).astype(np.int64)
        for axis in range(3):
            stream += pack_bytes(np.diff(steps[:, axis], prepend=0) & 0xFFFF, 2)
        flat = triangles.ravel()
        highest = np.maximum.accumulate(flat)
        fresh = np.concatenate([[0], highest[:-1] + 1])  # the smallest index that no corner before has used
        stream += pack_bytes(fresh - flat, 3)
        colour = [round(value, 3) for value in part.colour]
        head = {"name": part.name, "colour": colour, "vertices": len(points), "triangles": len(triangles)}
        heads.append(head | ({"edges": True} if part.edges else {}))
    data = base64.b64encode(gzip.compress(stream, 9, mtime=0)).decode()
    return {"low": np.round(low, 6).tolist(), "step": step, "parts": heads, "data": data}


def format_view(name: str, parts: Sequence[ViewPart]) -> str:
    """The text of the script."""
    return f"showPart({json.dumps(name)}, {json.dumps(pack_parts(parts))});\n"


def smooth_group(face: bd.Face) -> str:
    """The faces within which normals are averaged: all patches, all faces in one plane, all quadrics of one kind."""
    if face.geom_type != bd.GeomType.PLANE:
        return str(face.geom_type.name)
    normal = face.normal_at()
    place = np.round([*normal, normal.dot(face.center())], 3) + 0.0  # no -0
    return f"PLANE {place.tolist()}"


def mesh_shape(shape: bd.Shape, names: Sequence[str], deviation: float, angle: float) -> list[ViewPart]:
    """The solids of a shape as parts with these names."""
    parts = []
    solids = shape.solids()
    for i, (solid, mesh) in enumerate(zip(solids, mesh_solids(shape.wrapped, deviation, angle), strict=True)):
        groups = np.unique([smooth_group(face) for face in solid.faces()], return_inverse=True)[1]
        colour = SURFACE_COLOUR if len(solids) == 1 else DOMAIN_COLOURS.get(names[i], piece_colour("", i))
        parts.append(ViewPart(names[i], colour, mesh.points, mesh.triangles, groups[mesh.face]))
    return parts


def read_solids(files: Sequence[Path], title: str) -> tuple[bd.Compound, list[str]]:
    """All solids of STEP files and their names: those of several files without the title, else their labels."""
    solids: list[bd.Solid] = []
    names: list[str] = []
    for file in files:
        read = bd.import_step(file)
        own = read.solids()
        labels = [child.label for child in read.children] if len(read.children) == len(own) else [""] * len(own)
        if len(files) > 1:
            labels = [file.stem.removeprefix(title).replace("_", " ").strip()] * len(own)
        names += [label.replace("_", " ") or "part" for label in labels]  # build123d reads blanks as underscores
        solids += own
    return bd.Compound(solids), names


def read_facets(path: Path) -> ViewPart:
    """The triangles on the boundary of a volume mesh in a file of gmsh, by the corners of those of second order."""
    found = meshio.read(path)
    triangles = np.concatenate([block.data[:, :3] for block in found.cells if block.type.startswith("triangle")])
    used, numbers = np.unique(triangles, return_inverse=True)
    triangles = numbers.reshape(-1, 3)
    return ViewPart("mesh", SURFACE_COLOUR, found.points[used], triangles, np.zeros(len(triangles), int), edges=True)


def draw_facets(part: ViewPart) -> bytes:
    """The bytes of a PNG picture of a mesh, each triangle flat within a darker rim."""
    corners = part.points[part.triangles]
    opposite = np.linalg.norm(np.roll(corners, -1, axis=1) - np.roll(corners, 1, axis=1), axis=2)
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inner_radius = np.linalg.norm(across, axis=1) / opposite.sum(axis=1)
    middle = np.einsum("mk,mkd->md", opposite, corners) / opposite.sum(axis=1, keepdims=True)
    rim = np.minimum(RIM * opposite.mean() / inner_radius, 1.0)[:, None, None]
    inner = corners + rim * (middle[:, None] - corners)
    first = 6 * np.arange(len(corners))[:, None, None]
    triangles = (np.array(WITHIN_RIM) + first).reshape(-1, 3)
    face = 2 * np.arange(len(corners))[:, None] + [0, 1, 1, 1, 1, 1, 1]
    mesh = SolidMesh(np.concatenate([corners, inner], axis=1).reshape(-1, 3), triangles, face.ravel())
    dark = tuple(0.35 * value for value in part.colour)
    return draw_scene(Scene.of_mesh(mesh, [part.colour, dark] * len(corners), part.colour), size=(1280, 960))


def write_view(files: Iterable[Path], target: Path) -> None:
    """The solids of STEP files, with sharp edges round planes and quadrics, or a mesh, as a script of at most VIEW_BYTES."""
    files = sorted(files)
    if files[0].suffix == ".msh":
        text = format_view(target.stem, [read_facets(files[0])])
        print(f"{target.name}: {len(text) / 1e3:.0f} kB", flush=True)
        target.write_text(text)
        return
    shape, names = read_solids(files, target.stem)
    deviation, angle = VIEW_DEVIATION * shape.bounding_box().diagonal, VIEW_ANGLE
    while True:
        text = format_view(target.stem, mesh_shape(shape, names, deviation, angle))
        print(f"{target.name}: {len(text) / 1e3:.0f} kB, deviation {deviation:.3g} mm", flush=True)
        if len(text) <= VIEW_BYTES:
            target.write_text(text)
            return
        if angle >= MAX_ANGLE:
            print(f"{target.name}: too many faces for a view", flush=True)
            return
        deviation, angle = COARSENING * deviation, min(COARSENING * angle, MAX_ANGLE)
