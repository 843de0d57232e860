"""Exact triply periodic minimal surfaces and their nodal counterparts in the unit cubic cell.

All lengths are in units of the cubic cell's edge unless a function takes a `cell`. The catalogue is `tpmscad.catalogue`.
"""

from tpmscad import catalogue
from tpmscad.catalogue import CATALOGUE, SurfaceRecord
from tpmscad.public_calls import public
from tpmscad.surfaces.curvature_integrals import area, cell_measures
from tpmscad.surfaces.differential_geometry import SurfaceJet
from tpmscad.surfaces.motion_group import PatchSymmetry, patch_symmetry
from tpmscad.surfaces.offset_volumes import (
    check_offset,
    offsets_for,
    skeletal_offset_for,
    skeletal_volume_fraction,
    thickness_for,
    volume_fraction,
)
from tpmscad.surfaces.reflection_group import MirrorSymmetry, has_mirrors, mirror_symmetry
from tpmscad.surfaces.surface_patch import PARAMETER_MARGIN, SurfacePatch, check_reference, primitive_patch


@public()
def surface_symmetry(name: str) -> PatchSymmetry | MirrorSymmetry:
    """Return the symmetry group that generates the whole surface from its primitive.

    Parameters
    ----------
    name : str
        Name or alias of a surface of the catalogue.

    Returns
    -------
    PatchSymmetry or MirrorSymmetry
        The proper motions of an exact patch, or the reflections of a mirrored piece.

    Raises
    ------
    InvalidRequest
        If the surface is unknown or has neither an exact patch nor a mirrored piece.

    Examples
    --------
    >>> from tpmscad import surfaces
    >>> symmetry = surfaces.surface_symmetry("gyroid")
    >>> len(symmetry.edge_motions)
    4
    """
    return mirror_symmetry(name) if has_mirrors(name) else patch_symmetry(name)


# here and not in the catalogue, which the help of the command line reads without NumPy
find_surface = public()(catalogue.find_surface)

__all__ = [
    "CATALOGUE",
    "PARAMETER_MARGIN",
    "MirrorSymmetry",
    "PatchSymmetry",
    "SurfaceJet",
    "SurfacePatch",
    "SurfaceRecord",
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


def __dir__() -> list[str]:
    return sorted(__all__)
