"""Files by the end of their names: every format that the program writes, and those that bodies and fields are read from.

Help, errors, documentation and writers follow from these tables: a new format is one row here and the module of its writer.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from importlib import import_module
from types import MappingProxyType

STEP_SUFFIXES = (".step", ".stp")
EXACT_SUFFIXES = (*STEP_SUFFIXES, ".brep")
"""Solids as the kernel has them."""

_EXPORT = "tpmscad.kernel.export"

TRIANGLE_WRITERS: Mapping[str, str] = MappingProxyType(
    {
        ".stl": f"{_EXPORT}.stl_file:write_stl",
        ".3mf": f"{_EXPORT}.threemf_file:write_3mf",
        ".glb": f"{_EXPORT}.gltf_file:write_glb",
    }
)
"""Closed triangle meshes: writers of (parts, path, name)."""

LAYER_WRITERS: Mapping[str, str] = MappingProxyType(
    {
        ".svg": f"{_EXPORT}.layer_files:write_svg",
        ".cli": f"{_EXPORT}.layer_files:write_cli",
        ".3mf": f"{_EXPORT}.layer_files:write_sliced_3mf",
    }
)
"""Contours of layers: writers of (layers, path, name)."""

MESH_WRITERS: Mapping[str, str] = MappingProxyType(
    {
        ".msh": "tpmscad.meshing.msh_files:write_msh",
        ".inp": "tpmscad.meshing.inp_files:write_inp",
        ".vtu": "tpmscad.meshing.library_meshes:write_vtu",
        ".feb": "tpmscad.meshing.febio_files:write_feb",
    }
)
"""Volume meshes: writers of (mesh, path)."""

MESH_PROGRAMS: Mapping[str, str] = MappingProxyType(
    {".msh": "gmsh", ".inp": "Abaqus, CalculiX", ".vtu": "VTK", ".feb": "FEBio"}
)
"""The programs that read each volume mesh."""

MATERIAL_SUFFIXES = (".inp", ".csv")
"""Cards of homogenised materials."""

TRIANGLE_SUFFIXES = tuple(TRIANGLE_WRITERS)
MODEL_SUFFIXES = (*STEP_SUFFIXES, *TRIANGLE_SUFFIXES, ".brep")
DOMAIN_SUFFIXES = tuple(suffix for suffix in MODEL_SUFFIXES if suffix != ".stl")
"""Files of several named solids; an STL file holds one body."""

READ_TRIANGLE_SUFFIXES = (".stl", ".obj", ".ply", ".3mf")
"""Triangle meshes that bodies and fields are read from (`fields/data/mesh_files.py`)."""


def list_suffixes(suffixes: Iterable[str], last: str = "or") -> str:
    """The suffixes in words: ".svg, .cli or .3mf"; of .step and .stp the first."""
    *others, end = (suffix for suffix in suffixes if suffix != ".stp")
    return f"{', '.join(others)} {last} {end}" if others else end


def load_writer(writers: Mapping[str, str], suffix: str) -> Callable[..., None]:
    """The function that writes files of a suffix; its module is imported now."""
    module, name = writers[suffix].split(":")
    writer: Callable[..., None] = getattr(import_module(module), name)
    return writer
