"""The keywords of `struts`, each declared once, without NumPy: the command line reads this module for its options."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import KW_ONLY, dataclass
from typing import TYPE_CHECKING, Annotated

from tpmscad.api.argument_kinds import choice_of
from tpmscad.api.shared_arguments import LoosePieces, StageProgress
from tpmscad.api.shared_kinds import (
    ANGLE,
    CELL_COUNTS,
    FRACTION,
    GRADED_THICKNESS,
    LENGTHS,
    MAP,
    NOT_NEGATIVE,
    POSITIVE,
)
from tpmscad.strut_cells import DEFAULT_ANGLE, FLAT_KINDS, KINDS

if TYPE_CHECKING:
    from tpmscad._typing import Array
    from tpmscad.lattices.coordinate_maps import Map

StrutKind = Annotated[
    str, choice_of(*KINDS, *FLAT_KINDS), "Kind of cell; a net needs a map, which makes a stent of it."
]


@dataclass(frozen=True)
class StrutOptions:
    """The arguments of `struts`."""

    kind: StrutKind
    _: KW_ONLY
    cell: Annotated[float | Sequence[float], LENGTHS, "Edge length of the cell, or one for each axis, mm."]
    cells: Annotated[int | Sequence[int], CELL_COUNTS, "Number of cells along every axis, or along each."] = (1, 1, 1)
    diameter: Annotated[
        float | str | Callable[[Array], Array] | None,
        GRADED_THICKNESS,
        "Diameter of the struts, mm; a function of points (n, 3), a field, or a formula of x, y and z makes cones between the "
        "values at the nodes. Give exactly one of `diameter`, `volume_fraction` and `porosity`.",
    ] = None
    volume_fraction: Annotated[
        float | None, FRACTION, "Solid fraction of the box of the cells, from which the diameter follows."
    ] = None
    porosity: Annotated[float | None, FRACTION, "Void fraction of the box, 1 - volume fraction."] = None
    node_radius: Annotated[
        float,
        NOT_NEGATIVE,
        "Radius of a ball at every node, mm; 0 is that of the struts. The ball meets the struts in sharp edges.",
    ] = 0.0
    map: Annotated[
        Map | Callable[[Array], Array] | None,
        MAP,
        "Smooth function (..., 3) -> (..., 3) of the nodes, or one of `tpmscad.maps`: straight struts, none of them cut, join "
        "their images. A map that repeats after the length of the lattice closes it to a ring. Needs `diameter`.",
    ] = None
    angle: Annotated[float, ANGLE, "Of `re-entrant` and its net: by which struts lean inwards, degrees, up to 30."] = (
        DEFAULT_ANGLE
    )
    tol: Annotated[
        float | None,
        POSITIVE.described_as(example="0.01"),
        "Greatest deviation, mm, which all edges are checked against; by default a thousandth of the smallest cell edge. The "
        "surfaces are exact.",
    ] = None
    loose: LoosePieces = "drop"
    progress: StageProgress = None
