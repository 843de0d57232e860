"""Exact triply periodic minimal surfaces and their nodal namesakes, in the unit cubic cell."""

from tpmscad.surfaces.differential_geometry import SurfaceJet
from tpmscad.surfaces.motion_group import PatchSymmetry, patch_symmetry
from tpmscad.surfaces.offset_volumes import (
    area,
    cell_measures,
    check_offset,
    offsets_for,
    skeletal_offset_for,
    skeletal_volume_fraction,
    thickness_for,
    volume_fraction,
)
from tpmscad.surfaces.reflection_group import MirrorSymmetry, has_mirrors, mirror_symmetry
from tpmscad.surfaces.surface_patch import PARAMETER_MARGIN, SurfacePatch, primitive_patch
from tpmscad.surfaces.surface_records import CATALOGUE, SurfaceInfo, check_reference, find_surface


def surface_symmetry(name: str) -> PatchSymmetry | MirrorSymmetry:
    """What the lattice of a catalogued surface is copied by: proper motions of its patch, or reflections of its piece."""
    return mirror_symmetry(name) if has_mirrors(name) else patch_symmetry(name)


__all__ = [
    "CATALOGUE",
    "PARAMETER_MARGIN",
    "MirrorSymmetry",
    "PatchSymmetry",
    "SurfaceInfo",
    "SurfaceJet",
    "SurfacePatch",
    "area",
    "cell_measures",
    "check_offset",
    "check_reference",
    "find_surface",
    "has_mirrors",
    "mirror_symmetry",
    "offsets_for",
    "patch_symmetry",
    "primitive_patch",
    "skeletal_offset_for",
    "skeletal_volume_fraction",
    "surface_symmetry",
    "thickness_for",
    "volume_fraction",
]
