"""Lattices of plates: the lattice planes of a cubic cell, thickened.

The plates lie in the planes h x/a + k y/b + l z/c = whole numbers. Those of {100} make boxes, of {110} tetrahedra, of {111}
tetrahedra and octahedra; together with the faces of other cells they reach the bounds of stiffness.

Source: Berger, Wadley and McMeeking, Mechanical metamaterials at the theoretical limit of isotropic elastic stiffness, Nature 543
(2017) 533.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product
from types import MappingProxyType
from typing import Annotated

import numpy as np

from tpmscad._typing import Array
from tpmscad.api.argument_kinds import choice_of
from tpmscad.api.public_calls import validate_call
from tpmscad.api.shared_kinds import CELL_COUNTS, LENGTHS, POSITIVE
from tpmscad.errors import InvalidRequest
from tpmscad.fields.field import Field
from tpmscad.fields.kinds.booleans import intersection, union
from tpmscad.fields.kinds.primitive_regions import halfspace

FAMILIES: Mapping[str, tuple[tuple[int, int, int], ...]] = MappingProxyType(
    {
        "cubic": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
        "bcc": ((1, 1, 0), (1, -1, 0), (1, 0, 1), (1, 0, -1), (0, 1, 1), (0, 1, -1)),
        "fcc": ((1, 1, 1), (1, 1, -1), (1, -1, 1), (-1, 1, 1)),
    }
)
"""Miller indices of the planes of each kind: {100}, {110} and {111}."""

MOST_PLATES = 300
"""Each is two operands of a boolean, which takes 10 s for 28 plates."""


@validate_call()
def plate_lattice(
    structure: Annotated[str, choice_of(*FAMILIES), "Kind of cell: plates in the planes {100}, {110} or {111}."],
    cell: Annotated[float | Sequence[float], LENGTHS, "Edge length of the cell, or one for each axis, model units."],
    thickness: Annotated[float, POSITIVE, "Thickness of the plates, model units."],
    cells: Annotated[int | Sequence[int], CELL_COUNTS, "Number of cells along every axis, or along each."] = (1, 1, 1),
) -> Field:
    """Return a lattice of plates, for the box from the origin to `cells` x `cell`.

    The plates are whole planes that meet the box; in its sides lie plates of which half is in the box. Chambers between the
    plates are closed: powder stays in them, unless `fields.difference` with cylinders opens them.

    Returns
    -------
    Field
        The union of the plates, negative inside, whose sides are exact planes.

    Raises
    ------
    InvalidRequest
        If the plates fill their chambers, or are too many.

    Examples
    --------
    >>> from tpmscad import fields
    >>> float(fields.plate_lattice("cubic", 10.0, 1.0)((5.0, 5.0, 0.25)))
    -0.25
    """
    edges = np.broadcast_to(np.asarray(cell, float), 3)
    corners = np.array(list(product(*((0, int(n)) for n in np.broadcast_to(np.asarray(cells), 3)))))
    plates = []
    for indices in FAMILIES[structure]:
        normal = np.array(indices) / edges
        spacing = 1.0 / float(np.linalg.norm(normal))
        if thickness >= spacing:
            raise InvalidRequest(
                f"thickness = {thickness:g} fills the gaps between the plates, which are {spacing:.6g} apart: make it thinner"
            )
        unit, levels = spacing * normal, corners @ indices
        plates += [(unit, spacing * level) for level in range(int(levels.min()), int(levels.max()) + 1)]
    if len(plates) > MOST_PLATES:
        raise InvalidRequest(f"{len(plates)} plates, {MOST_PLATES} is the limit: ask for fewer cells")
    return union(*(_make_plate(unit, offset, 0.5 * thickness) for unit, offset in plates))


def _make_plate(unit: Array, offset: float, half: float) -> Field:
    """What lies within `half` of a plane, given its unit normal and its distance from the origin."""
    upper, lower = tuple((offset + half) * unit), tuple((offset - half) * unit)
    return intersection(halfspace(upper, tuple(unit)), halfspace(lower, tuple(-unit)))
