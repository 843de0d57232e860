"""gmsh's model of a BREP file: its options, its periodic faces, and its nodes and elements as arrays.

gmsh holds one model of the whole process. A model of the caller stays as it is.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from tpmscad._lazy_import import import_extra
from tpmscad._typing import Array, IntArray
from tpmscad.errors import InvalidRequest, KernelError

MODEL_NAME = "tpmscad"

ON_PLANE = 1e-5
"""Model units: how exactly gmsh's kernel knows where a face is."""

GMSH_TETRAHEDRA = {1: 4, 2: 11}
GMSH_TRIANGLES = {1: 2, 2: 9}
"""gmsh's numbers of the elements of each order."""


@contextmanager
def open_model(brep_file: Path, options: Mapping[str, float]) -> Iterator[Any]:
    """Gmsh with the shape of a BREP file as its model and with the options; both are taken back at the end."""
    gmsh = import_extra("gmsh", "meshes of tetrahedra", "mesh")
    is_ours = not gmsh.isInitialized()
    if is_ours:
        gmsh.initialize(interruptible=False)
    former = None if is_ours else gmsh.model.getCurrent()
    options = {"General.Terminal": 0, "General.Verbosity": 1, **options}
    values = {name: gmsh.option.getNumber(name) for name in options}
    try:
        for name, value in options.items():
            gmsh.option.setNumber(name, value)
        gmsh.model.add(MODEL_NAME)
        gmsh.model.occ.importShapes(str(brep_file), format="brep")
        gmsh.model.occ.synchronize()
        yield gmsh
    finally:
        gmsh.model.remove()
        if is_ours:
            gmsh.finalize()
        else:
            for name, value in values.items():
                gmsh.option.setNumber(name, value)
            gmsh.model.setCurrent(former)


def check_faces(gmsh: Any, places: Array) -> list[int]:
    """Gmsh's faces in the order of `places`, (n, 3) means of each face's vertices; KernelError if they are not there."""
    tags = sorted(tag for _, tag in gmsh.model.getEntities(2))
    found = np.array([_corners(gmsh, tag).mean(axis=0) for tag in tags]).reshape(-1, 3)
    if len(found) != len(places) or np.abs(found - places).max(initial=0.0) > ON_PLANE:
        raise KernelError(
            "mesh", f"gmsh reads {len(found)} faces where the solid has {len(places)}, or in another order"
        )
    return tags


def _corners(gmsh: Any, face: int) -> Array:
    """The vertices (n, 3) of a face, each once."""
    vertices = {tag for _, tag in gmsh.model.getBoundary([(2, face)], combined=False, oriented=False, recursive=True)}
    return np.array([gmsh.model.getValue(0, tag, []) for tag in vertices]).reshape(-1, 3)


def match_sides(gmsh: Any, axis: int, low: float, high: float, reach: float) -> tuple[list[int], list[int]]:
    """Have the planar faces at one side of a box meshed like those at the other side; the faces at either side, pair by pair.

    Reach: distance up to which the curves that bound them may miss each other, model units; their vertices do not. Raises
    InvalidRequest if the sides have not the same faces.
    """
    shift = np.eye(3)[axis] * (high - low)
    near: dict[int, Array] = {}
    far: dict[int, Array] = {}
    for _, face in gmsh.model.getEntities(2):
        if gmsh.model.getType(2, face) != "Plane":
            continue
        centre = np.array(gmsh.model.occ.getCenterOfMass(2, face))
        across = np.append(_corners(gmsh, face)[:, axis], centre[axis])
        for side, level in ((near, low), (far, high)):
            if np.abs(across - level).max() < ON_PLANE:
                side[face] = centre
    pairs = [
        (face, other)
        for face, here in near.items()
        for other, there in far.items()
        if np.abs(there - here - shift).max() < reach and _have_same_boundary(gmsh, face, other, shift)
    ]
    if not len(pairs) == len(near) == len(far) == len({other for _, other in pairs}):
        raise InvalidRequest(
            f"periodic: the {len(near)} faces at one side along {'xyz'[axis]} are no copies of the {len(far)} at the other, to "
            f'within {reach:g}; mesh a solid that repeats in a box of whole periods, with its loose pieces (loose="keep"), or '
            "leave periodic out"
        )
    masters, slaves = [face for face, _ in pairs], [other for _, other in pairs]
    if pairs:
        affine = np.eye(4)
        affine[:3, 3] = shift
        try:
            gmsh.model.mesh.setPeriodic(2, slaves, masters, affine.ravel().tolist())
        except Exception as error:  # gmsh raises Exception itself
            raise KernelError("mesh", f"gmsh finds the sides along {'xyz'[axis]} unlike: {error}") from error
    return masters, slaves


def _have_same_boundary(gmsh: Any, face: int, other: int, shift: Array) -> bool:
    """Whether a face has as many edges as another, and its vertices have the other's for images."""
    counts = [len(gmsh.model.getBoundary([(2, f)], combined=False, oriented=False)) for f in (face, other)]
    ours, theirs = _corners(gmsh, face) + shift, _corners(gmsh, other)
    if len(ours) != len(theirs) or counts[0] != counts[1]:
        return False
    return bool(np.linalg.norm(ours[:, None] - theirs, axis=2).min(axis=1).max() < ON_PLANE)


def read_nodes(gmsh: Any) -> tuple[Array, IntArray]:
    """All nodes (n, 3), and the row of each node's number."""
    numbers, coordinates, _ = gmsh.model.mesh.getNodes()
    row = np.full(int(numbers.max(initial=0)) + 1, -1, np.int64)
    row[numbers.astype(np.int64)] = np.arange(len(numbers))
    return coordinates.reshape(-1, 3), row


def read_elements(gmsh: Any, tag: int, kind: int, row: IntArray) -> IntArray:
    """Nodes (m, k) of one entity's elements, in gmsh's order."""
    _, nodes = gmsh.model.mesh.getElementsByType(kind, tag)
    size = gmsh.model.mesh.getElementProperties(kind)[3]
    return np.asarray(row[nodes.astype(np.int64)].reshape(-1, size))
