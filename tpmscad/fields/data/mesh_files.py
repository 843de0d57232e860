"""Triangles of files, STL, OBJ, PLY and 3MF, in millimetres, and what else the files hold.

A file is read as it is meant, or refused: with the counts of what it holds and of what it states, or of what is not read. 3MF is
read here (3MF Core Specification 1.3, with the components of the Production Extension 1.1), the other formats by trimesh, which
comes with the extra `tpmscad[triangles]`.
"""

from __future__ import annotations

import posixpath
import re
import zipfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat

import numpy as np

from tpmscad._lazy_import import import_extra
from tpmscad._typing import Array, IntArray
from tpmscad.errors import InvalidRequest

MILLIMETRES = {"millimeter": 1.0, "micron": 1e-3, "centimeter": 10.0, "meter": 1e3, "inch": 25.4, "foot": 304.8}
"""Units of 3MF files, in millimetres."""

SCHEMAS = "http://schemas.microsoft.com/3dmanufacturing/"
CORE, PRODUCTION = f"{SCHEMAS}core/2015/02", f"{SCHEMAS}production/2015/06"
READ_EXTENSIONS = (CORE, PRODUCTION, f"{SCHEMAS}material/2015/02", f"{SCHEMAS}trianglesets/2021/07")
"""Namespaces of 3MF that are understood here, or change no triangles."""

SHAPE_EXTENSIONS = {
    f"{SCHEMAS}beamlattice/2017/02": ("beam lattice", "beam"),
    f"{SCHEMAS}beamlattice/balls/2020/07": ("beam lattice balls", "ball"),
    f"{SCHEMAS}slice/2015/07": ("slice", "slice"),
    f"{SCHEMAS}displacement/2022/07": ("displacement", "displacementmesh"),
    f"{SCHEMAS}volumetric/2022/01": ("volumetric", "volumedata"),
    f"{SCHEMAS}booleanoperations/2023/07": ("boolean operations", "boolean"),
    f"{SCHEMAS}securecontent/2019/04": ("secure content", "resourcedata"),
}
"""Extensions of the 3MF Consortium that hold shapes: their names, and the elements that are counted."""

NO_PART = ("support", "solidsupport")
"""Types of objects that are no part of what is made."""

MAX_NESTED_COMPONENTS = 64

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


@dataclass(slots=True)
class ThreemfObject:
    """An object of a 3MF file: its type, corners and triangles as numbers in a row, and its components."""

    type: str
    vertices: list[float] = field(default_factory=list)
    triangles: list[int] = field(default_factory=list)
    components: list[Mapping[str, str]] = field(default_factory=list)

    def arrays(self) -> tuple[Array, IntArray]:
        """Vertices (k, 3) in the unit of the file, and triangles (m, 3)."""
        return np.reshape(self.vertices, (-1, 3)), np.reshape(self.triangles, (-1, 3)).astype(np.int64)


@dataclass(slots=True)
class ThreemfModel:
    """A model part of a 3MF file: its unit, the items of its build, its objects, and the elements of other namespaces."""

    unit: str = "millimeter"
    required: tuple[str, ...] = ()
    namespaces: dict[str, str] = field(default_factory=dict)
    items: list[Mapping[str, str]] = field(default_factory=list)
    objects: dict[str, ThreemfObject] = field(default_factory=dict)
    foreign: dict[tuple[str, str], int] = field(default_factory=dict)


def parse_model(data: bytes) -> ThreemfModel:
    """A model part of a 3MF file from its XML."""
    model = ThreemfModel()
    own = ThreemfObject("")

    def begin(tag: str, given: dict[str, str]) -> None:
        nonlocal own
        namespace, _, name = tag.rpartition(" ")
        if namespace != CORE:
            model.foreign[namespace, name] = model.foreign.get((namespace, name), 0) + 1
        elif name == "vertex":
            own.vertices += (float(given["x"]), float(given["y"]), float(given["z"]))
        elif name == "triangle":
            own.triangles += (int(given["v1"]), int(given["v2"]), int(given["v3"]))
        elif name == "object":
            own = model.objects[given["id"]] = ThreemfObject(given.get("type", "model"))
        elif name == "component":
            own.components.append(given)
        elif name == "item":
            model.items.append(given)
        elif name == "model":
            model.unit = given.get("unit", "millimeter")
            model.required = tuple(given.get("requiredextensions", "").split())

    def declare(prefix: str | None, namespace: str) -> None:
        model.namespaces.setdefault(prefix or "", namespace)

    parser = expat.ParserCreate(namespace_separator=" ")
    parser.StartElementHandler, parser.StartNamespaceDeclHandler = begin, declare
    parser.Parse(data, True)
    return model


def read_3mf(file: Path) -> Contents:
    """What the build of a 3MF file makes of its objects; InvalidRequest if it requires an extension that is not understood."""
    try:
        with zipfile.ZipFile(file) as archive:
            parts = {
                name.lower().strip("/"): archive.read(name)
                for name in archive.namelist()
                if name.lower().endswith((".model", ".rels"))
            }
    except zipfile.BadZipFile as error:
        raise InvalidRequest(f"{file.name} cannot be read as .3mf: it is no archive; save it again") from error
    root = _find_root(parts)
    if root not in parts:
        raise InvalidRequest(f"{file.name} cannot be read as .3mf: it holds no model; save it again")
    models: dict[str, ThreemfModel] = {}

    def find_model(path: str) -> ThreemfModel:
        if path not in models:
            if path not in parts:
                raise InvalidRequest(f"{file.name} refers to the part {path!r}, which it does not hold: save it again")
            models[path] = parse_model(parts[path])
            _require_understood(file.name, models[path])
        return models[path]

    built = find_model(root)
    notes, vertices, triangles, count = [], [], [], 0
    left = {"support": 0, "not printable": 0}
    for item in built.items:
        path = item.get(f"{PRODUCTION} path", root).lower().strip("/")
        held = find_model(path).objects.get(item["objectid"])
        if item.get("printable") == "0":
            left["not printable"] += 1
        elif held is not None and held.type in NO_PART:
            left["support"] += 1
        else:
            for points, own in _expand(file.name, find_model, path, item, MILLIMETRES[built.unit], 0):
                vertices.append(points)
                triangles.append(own + count)
                count += len(points)
    told = [f"{n} of its {len(built.items)} items, marked as {what}" for what, n in left.items() if n]
    notes += [f"{file.name}: {words}, left out" for words in told]
    foreign = [words for model in models.values() for words in _list_foreign_shapes(model, SHAPE_EXTENSIONS)]
    notes += [f"{file.name}: {words} are not read" for words in foreign]
    if not triangles:
        held_objects = sum(len(model.objects) for model in models.values())
        beams = "; ".join(foreign)
        raise InvalidRequest(
            f"{file.name} holds no triangles in its build: {len(built.items)} items of {held_objects} objects"
            f"{f', and {beams}, which are not read' if beams else ''}{''.join(f'; {words}' for words in told)}"
        )
    if built.unit != "millimeter":
        notes.insert(0, f"{file.name} is in the unit {built.unit}: converted to millimetres")
    return np.concatenate(vertices), np.concatenate(triangles), tuple(notes)


def _find_root(parts: Mapping[str, bytes]) -> str:
    """The path of the model that the relations of the archive name."""
    for relation in re.findall(rb"<[^>]*Relationship\b[^>]*>", parts.get("_rels/.rels", b"")):
        target, kind = (
            re.search(rb"\b" + word + rb'\s*=\s*["\']([^"\']*)["\']', relation) for word in (b"Target", b"Type")
        )
        if target and kind and kind[1].endswith(b"/3dmodel"):
            return posixpath.normpath(target[1].decode()).lower().strip("/")
    return "3d/3dmodel.model"


def _require_understood(name: str, model: ThreemfModel) -> None:
    """InvalidRequest if a model is in an unknown unit, or requires an extension that is not understood, with counts of that."""
    if model.unit not in MILLIMETRES:
        raise InvalidRequest(
            f"{name} is in the unit {model.unit!r}, which is none of {', '.join(MILLIMETRES)}: save it in one of them"
        )
    for prefix in model.required:
        namespace = model.namespaces.get(prefix)
        if namespace in READ_EXTENSIONS:
            continue
        held = (
            _list_foreign_shapes(model, {namespace: SHAPE_EXTENSIONS.get(namespace, (namespace, ""))})
            if namespace
            else []
        )
        what = " and ".join(held) or f"nothing of the extension {namespace or prefix!r}"
        is_beams = namespace is not None and "beamlattice" in namespace
        remedy = "read beams with fields.beams, or" if is_beams else "in the program that made it"
        raise InvalidRequest(
            f"{name} holds {what}, which it requires to be understood and which is not read as triangles: {remedy} save the shape "
            "as triangles alone"
        )


def _list_foreign_shapes(model: ThreemfModel, extensions: Mapping[str, tuple[str, str]]) -> list[str]:
    """In words: how many elements of extensions a model holds; of one without a counted element, all."""
    found = []
    for namespace, (extension, element) in extensions.items():
        counts = {n: k for (space, n), k in model.foreign.items() if space == namespace and n in (element or n,)}
        if counts:
            listed = " and ".join(f"{k} {n}{'s' if k > 1 else ''}" for n, k in counts.items())
            found.append(f"{listed} of the {extension} extension")
    return found


def _expand(
    name: str,
    find_model: Callable[[str], ThreemfModel],
    path: str,
    reference: Mapping[str, str],
    scale: float,
    depth: int,
) -> Iterator[tuple[Array, IntArray]]:
    """Vertices and triangles of the object that an item or a component refers to, placed, and of its components.

    scale: millimetres of the lengths of the reference itself.
    """
    model = find_model(path)
    held = model.objects.get(reference["objectid"])
    if held is None:
        raise InvalidRequest(
            f"{name} refers to the object {reference['objectid']} of {path!r}, which it does not hold: save it again"
        )
    if depth > MAX_NESTED_COMPONENTS:
        raise InvalidRequest(f"{name}: the object {reference['objectid']} is among its own components; save it again")
    rows = np.array([float(number) for number in reference.get("transform", "1 0 0 0 1 0 0 0 1 0 0 0").split()])
    if len(rows) != 12 or not np.isfinite(rows).all():
        raise InvalidRequest(f"{name}: the transform {reference['transform']!r} is no twelve numbers; save it again")
    turn, shift = rows.reshape(4, 3)[:3], rows[9:] * scale
    own = MILLIMETRES[model.unit]
    points, triangles = held.arrays()
    parts = [(own * points, triangles)]
    for component in held.components:
        below = component.get(f"{PRODUCTION} path", path).lower().strip("/")
        parts += _expand(name, find_model, below, component, own, depth + 1)
    for points, triangles in parts:
        if len(triangles):
            yield points @ turn + shift, triangles[:, ::-1] if np.linalg.det(turn) < 0 else triangles


READERS: dict[str, Callable[[Path], Contents]] = {
    ".stl": read_stl,
    ".obj": read_obj,
    ".ply": read_ply,
    ".3mf": read_3mf,
}
"""The reader of each suffix."""
