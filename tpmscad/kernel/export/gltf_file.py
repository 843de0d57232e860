"""Binary glTF 2.0 (GLB): one node for each part, with a coloured primitive for each group of its faces.

glTF is in metres with y up. The points are stored in millimetres with z up; the root node scales them by 1/1000 and
turns them by -90 degrees about x, so that a viewer shows the part in its true size. Normals are averaged over the triangles of
each group; edges between groups stay sharp.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tpmscad._typing import Array, Colour, IntArray
from tpmscad.atomic_file import atomic_write
from tpmscad.brep.triangles.closed_mesh import point_normals
from tpmscad.kernel.export.mesh_parts import MeshPart, check_read_meshes

MAGIC, JSON_CHUNK, BINARY_CHUNK = 0x46546C67, 0x4E4F534A, 0x004E4942
FLOAT, UNSIGNED_INT, ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER = 5126, 5125, 34962, 34963
METRES_PER_MILLIMETRE = 0.001
Z_TO_Y_UP = [-(0.5**0.5), 0.0, 0.0, 0.5**0.5]
"""Quaternion of the rotation by -90 degrees about x."""

ROUGHNESS = 0.6


class _Buffers:
    """Growing binary buffer with its views and accessors."""

    def __init__(self) -> None:
        self.content = bytearray()
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []

    def add(self, values: Array | IntArray, kind: str, target: int) -> int:
        """Add an array of vectors or indices and return the number of its accessor."""
        component = FLOAT if kind == "VEC3" else UNSIGNED_INT
        data = np.ascontiguousarray(values, "<f4" if component == FLOAT else "<u4")
        view = {"buffer": 0, "byteOffset": len(self.content), "byteLength": data.nbytes, "target": target}
        self.content += data.tobytes()
        self.views.append(view)
        accessor = {"bufferView": len(self.views) - 1, "componentType": component, "count": len(data), "type": kind}
        if kind == "VEC3":
            accessor |= {"min": data.min(axis=0).tolist(), "max": data.max(axis=0).tolist()}
        self.accessors.append(accessor)
        return len(self.accessors) - 1


def write_glb(parts: Sequence[MeshPart], path: Path, title: str) -> None:
    """Write the meshes as named nodes under one root; the file is read back and checked before it gets its name."""
    with atomic_write(path) as aside:
        aside.write_bytes(format_glb(parts, title))
        check_read_meshes(read_glb(aside), parts, path)


def format_glb(parts: Sequence[MeshPart], title: str) -> bytes:
    """The bytes of the file."""
    buffers, materials, meshes = _Buffers(), dict[tuple[str, Colour], int](), []
    for part in parts:
        primitives = []
        for number, key in enumerate(part.groups):
            used, own = np.unique(part.mesh.triangles[part.group == number], return_inverse=True)
            if len(used) == 0:
                continue
            points, corners = part.mesh.points[used], own.reshape(-1, 3)
            primitives.append(
                {
                    "attributes": {
                        "POSITION": buffers.add(points, "VEC3", ARRAY_BUFFER),
                        "NORMAL": buffers.add(point_normals(points, corners), "VEC3", ARRAY_BUFFER),
                    },
                    "indices": buffers.add(corners.ravel(), "SCALAR", ELEMENT_ARRAY_BUFFER),
                    "material": materials.setdefault(key, len(materials)),
                }
            )
        meshes.append({"name": part.name, "primitives": primitives})
    children = [{"name": part.name, "mesh": i} for i, part in enumerate(parts)]
    root = {
        "name": title,
        "rotation": Z_TO_Y_UP,
        "scale": [METRES_PER_MILLIMETRE] * 3,
        "children": list(range(1, len(parts) + 1)),
    }
    document = {
        "asset": {"version": "2.0", "generator": "tpmscad"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [root, *children],
        "meshes": meshes,
        "materials": [_describe_material(label, colour) for label, colour in materials],
        "buffers": [{"byteLength": len(buffers.content)}],
        "bufferViews": buffers.views,
        "accessors": buffers.accessors,
    }
    text = json.dumps(document, separators=(",", ":")).encode()
    chunks = ((JSON_CHUNK, text + b" " * (-len(text) % 4)), (BINARY_CHUNK, bytes(buffers.content)))
    body = b"".join(struct.pack("<II", len(data), kind) + data for kind, data in chunks)
    return struct.pack("<III", MAGIC, 2, 12 + len(body)) + body


def _describe_material(label: str, colour: Colour) -> dict[str, Any]:
    """A matt material; glTF colours are linear, ours are sRGB."""
    linear = [float(c) / 12.92 if c <= 0.04045 else float(((c + 0.055) / 1.055) ** 2.4) for c in colour]
    surface = {"baseColorFactor": [*linear, 1.0], "metallicFactor": 0.0, "roughnessFactor": ROUGHNESS}
    return {"name": label, "pbrMetallicRoughness": surface}


def read_glb(path: Path) -> list[tuple[Array, IntArray]]:
    """Points and triangles of every mesh of a file that `write_glb` wrote, in mm with z up; equal points are one."""
    content = path.read_bytes()
    length = struct.unpack_from("<I", content, 12)[0]
    document, start = json.loads(content[20 : 20 + length]), 28 + length

    def values(number: int) -> Array:
        accessor = document["accessors"][number]
        view = document["bufferViews"][accessor["bufferView"]]
        kind, width = ("<f4", 3) if accessor["type"] == "VEC3" else ("<u4", 1)
        found = np.frombuffer(content, kind, accessor["count"] * width, start + view["byteOffset"])
        return found.reshape(-1, width)

    found = []
    for mesh in document["meshes"]:
        corners = []
        for primitive in mesh["primitives"]:
            points = values(primitive["attributes"]["POSITION"])
            corners.append(points[values(primitive["indices"]).ravel()])
        points, index = np.unique(np.concatenate(corners), axis=0, return_inverse=True)
        found.append((points.astype(float), index.reshape(-1, 3).astype(np.int64)))
    return found
