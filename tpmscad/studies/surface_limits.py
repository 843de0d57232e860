"""The limits of the catalogue's surfaces that a designer asks for before anything is made.

The wall of a sheet folds where half its thickness reaches the least radius of curvature of the surface on either side.
"""

from __future__ import annotations

import math
from typing import Annotated, Any

from tpmscad import surfaces
from tpmscad.api.public_calls import validate_call
from tpmscad.api.shared_kinds import TEXT
from tpmscad.fields.kinds.one_piece_ranges import find_level_ranges, find_sheet_limit


@validate_call()
def thickest_wall(
    surface: Annotated[str, TEXT, "Name of a surface of the catalogue."],
    reference: Annotated[
        str | None,
        TEXT.described_as(example='"nodal"'),
        "The minimal surface, or the trigonometric surface of its name; the default is that of `tpmscad.lattice`.",
    ] = None,
) -> float:
    """Return the thickness, in cell edges, that the wall of a symmetric sheet has to stay below.

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
    >>> from tpmscad.studies.surface_limits import thickest_wall
    >>> round(thickest_wall("gyroid"), 4)
    0.3765
    """
    info = surfaces.find_surface(surface)
    if reference is None:
        reference = info.references[0]
    surfaces.check_reference(info, reference)
    measures = surfaces.cell_measures(info.name, reference)
    return float(2.0 * min(measures.max_offset, -measures.min_offset))


def describe_pieces(name: str, reference: str) -> dict[str, Any]:
    """The ranges of levels and volume fractions of both sides, and the level up to which a sheet has two whole channels.

    A level beyond the range of the function is None.
    """
    ranges: dict[str, Any] = {
        side: [
            {
                "levels": [each.level, None if math.isinf(each.to_level) else each.to_level],
                "volume_fractions": [each.fraction, each.to_fraction],
            }
            for each in find_level_ranges(name, reference, side)
        ]
        for side in "-+"
    }
    return {**ranges, "sheet_to_level": find_sheet_limit(name, reference)}
