"""3MF files: what their build places, in millimetres: triangles and beams.

3MF Core Specification 1.3, the components of the Production Extension 1.1, and the Beam Lattice Extension 1.2 with balls. An
extension that a file requires and that is not understood is refused, as the specification asks, with counts of what it holds.
"""

from __future__ import annotations

import posixpath
import re
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.errors import InvalidRequest

MILLIMETRES = {"millimeter": 1.0, "micron": 1e-3, "centimeter": 10.0, "meter": 1e3, "inch": 25.4, "foot": 304.8}
"""Units of 3MF files, in millimetres."""

SCHEMAS = "http://schemas.microsoft.com/3dmanufacturing/"
CORE, PRODUCTION = f"{SCHEMAS}core/2015/02", f"{SCHEMAS}production/2015/06"
BEAMS, BALLS = f"{SCHEMAS}beamlattice/2017/02", f"{SCHEMAS}beamlattice/balls/2020/07"
READ_EXTENSIONS = (CORE, PRODUCTION, f"{SCHEMAS}material/2015/02", f"{SCHEMAS}trianglesets/2021/07")
"""Namespaces of 3MF that are understood here, or change no triangles."""

SHAPE_EXTENSIONS = {
    BEAMS: ("beam lattice", "beam"),
    BALLS: ("beam lattice balls", "ball"),
    f"{SCHEMAS}slice/2015/07": ("slice", "slice"),
    f"{SCHEMAS}displacement/2022/07": ("displacement", "displacementmesh"),
    f"{SCHEMAS}volumetric/2022/01": ("volumetric", "volumedata"),
    f"{SCHEMAS}booleanoperations/2023/07": ("boolean operations", "boolean"),
    f"{SCHEMAS}securecontent/2019/04": ("secure content", "resourcedata"),
}
"""Extensions of the 3MF Consortium that hold shapes: their names, and the elements that are counted."""

MODEL_PATH = "3D/3dmodel.model"
"""Of the model in an archive, as a rule."""

NO_PART = ("support", "solidsupport")
"""Types of objects that are no part of what is made."""

MAX_NESTED_COMPONENTS = 64


@dataclass(slots=True)
class ThreemfObject:
    """An object of a 3MF file: its type, corners and triangles as numbers in a row, its components, and its beams.

    lattice: the attributes of its beam lattice; beams, balls: those of their elements.
    """

    type: str
    vertices: list[float] = field(default_factory=list)
    triangles: list[int] = field(default_factory=list)
    components: list[Mapping[str, str]] = field(default_factory=list)
    lattice: Mapping[str, str] = field(default_factory=dict)
    beams: list[Mapping[str, str]] = field(default_factory=list)
    balls: list[Mapping[str, str]] = field(default_factory=list)

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
            if namespace == BEAMS and name == "beam":
                own.beams.append(given)
            elif namespace == BEAMS and name == "beamlattice":
                own.lattice = given
            elif namespace == BALLS and name == "ball":
                own.balls.append(given)
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


@dataclass(frozen=True, slots=True, eq=False)
class PlacedObject:
    """An object of a model as the build places it: points @ matrix + shift, in millimetres."""

    held: ThreemfObject
    model: ThreemfModel
    matrix: Array
    shift: Array

    def place(self, points: Array) -> Array:
        """Points (k, 3) of the model in millimetres."""
        return points @ self.matrix + self.shift

    def triangles(self, of: ThreemfObject | None = None) -> tuple[Array, IntArray]:
        """Vertices (k, 3) and triangles (m, 3), outward if they are so in the file: of the object, or of one beside it."""
        points, triangles = (of or self.held).arrays()
        return self.place(points), triangles[:, ::-1] if np.linalg.det(self.matrix) < 0 else triangles


@dataclass(frozen=True, slots=True, eq=False)
class ThreemfPackage:
    """What the build of a file places; notes; how many items and objects there are, and what is not read of them, in words."""

    placed: tuple[PlacedObject, ...]
    notes: tuple[str, ...]
    counts: tuple[int, int]
    unread: tuple[str, ...]
    left: tuple[str, ...]

    def describe(self) -> str:
        """What the file holds, in words."""
        unread = f", and {'; '.join(self.unread)}, which are not read" if self.unread else ""
        return (
            f"{self.counts[0]} items of {self.counts[1]} objects{unread}{''.join(f'; {words}' for words in self.left)}"
        )


def read_package(file: Path, understood: Sequence[str]) -> ThreemfPackage:
    """What the build of a file places; InvalidRequest for an extension that it requires and that is not `understood`."""
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
            _require_understood(file.name, models[path], (*READ_EXTENSIONS, *understood))
        return models[path]

    built = find_model(root)
    placed: list[PlacedObject] = []
    left = {"support": 0, "not printable": 0}
    for item in built.items:
        path = item.get(f"{PRODUCTION} path", root).lower().strip("/")
        held = find_model(path).objects.get(item["objectid"])
        if item.get("printable") == "0":
            left["not printable"] += 1
        elif held is not None and held.type in NO_PART:
            left["support"] += 1
        else:
            placed += _expand(file.name, find_model, path, item, MILLIMETRES[built.unit], 0)
    told = tuple(f"{n} of its {len(built.items)} items, marked as {what}" for what, n in left.items() if n)
    notes = [f"{file.name}: {words}, left out" for words in told]
    shapes = {space: of for space, of in SHAPE_EXTENSIONS.items() if space not in understood}
    foreign = tuple(words for model in models.values() for words in _list_foreign_shapes(model, shapes))
    notes += [f"{file.name}: {words} are not read" for words in foreign]
    if built.unit != "millimeter":
        notes.insert(0, f"{file.name} is in the unit {built.unit}: converted to millimetres")
    counts = len(built.items), sum(len(model.objects) for model in models.values())
    return ThreemfPackage(tuple(placed), tuple(notes), counts, foreign, told)


def _find_root(parts: Mapping[str, bytes]) -> str:
    """The path of the model that the relations of the archive name."""
    for relation in re.findall(rb"<[^>]*Relationship\b[^>]*>", parts.get("_rels/.rels", b"")):
        target, kind = (
            re.search(rb"\b" + word + rb'\s*=\s*["\']([^"\']*)["\']', relation) for word in (b"Target", b"Type")
        )
        if target and kind and kind[1].endswith(b"/3dmodel"):
            return posixpath.normpath(target[1].decode()).lower().strip("/")
    return MODEL_PATH.lower()


def _require_understood(name: str, model: ThreemfModel, understood: Sequence[str]) -> None:
    """InvalidRequest if a model is in an unknown unit, or requires an extension that is not understood, with counts of that."""
    if model.unit not in MILLIMETRES:
        raise InvalidRequest(
            f"{name} is in the unit {model.unit!r}, which is none of {', '.join(MILLIMETRES)}: save it in one of them"
        )
    for prefix in model.required:
        namespace = model.namespaces.get(prefix)
        if namespace in understood:
            continue
        held = (
            _list_foreign_shapes(model, {namespace: SHAPE_EXTENSIONS.get(namespace, (namespace, ""))})
            if namespace
            else []
        )
        what = " and ".join(held) or f"nothing of the extension {namespace or prefix!r}"
        remedy = "read beams with fields.beams, or" if namespace in (BEAMS, BALLS) else "in the program that made it"
        raise InvalidRequest(
            f"{name} holds {what}, which it requires to be understood and which is not read as triangles: {remedy} save "
            "the shape as triangles alone"
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
) -> Iterator[PlacedObject]:
    """The object that an item or a component refers to, placed, and its components.

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
    yield PlacedObject(held, model, own * turn, shift)
    for component in held.components:
        below = component.get(f"{PRODUCTION} path", path).lower().strip("/")
        for inner in _expand(name, find_model, below, component, own, depth + 1):
            yield PlacedObject(inner.held, inner.model, inner.matrix @ turn, inner.shift @ turn + shift)
