"""The limits of the catalogue's surfaces that a designer asks for before anything is made.

The wall of a sheet folds where half its thickness reaches the least radius of curvature of the surface on either side.
"""

from __future__ import annotations

from tpmscad import surfaces
from tpmscad.api.public_calls import public


@public()
def thickest_wall(surface: str, reference: str | None = None) -> float:
    """Return the thickness, in cell edges, that the wall of a symmetric sheet has to stay below.

    Parameters
    ----------
    surface : str
        Name of a surface of the catalogue.
    reference : {"minimal", "nodal"}, optional
        The exact minimal surface (the default if the catalogue has it), or the trigonometric surface of its name.

    Returns
    -------
    float
        Twice the least radius of curvature.

    Raises
    ------
    InvalidRequest
        If no surface has this name, or it does not have this reference.

    Examples
    --------
    >>> from tpmscad.studies._thickest_wall import thickest_wall
    >>> round(thickest_wall("gyroid"), 4)
    0.3765
    """
    info = surfaces.find_surface(surface)
    if reference is None:
        reference = info.references[0]
    surfaces.check_reference(info, reference)
    measures = surfaces.cell_measures(info.name, reference)
    return float(2.0 * min(measures.max_offset, -measures.min_offset))
