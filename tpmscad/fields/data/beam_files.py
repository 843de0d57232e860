"""Beam lattices of 3MF files: beams, balls at their nodes, what clips them, and the triangles beside them, in millimetres.

Files are read and written by lib3mf (3MF Beam Lattice Extension 1.2.0, with balls), which comes with build123d. Its coordinates
are in single precision: lengths of 40 mm are known to 2e-6 mm.
"""

from __future__ import annotations

import contextlib
import locale
import os
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.atomic_file import atomic_write
from tpmscad.errors import InvalidRequest, KernelError

BEAM_ELEMENT = b"beamlattice"
"""What the model of a file with beams has."""

MILLIMETRES = (1e-3, 1.0, 10.0, 25.4, 304.8, 1e3)
"""Of the units of lib3mf, in its order: micrometre, millimetre, centimetre, inch, foot, metre."""

MODEL_TYPES = (0, 1, 4)
"""Types of objects that are parts: other, model, surface; not supports."""

INSIDE, OUTSIDE = 1, 2
"""Modes of clipping: what is kept of the beams."""

ALL_BALLS, MIXED_BALLS = 2, 1
"""Modes of balls: at all nodes, and at those that are listed."""

BUTT = 2
"""The mode of caps that are flat."""

SIMILARITY_RTOL = 1e-5
"""Relative difference of a transform from a rotation times a factor: its twelve numbers are in single precision."""

Triangles = tuple[Array, IntArray]
"""Corners (k, 3) and triangles (m, 3)."""


@dataclass(frozen=True, slots=True, eq=False)
class BeamLattice:
    """Beams (m, 2) between points (n, 3), with radii (m, 2) at their ends, and balls (n,) at the points, 0 for none.

    clipping: a closed mesh within which the beams are kept if `keeps_inside`, or outside of which. flat: how many ends of beams
    are flat.
    """

    points: Array
    edges: IntArray
    radii: Array
    balls: Array
    clipping: Triangles | None = None
    keeps_inside: bool = True
    flat: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class BeamFile:
    """The beam lattices that a file's build holds, the triangles of its other objects, and notes."""

    lattices: tuple[BeamLattice, ...]
    meshes: tuple[Triangles, ...]
    notes: tuple[str, ...]


def load_lib3mf() -> Any:
    """The module lib3mf, which has no types, and takes time to load."""
    return import_module("lib3mf")


@contextlib.contextmanager
def keep_locale() -> Iterator[None]:
    """The locale of the process as it was: lib3mf 2.5 sets that of C while it writes, after which Python takes text for ASCII."""
    before = locale.setlocale(locale.LC_ALL)
    try:
        yield
    finally:
        locale.setlocale(locale.LC_ALL, before)


def is_beam_path(source: Any) -> bool:
    """Whether a source is the path of a 3MF file with beams."""
    if not isinstance(source, str | os.PathLike) or Path(source).suffix.lower() != ".3mf" or not Path(source).is_file():
        return False
    with contextlib.suppress(zipfile.BadZipFile), zipfile.ZipFile(source) as archive:
        parts = [name for name in archive.namelist() if name.lower().endswith(".model")]
        return any(BEAM_ELEMENT in archive.read(name) for name in parts)
    return False


def read_beam_file(path: Path) -> BeamFile:
    """What the build of a 3MF file holds; InvalidRequest if it cannot be read, or has no beams."""
    lib3mf = load_lib3mf()
    if not path.is_file():
        raise InvalidRequest(f"there is no file {path}")
    model = lib3mf.Wrapper().CreateModel()
    reader = model.QueryReader("3mf")
    try:
        reader.ReadFromFile(str(path))
    except lib3mf.ELib3MFException as error:
        raise InvalidRequest(f"{path.name} cannot be read as .3mf: {error}; save it again") from error
    scale = MILLIMETRES[int(model.GetUnit())]
    meshes_by_id = {mesh.GetUniqueResourceID(): mesh for mesh in _list_meshes(model)}
    lattices: list[BeamLattice] = []
    meshes: list[Triangles] = []
    items = model.GetBuildItems()
    while items.MoveNext():
        item = items.GetCurrent()
        for mesh, placement in _expand(item.GetObjectResource(), _matrix(item.GetObjectTransform())):
            factor, turned, shift = _as_similarity(path.name, placement)

            def place(points: Array, turned: Array = turned, shift: Array = shift) -> Array:
                return scale * (points @ turned + shift)

            triangles = _triangles(mesh)
            if len(triangles[1]):
                flipped = triangles[1][:, ::-1] if np.linalg.det(turned) < 0 else triangles[1]
                meshes.append((place(triangles[0]), flipped))
            lattice = mesh.BeamLattice()
            if lattice.GetBeamCount():
                lattices.append(_read_lattice(lattice, meshes_by_id, place, triangles[0], scale * factor))
    if not lattices:
        raise InvalidRequest(f"{path.name} holds no beams in its build: read its triangles with fields.mesh")
    notes = []
    if scale != 1.0:
        notes.append(f"{path.name} is not in millimetres: converted by {scale:g}")
    if flat := sum(lattice.flat for lattice in lattices):
        notes.append(f"{path.name}: {flat} ends of beams are flat there, and round here, with balls of the same radius")
    return BeamFile(tuple(lattices), tuple(meshes), tuple(notes))


def _list_meshes(model: Any) -> Iterator[Any]:
    """The mesh objects of a model."""
    found = model.GetMeshObjects()
    while found.MoveNext():
        yield found.GetCurrentMeshObject()


def _expand(resource: Any, placement: Array) -> Iterator[tuple[Any, Array]]:
    """The mesh objects of an object, with their placements (4, 3): points @ placement[:3] + placement[3]."""
    if resource.GetType() not in MODEL_TYPES:
        return
    if resource.IsMeshObject():
        yield resource, placement
        return
    for number in range(resource.GetComponentCount()):
        component = resource.GetComponent(number)
        own = _matrix(component.GetTransform())
        inner = np.concatenate([own[:3] @ placement[:3], [own[3] @ placement[:3] + placement[3]]])
        yield from _expand(component.GetObjectResource(), inner)


def _matrix(transform: Any) -> Array:
    return np.array([list(row) for row in transform.Fields], float)


def _as_similarity(name: str, placement: Array) -> tuple[float, Array, Array]:
    """The factor of a placement, its matrix (3, 3) and its shift; InvalidRequest unless lengths change by one factor."""
    matrix = placement[:3]
    factor = float(np.cbrt(abs(np.linalg.det(matrix))))
    if factor == 0 or np.abs(matrix @ matrix.T / factor**2 - np.eye(3)).max() > SIMILARITY_RTOL:
        raise InvalidRequest(
            f"{name} places beams by a transform {matrix.tolist()} that changes lengths unequally, so that beams would not stay "
            "round: apply it to the beams in the program that made them"
        )
    return factor, matrix, placement[3]


def _triangles(mesh: Any) -> Triangles:
    points = np.array([list(v.Coordinates) for v in mesh.GetVertices()], float).reshape(-1, 3)
    return points, np.array([list(t.Indices) for t in mesh.GetTriangleIndices()], np.int64).reshape(-1, 3)


def _read_lattice(lattice: Any, meshes: dict[int, Any], place: Any, points: Array, scale: float) -> BeamLattice:
    """The beams of an object in millimetres; nodes in one place are one, and beams that are given twice."""
    beams = lattice.GetBeams()
    edges = np.array([list(beam.Indices) for beam in beams], np.int64)
    radii = scale * np.array([list(beam.Radii) for beam in beams])
    flat = sum(int(mode == BUTT) for beam in beams for mode in beam.CapModes)
    mode, default = lattice.GetBallOptions()
    balls = np.zeros(len(points))
    if int(mode) == ALL_BALLS:
        balls[np.unique(edges)] = default
    if int(mode) in (ALL_BALLS, MIXED_BALLS):
        for ball in lattice.GetBalls():
            balls[ball.Index] = ball.Radius
    nodes, number = join_equal_points(points)
    joined = np.zeros(len(nodes))
    np.maximum.at(joined, number, scale * balls)
    edges = number[edges]
    turned = edges[:, 0] > edges[:, 1]
    edges[turned], radii[turned] = edges[turned][:, ::-1], radii[turned][:, ::-1]
    _, kept = np.unique(np.column_stack([edges, radii]), axis=0, return_index=True)
    kept = np.sort(kept[edges[kept, 0] != edges[kept, 1]])
    clip, by = lattice.GetClipping()
    return BeamLattice(
        place(nodes),
        edges[kept],
        radii[kept],
        joined,
        None if not clip else (place(_triangles(meshes[by])[0]), _triangles(meshes[by])[1]),
        clip != OUTSIDE,
        flat,
    )


def join_equal_points(points: Array) -> tuple[Array, IntArray]:
    """The points (k, 3) that differ, in the order in which they come first, and the number of each of (n, 3) among them."""
    _, first, number = np.unique(points, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    return points[first[order]], np.argsort(order)[number.ravel()]


def write_beam_file(path: Path, lattice: BeamLattice, title: str) -> None:
    """Write beams as a beam lattice of a 3MF file, in millimetres; read back strictly and compared before it gets its name."""
    lib3mf = load_lib3mf()
    model = lib3mf.Wrapper().CreateModel()
    model.SetUnit(lib3mf.ModelUnit.MilliMeter)
    mesh = model.AddMeshObject()
    mesh.SetName(title)
    for point in lattice.points.tolist():
        mesh.AddVertex(lib3mf.Position(Coordinates=tuple(point)))
    beams = mesh.BeamLattice()
    lengths = np.linalg.norm(lattice.points[lattice.edges[:, 0]] - lattice.points[lattice.edges[:, 1]], axis=1)
    beams.SetMinLength(min(1e-4, 0.5 * float(lengths.min())))
    for (i, j), (first, last) in zip(lattice.edges.tolist(), lattice.radii.tolist(), strict=True):
        beams.AddBeam(lib3mf.Beam(Indices=(i, j), Radii=(first, last), CapModes=(0, 0)))
    shown = np.flatnonzero(lattice.balls)
    if len(shown):
        beams.SetBallOptions(lib3mf.BeamLatticeBallMode.Mixed, float(lattice.balls[shown].max()))
        for node in shown.tolist():
            beams.AddBall(lib3mf.Ball(Index=node, Radius=float(lattice.balls[node])))
    model.AddBuildItem(mesh, lib3mf.Wrapper().GetIdentityTransform())
    with atomic_write(path) as aside, keep_locale():
        model.QueryWriter("3mf").WriteToFile(str(aside))
        _require_same(aside, lattice, path.name)


def _require_same(path: Path, lattice: BeamLattice, name: str) -> None:
    """KernelError unless a file is valid by lib3mf's strict reader and holds the beams."""
    lib3mf = load_lib3mf()
    model = lib3mf.Wrapper().CreateModel()
    reader = model.QueryReader("3mf")
    reader.SetStrictModeActive(True)
    try:
        reader.ReadFromFile(str(path))
    except lib3mf.ELib3MFException as error:
        raise KernelError("export", f"{name} is not valid 3MF: {error}") from error
    (mesh,) = _list_meshes(model)
    found = mesh.BeamLattice().GetBeams()
    same = len(found) == len(lattice.edges) and np.array_equal([list(b.Indices) for b in found], lattice.edges)
    if not same or not np.allclose([list(b.Radii) for b in found], lattice.radii, rtol=1e-5):
        raise KernelError("export", f"{name} reads back with other beams than were written")
