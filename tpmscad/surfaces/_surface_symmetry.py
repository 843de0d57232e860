"""The symmetry group that generates a surface of the catalogue from its primitive."""

from tpmscad.api.public_calls import validate_call
from tpmscad.api.shared_arguments import Reference, SurfaceName
from tpmscad.surfaces.motion_group import PatchSymmetry, patch_symmetry
from tpmscad.surfaces.reflection_group import MirrorSymmetry, has_mirrors, mirror_symmetry


@validate_call()
def surface_symmetry(name: SurfaceName, reference: Reference = "nodal") -> PatchSymmetry | MirrorSymmetry:
    """Return the symmetry group that generates the whole surface from its primitive.

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
    return mirror_symmetry(name, reference) if has_mirrors(name) else patch_symmetry(name)
