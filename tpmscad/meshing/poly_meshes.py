"""OpenFOAM's polyMesh of each group of elements: points, faces, owners and neighbours of faces, patches, and zones of faces.

Every group is a region of its own. The faces between two regions are a patch of either, mapped to the other one. Periodic sides
are cyclic patches, whose faces are in the same order and begin at the same corner. Faces inside
a region are in upper triangular order; their normals point from the owner, of the lower number, to the neighbour. Elements have
flat faces between their corners, as OpenFOAM has no curved ones.

Source: OpenFOAM user guide, "Mesh description" (v1912).
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.errors import InvalidRequest
from tpmscad.meshing.element_shapes import SHAPES
from tpmscad.meshing.facet_search import find_rows, tabulate_faces
from tpmscad.meshing.mesh_arrays import MeshArrays

BETWEEN = " | "
"""Joins the names of two regions in the name of the patch between them."""

FACING_COSINE = 1.0 - 1e-9
"""Vector area of facets over their area from which they face along an axis."""

ENDS = "near", "far"

HEADER = """FoamFile
{{
    version     2.0;
    format      ascii;
    class       {kind};
    location    "{place}";
    object      {name};
}}
"""


@dataclass(frozen=True, slots=True)
class FoamPatch:
    """A patch: its name, the region on its other side or None, its first face and number of faces, and the side of an opening.

    side: the direction along an axis that a plane opening faces, such as "X+"; None of walls and of curved openings.
    image: the patch that repeats a cyclic one; None of others.
    """

    name: str
    other: str | None
    start: int
    count: int
    side: str | None
    image: str | None = None


@dataclass(frozen=True, slots=True, eq=False)
class PolyMesh:
    """The mesh of one region: points (n, 3), faces (m, k) with those inside first, owner (m,), neighbour (inside,), patches."""

    region: str
    points: Array
    faces: IntArray
    owner: IntArray
    neighbour: IntArray
    patches: tuple[FoamPatch, ...]

    def number_faces(self, names: Sequence[str]) -> IntArray:
        """The numbers of the faces of some patches."""
        found = [np.arange(p.start, p.start + p.count) for p in self.patches if p.name in names]
        return np.concatenate([np.zeros(0, np.int64), *found])


def name_for_foam(text: str) -> str:
    """A name as OpenFOAM takes it: "channel +: opening X-" becomes "channel_plus_opening_X_minus"."""
    spoken = text.replace("+", "_plus").replace("-", "_minus").replace(BETWEEN, "_to_")
    return re.sub(r"\W+", "_", spoken, flags=re.ASCII).replace("__", "_").strip("_")


def name_period(translation: str, end: str) -> str:
    """The name of the cyclic patch at one end of a translation: "period_x_near"."""
    return name_for_foam(f"period {translation} {end}")


def divide_regions(mesh: MeshArrays) -> list[PolyMesh]:
    """The mesh of each group of elements.

    Raises InvalidRequest if the mesh has several kinds of elements, or an element is not in one group.
    """
    if len(mesh.cells) != 1:
        raise InvalidRequest(f"a case of OpenFOAM is written from one kind of elements, not {' and '.join(mesh.cells)}")
    numbers = np.concatenate([np.zeros(0, np.int64), *mesh.cell_groups.values()])
    if not np.array_equal(np.sort(numbers), np.arange(mesh.n_cells)):
        raise InvalidRequest("every element has to be in one group, which becomes a region of OpenFOAM")
    return [_make_region(mesh, name) for name in mesh.cell_groups]


def _make_region(mesh: MeshArrays, region: str) -> PolyMesh:
    """The mesh of one group of elements."""
    ((kind, nodes),) = mesh.cells.items()
    face_kind = SHAPES[kind].face_kind
    n_corners = SHAPES[face_kind].corners
    table = tabulate_faces({kind: nodes[mesh.cell_groups[region]]})[face_kind]
    faces, element = table.nodes[:, :n_corners].copy(), table.owner[:, 0]
    _, which, count = np.unique(np.sort(faces, axis=1), axis=0, return_inverse=True, return_counts=True)
    by_face = np.argsort(which.ravel(), kind="stable")  # of two elements the one of the lower number first
    first = np.cumsum(count) - count
    inside = first[count == 2]
    owner, neighbour = element[by_face[inside]], element[by_face[inside + 1]]
    order = np.lexsort([neighbour, owner])
    rows, patches = [by_face[inside][order]], []
    start = len(inside)

    def add_patch(chosen: IntArray, name: str, **kind: str | None) -> None:
        nonlocal start
        rows.append(chosen)
        patches.append(
            FoamPatch(name_for_foam(name), kind.get("other"), start, len(chosen), kind.get("side"), kind.get("image"))
        )
        start += len(chosen)

    outer = by_face[first[count == 1]]
    groups, regions = [*mesh.facet_groups, "sides"], list(mesh.cell_groups)
    beyond = _find_regions_beyond(mesh, region, faces[outer])
    patch_of = np.where(beyond < 0, _find_groups(mesh, faces[outer]), len(groups) + beyond)
    for translation, (near, far, images) in _pair_faces(mesh, faces[outer]).items():
        patch_of[near] = patch_of[far] = -1
        faces[outer[far]] = images
        names = [name_period(translation, end) for end in ENDS]
        add_patch(outer[near], names[0], image=names[1])
        add_patch(outer[far], names[1], image=names[0])
    for number in np.unique(patch_of[patch_of >= 0]).tolist():
        chosen = outer[patch_of == number]
        chosen = chosen[np.argsort(element[chosen], kind="stable")]
        if number < len(groups):
            group = groups[number]
            side = _find_side(mesh.points[faces[chosen]]) if group in mesh.openings else None
            add_patch(chosen, group, side=side)
        else:
            other = regions[number - len(groups)]
            add_patch(chosen, f"{region}{BETWEEN}{other}", other=other)
    chosen = np.concatenate(rows)
    used, local = np.unique(faces[chosen], return_inverse=True)
    return PolyMesh(
        region,
        mesh.points[used],
        local.reshape(-1, n_corners),
        element[chosen],
        neighbour[order],
        tuple(patches),
    )


def _pair_faces(mesh: MeshArrays, faces: IntArray) -> dict[str, tuple[IntArray, IntArray, IntArray]]:
    """For each translation of a periodic mesh the rows of outer faces (m, k) at its near side, and those of their images.

    Then the corners of these, which are the images of the others, the other way round.
    """
    found = {}
    for translation, pairs in mesh.periodic.items():
        image = np.full(len(mesh.points), -1)
        image[pairs[:, 0]] = pairs[:, 1]
        near = np.flatnonzero((image[faces] >= 0).all(axis=1))
        moved = image[faces[near]]
        far = find_rows(np.sort(faces, axis=1), np.sort(moved, axis=1))
        is_face = far >= 0
        if is_face.any():
            reversed_corners = np.roll(moved[:, ::-1], 1, axis=1)
            found[translation] = near[is_face], far[is_face], reversed_corners[is_face]
    return found


def _find_regions_beyond(mesh: MeshArrays, region: str, faces: IntArray) -> IntArray:
    """The number of the group of elements on the other side of each outer face (m, k) of a region, -1 if there is none: (m,)."""
    ((kind, nodes),) = mesh.cells.items()
    found = np.full(len(faces), -1)
    for number, (name, cells) in enumerate(mesh.cell_groups.items()):
        if name != region:
            theirs = tabulate_faces({kind: nodes[cells]})[SHAPES[kind].face_kind].nodes[:, : faces.shape[1]]
            found[find_rows(np.sort(theirs, axis=1), np.sort(faces, axis=1)) >= 0] = number
    return found


def _find_side(corners: Array) -> str | None:
    """The direction along an axis that facets with corners (m, k, 3) face, from "X+" to "Z-"; None if they do not."""
    vectors = vector_areas(corners)
    total, area = vectors.sum(axis=0), np.linalg.norm(vectors, axis=1).sum()
    axis = int(np.abs(total).argmax())
    return "XYZ"[axis] + ("+" if total[axis] > 0 else "-") if abs(total[axis]) > FACING_COSINE * area else None


def vector_areas(corners: Array) -> Array:
    """Vector areas (m, 3) of triangles and quadrilaterals with corners (m, k, 3)."""
    diagonals = corners[:, 2] - corners[:, 0], corners[:, -1] - corners[:, 1]
    first = diagonals[0] if corners.shape[1] == 4 else corners[:, 1] - corners[:, 0]
    second = diagonals[1] if corners.shape[1] == 4 else diagonals[0]
    return np.asarray(0.5 * np.cross(first, second))


def _find_groups(mesh: MeshArrays, faces: IntArray) -> IntArray:
    """The number (m,) of the first group of facets that holds each face; the number of groups if none does."""
    ((kind, facets),) = mesh.facets.items()
    row = find_rows(np.sort(facets[:, : SHAPES[kind].corners], axis=1), np.sort(faces, axis=1))
    group_of = np.full(len(facets) + 1, len(mesh.facet_groups), np.int64)  # the last is that of faces in no group
    for number, rows in reversed(list(enumerate(mesh.facet_groups.values()))):
        group_of[rows] = number
    return group_of[row]


def write_poly_mesh(part: PolyMesh, folder: Path, zones: Mapping[str, IntArray]) -> None:
    """Write the mesh of a region to its folder "polyMesh", in the model's unit; `zones` are faces of the boundary by name."""
    folder.mkdir(parents=True)
    place = "/".join(folder.parts[-3:])
    points = part.points.tolist()
    _write_list(folder, place, "points", "vectorField", [f"({x!r} {y!r} {z!r})" for x, y, z in points])
    width = part.faces.shape[1]
    faces = [f"{width}({' '.join(map(str, face))})" for face in part.faces.tolist()]
    _write_list(folder, place, "faces", "faceList", faces)
    _write_list(folder, place, "owner", "labelList", [str(i) for i in part.owner.tolist()])
    _write_list(folder, place, "neighbour", "labelList", [str(i) for i in part.neighbour.tolist()])
    entries = [
        f"{patch.name} {{ {_patch_type(part, patch)} nFaces {patch.count}; startFace {patch.start}; }}"
        for patch in part.patches
    ]
    _write_list(folder, place, "boundary", "polyBoundaryMesh", entries)
    entries = [
        f"{name} {{ type faceZone; faceLabels List<label> {len(of)}({' '.join(map(str, of.tolist()))}); "
        f"flipMap List<bool> {len(of)}({' '.join(['false'] * len(of))}); }}"
        for name, of in zones.items()
    ]
    _write_list(folder, place, "faceZones", "regIOobject", entries)


def _patch_type(part: PolyMesh, patch: FoamPatch) -> str:
    """The type of a patch, and what it is joined to."""
    if patch.image:
        return f"type cyclic; neighbourPatch {patch.image};"
    if patch.other:
        other, theirs = name_for_foam(patch.other), name_for_foam(f"{patch.other}{BETWEEN}{part.region}")
        return f"type mappedWall; sampleMode nearestPatchFace; sampleRegion {other}; samplePatch {theirs};"
    return "type patch;" if patch.side else "type wall;"


def _write_list(folder: Path, place: str, name: str, kind: str, rows: list[str]) -> None:
    """One file of a list."""
    text = HEADER.format(kind=kind, place=place, name=name) + f"{len(rows)}\n(\n" + "\n".join(rows) + "\n)\n"
    (folder / name).write_text(text, encoding="ascii", newline="\n")
