"""Beam lattices of 3MF files: beams, balls at their nodes, what clips them, and the triangles beside them, in millimetres."""

from __future__ import annotations

import contextlib
import locale
import os
import re
import zipfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.atomic_file import atomic_write
from tpmscad.errors import InvalidRequest, KernelError
from tpmscad.fields.data.edge_radii import order_ends
from tpmscad.fields.data.threemf_files import BALLS, BEAMS, MODEL_PATH, PlacedObject, parse_model, read_package

BEAM_ELEMENT = re.compile(rb"<(\w+:)?beam\s")
"""What the model of a file with beams has; others declare the namespace of beams, too."""

SIMILARITY_RTOL = 1e-5
"""Relative difference of a transform from a rotation times a factor: files hold few digits."""

READ_RTOL = 1e-5
"""Relative difference of what is read from what was written: lib3mf writes single precision."""

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


def is_beam_path(source: Any) -> bool:
    """Whether a source is the path of a 3MF file with beams."""
    if not isinstance(source, str | os.PathLike) or Path(source).suffix.lower() != ".3mf" or not Path(source).is_file():
        return False
    with contextlib.suppress(zipfile.BadZipFile), zipfile.ZipFile(source) as archive:
        parts = [name for name in archive.namelist() if name.lower().endswith(".model")]
        return any(BEAM_ELEMENT.search(archive.read(name)) for name in parts)
    return False


def read_beam_file(path: Path) -> BeamFile:
    """What the build of a 3MF file holds; InvalidRequest if it cannot be read, or has no beams."""
    if not path.is_file():
        raise InvalidRequest(f"there is no file {path}")
    try:
        package = read_package(path, (BEAMS, BALLS))
        lattices = [_read_lattice(path.name, placed) for placed in package.placed if placed.held.beams]
    except (KeyError, ValueError, IndexError) as error:
        raise InvalidRequest(
            f"{path.name} cannot be read as .3mf: it is damaged ({type(error).__name__}: {error}); save it again"
        ) from error
    if not lattices:
        raise InvalidRequest(
            f"{path.name} holds no beams in its build: {package.describe()}; fields.mesh reads triangles"
        )
    notes = list(package.notes)
    if flat := sum(lattice.flat for lattice in lattices):
        notes.append(f"{path.name}: {flat} ends of beams are flat there, and round here, with balls of the same radius")
    meshes = tuple(placed.triangles() for placed in package.placed if placed.held.triangles)
    return BeamFile(tuple(lattices), meshes, tuple(notes))


def _read_lattice(name: str, placed: PlacedObject) -> BeamLattice:
    """The beams of an object in millimetres; nodes in one place are one, and beams that are given twice."""
    held, given = placed.held, placed.held.lattice
    scale = float(np.cbrt(abs(np.linalg.det(placed.matrix))))
    if scale == 0 or np.abs(placed.matrix @ placed.matrix.T / scale**2 - np.eye(3)).max() > SIMILARITY_RTOL:
        raise InvalidRequest(
            f"{name} places beams by a transform {placed.matrix.tolist()} that changes lengths unequally, so that they would "
            "not stay round: apply it to the beams in the program that made them"
        )
    edges = np.array([(int(beam["v1"]), int(beam["v2"])) for beam in held.beams])
    radii = scale * np.array([_list_radii(beam, given) for beam in held.beams])
    cap = given.get("cap", "sphere")
    flat = sum(beam.get(end, cap) == "butt" for beam in held.beams for end in ("cap1", "cap2"))
    nodes, number = join_equal_points(held.arrays()[0])
    balls = np.zeros(len(nodes))
    # lib3mf writes the attributes of the extension for balls without its namespace
    mode, default = (
        given.get(f"{BALLS} {key}", given.get(key, other)) for key, other in (("ballmode", "none"), ("ballradius", "0"))
    )
    if mode == "all":
        balls[np.unique(number[edges])] = float(default)
    for ball in held.balls if mode in ("all", "mixed") else ():
        balls[number[int(ball["vindex"])]] = float(ball.get("r", default))
    edges, radii = order_ends(number[edges], radii)
    _, kept = np.unique(np.column_stack([edges, radii]), axis=0, return_index=True)
    kept = np.sort(kept[edges[kept, 0] != edges[kept, 1]])
    clipping = given.get("clippingmode", "none")
    return BeamLattice(
        placed.place(nodes),
        edges[kept],
        radii[kept],
        scale * balls,
        None if clipping == "none" else placed.triangles(placed.model.objects[given["clippingmesh"]]),
        clipping != "outside",
        flat,
    )


def _list_radii(beam: Mapping[str, str], lattice: Mapping[str, str]) -> tuple[float, float]:
    """The radii of a beam at both ends, in the unit of the file."""
    first = float(beam["r1"] if "r1" in beam else lattice["radius"])
    return first, float(beam.get("r2", first))


def join_equal_points(points: Array) -> tuple[Array, IntArray]:
    """The points (k, 3) that differ, in the order in which they come first, and the number of each of (n, 3) among them."""
    _, first, number = np.unique(points, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    return points[first[order]], np.argsort(order)[number.ravel()]


@contextlib.contextmanager
def keep_locale() -> Iterator[None]:
    """The locale of the process as it was: lib3mf 2.5 sets that of C while it writes, after which Python takes text for ASCII."""
    before = locale.setlocale(locale.LC_ALL)
    try:
        yield
    finally:
        locale.setlocale(locale.LC_ALL, before)


def write_beam_file(path: Path, lattice: BeamLattice, title: str) -> None:
    """Write beams as a beam lattice of a 3MF file, in millimetres, by lib3mf, in single precision.

    The file is read back by lib3mf, strictly, and compared before it gets its name.
    """
    lib3mf = import_module("lib3mf")  # which has no types, and takes time to load
    wrapper = lib3mf.Wrapper()
    model = wrapper.CreateModel()
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
    model.AddBuildItem(mesh, wrapper.GetIdentityTransform())
    with atomic_write(path) as aside, keep_locale():
        model.QueryWriter("3mf").WriteToFile(str(aside))
        reader = wrapper.CreateModel().QueryReader("3mf")
        reader.SetStrictModeActive(True)
        try:
            reader.ReadFromFile(str(aside))
        except lib3mf.ELib3MFException as error:
            raise KernelError("export", f"{path.name} is not valid 3MF: {error}") from error
        with zipfile.ZipFile(aside) as archive:
            (held,) = parse_model(archive.read(MODEL_PATH)).objects.values()
        found = [(int(beam["v1"]), int(beam["v2"])) for beam in held.beams]
        radii = np.array([_list_radii(beam, held.lattice) for beam in held.beams])
        if not np.array_equal(found, lattice.edges) or not np.allclose(radii, lattice.radii, rtol=READ_RTOL):
            raise KernelError("export", f"{path.name} reads back with other beams than were written")
