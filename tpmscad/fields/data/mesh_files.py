"""Triangles of files, STL, OBJ, PLY and 3MF, in millimetres, and what else the files hold.

A file is read as it is meant, or refused: with the counts of what it holds and of what it states, or of what is not read. 3MF is
read by `threemf_files`, the other formats by trimesh, which comes with the extra `tpmscad[triangles]`.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np

from tpmscad._lazy_import import import_extra
from tpmscad._typing import Array, IntArray
from tpmscad.errors import InvalidRequest
from tpmscad.fields.data.threemf_files import read_package

BINARY_STL_HEAD, BINARY_STL_TRIANGLE = 84, 50
"""Bytes of a binary STL file before its triangles, the last four of which state their number, and of each triangle."""

Contents = tuple[Array, IntArray, tuple[str, ...]]
"""Vertices (k, 3) in millimetres, triangles (m, 3), and notes."""


def read_mesh_file(file: Path) -> tuple[str, Array, IntArray, tuple[str, ...]]:
    """Name, vertices (k, 3), triangles (m, 3) and notes of a file; InvalidRequest if it is missing, or not read as meant."""
    suffix = file.suffix.lower()
    if suffix not in READERS:
        raise InvalidRequest(f"{file.name} is no mesh that can be read: choose one of {', '.join(READERS)}")
    if not file.is_file():
        raise InvalidRequest(f"there is no file {file}")
    try:
        return file.name, *READERS[suffix](file)
    except InvalidRequest:
        raise
    except Exception as error:  # of a library, on what it did not foresee
        raise InvalidRequest(
            f"{file.name} cannot be read as {suffix}: it is damaged, or of another format ({type(error).__name__}); save it again"
        ) from error


def _load_by_trimesh(file: Path) -> tuple[Array, IntArray]:
    trimesh = import_extra("trimesh", "files of triangles", "triangles")
    mesh = trimesh.load_scene(str(file), process=False).to_mesh()
    return np.asarray(mesh.vertices, float), np.asarray(mesh.faces, np.int64)


def read_stl(file: Path) -> Contents:
    """A binary STL file with as many triangles as it states, or one of text whose solids and facets all end."""
    size = file.stat().st_size
    with file.open("rb") as opened:
        head = opened.read(4096)
    stated = int.from_bytes(head[80:84], "little")
    if size != BINARY_STL_HEAD + BINARY_STL_TRIANGLE * stated:
        if head[:5].lower() != b"solid" or b"facet" not in head.lower():
            found = max(0, size - BINARY_STL_HEAD) // BINARY_STL_TRIANGLE
            raise InvalidRequest(
                f"{file.name} states {stated} triangles and holds {found} in {size} bytes: it was cut short or is damaged; save "
                "it again"
            )
        _check_text_stl(file)
    return *_load_by_trimesh(file), ()


def _check_text_stl(file: Path) -> None:
    """InvalidRequest if a solid or a facet of an STL file of text does not end."""
    text = file.read_bytes().lower()
    solids, ends, facets, vertices = (
        len(re.findall(rb"^[ \t]*" + word + rb"\b", text, re.MULTILINE))
        for word in (b"solid", b"endsolid", b"endfacet", b"vertex")
    )
    if solids != ends or vertices != 3 * facets:
        raise InvalidRequest(
            f"{file.name} begins {solids} solids and ends {ends}, with {facets} triangles and {vertices} corners: it was cut "
            "short or is damaged; save it again"
        )


def read_obj(file: Path) -> Contents:
    """The polygons of an OBJ file, all groups together."""
    words = re.findall(rb"^[ \t]*([A-Za-z]\w*)", file.read_bytes(), re.MULTILINE)
    count = {word: words.count(word.encode()) for word in ("f", "v", "l", "p", "curv", "curv2", "surf")}
    if surfaces := count["surf"]:
        raise InvalidRequest(
            f"{file.name} holds {surfaces} free-form surface{'s' if surfaces > 1 else ''} (surf), which are not read: save it as "
            "polygons, or as STEP"
        )
    if not count["f"]:
        raise InvalidRequest(f"{file.name} holds no triangles: {count['v']} vertices and no face (f) between them")
    left = [
        f"{count[word]} {what}" for word, what in (("l", "lines"), ("p", "points"), ("curv", "curves")) if count[word]
    ]
    notes = (f"{file.name}: its {' and '.join(left)} bound nothing and were left out",) if left else ()
    return *_load_by_trimesh(file), notes


def read_ply(file: Path) -> Contents:
    """The polygons of a PLY file."""
    data = file.read_bytes()
    head, _, body = data.partition(b"end_header")
    elements = re.findall(rb"^[ \t]*element[ \t]+(\S+)[ \t]+(\d+)", head, re.MULTILINE)
    count = {name.decode("utf-8", "replace"): int(n) for name, n in elements}
    others = [f"{n} of the element {name!r}" for name, n in count.items() if name not in ("vertex", "face") and n]
    if count.get("tristrips") or not count.get("face"):
        held = ", ".join([f"{count.get('vertex', 0)} vertices", f"{count.get('face', 0)} faces", *others])
        points = ": points with values are for fields.scattered" if not others else ""
        raise InvalidRequest(
            f"{file.name} holds no triangles in faces that can be read: {held}; save it as polygons{points}"
        )
    if b"ascii" in head[:200]:
        lines = sum(1 for line in body.splitlines()[1:] if line.strip())
        if lines < sum(count.values()):
            raise InvalidRequest(
                f"{file.name} states {sum(count.values())} vertices, faces and other elements and holds {lines} lines of "
                "them: it was cut short; save it again"
            )
    notes = (f"{file.name}: {' and '.join(others)} were left out, which bound nothing",) if others else ()
    return *_load_by_trimesh(file), notes


def read_3mf(file: Path) -> Contents:
    """The triangles that the build of a 3MF file makes of its objects; InvalidRequest if it requires what is not understood."""
    package = read_package(file, ())
    vertices, triangles, count = [], [], 0
    for placed in package.placed:
        points, own = placed.triangles()
        if len(own):
            vertices.append(points)
            triangles.append(own + count)
            count += len(points)
    if not triangles:
        raise InvalidRequest(f"{file.name} holds no triangles in its build: {package.describe()}")
    return np.concatenate(vertices), np.concatenate(triangles), package.notes


READERS: dict[str, Callable[[Path], Contents]] = {
    ".stl": read_stl,
    ".obj": read_obj,
    ".ply": read_ply,
    ".3mf": read_3mf,
}
"""The reader of each suffix."""
