"""The keywords of `lattice`, `infill` and `fluid_domains`, each declared once.

The classes are the arguments of the functions, validated one by one (`tpmscad.api.public_calls`). What they mean
together is resolved in `lattice_request`. The command line reads this module for its options, so it does without NumPy.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass
from typing import TYPE_CHECKING, Annotated, Any

from tpmscad.api.argument_kinds import POINT, choice_of
from tpmscad.api.shared_arguments import LoosePieces, StageProgress
from tpmscad.api.shared_kinds import (
    BOX,
    CELL_COUNTS,
    FACES,
    GRADED_FRACTION,
    GRADED_OFFSET,
    GRADED_THICKNESS,
    LENGTHS,
    MAP,
    NAME_OR_FIELD,
    NOT_NEGATIVE,
    ONE_SOLID,
    OPENINGS,
    POSITIVE,
    SHAPE,
    SOLID,
    TEXT,
)

if TYPE_CHECKING:
    from tpmscad._typing import Array
    from tpmscad.fields.field import Field
    from tpmscad.lattices.coordinate_maps import Map

    Graded = float | str | Callable[[Array], Array]

Surface = Annotated[str, TEXT, "Name of a surface of the catalogue; see ``tpmscad surfaces``."]


@dataclass(frozen=True, kw_only=True)
class WallOptions:
    """The keywords of every wall of a lattice."""

    cell: Annotated[
        float | Sequence[float] | None,
        LENGTHS,
        "Edge length of the cell, or one for each axis, mm. Required for a surface unless `pore_size` is given.",
    ] = None
    thickness: Annotated[
        Graded | None,
        GRADED_THICKNESS,
        "Wall thickness along the normal, mm. Give exactly one of `thickness`, `offset`, `volume_fraction` and `porosity`. Of "
        "gyroid, diamond and P each may be graded: a field, a function of points (n, 3) of the model, or a formula of x, y and z "
        "as text; its value at each point of the mid surface counts. It should be smooth.",
    ] = None
    offset: Annotated[
        Graded | Sequence[Graded] | None,
        GRADED_OFFSET,
        "Signed normal distances of the two sides of the wall, the lower first, mm.",
    ] = None
    volume_fraction: Annotated[
        Graded | None,
        GRADED_FRACTION,
        "Solid fraction of the whole cell, from which the distances follow; if graded, that of an even lattice with the wall of "
        "the place.",
    ] = None
    porosity: Annotated[Graded | None, GRADED_FRACTION, "Void fraction of the whole cell, 1 - volume fraction."] = None
    pore_size: Annotated[
        float | None,
        POSITIVE,
        "Diameter of the largest sphere in the void of the endless lattice, mm; instead of `cell`, which follows from it. Of a "
        "sheet the larger of the two channels counts; a note of the certificate states both.",
    ] = None
    reference: Annotated[
        str | None,
        choice_of("minimal", "nodal"),
        "The 'minimal' surface, of mean curvature zero, or the trigonometric one of its name, 'nodal'. The default is 'minimal' "
        "for gyroid, diamond and Schwarz P, whose minimal surface is exact, and 'nodal' for others.",
    ] = None
    phase: Annotated[Sequence[float] | None, POINT, "Shift of the lattice, in cells; none by default."] = None
    tol: Annotated[
        float | None,
        POSITIVE.described_as(example="0.01"),
        "Greatest orthogonal deviation from the surface or the field, mm; by default a thousandth of the smallest cell edge. "
        "Required for a field.",
    ] = None
    progress: StageProgress = None


@dataclass(frozen=True, kw_only=True)
class SolidOptions(WallOptions):
    """The keywords of lattices that need not be walls."""

    offset: Annotated[
        Graded | Sequence[Graded] | None,
        GRADED_OFFSET,
        "Signed normal distances of the two sides of the wall, the lower first, mm; one distance for `kind='skeletal'`.",
    ] = None
    kind: Annotated[
        str, choice_of("sheet", "skeletal"), "Solid between two offset surfaces, or on one side of one."
    ] = "sheet"
    side: Annotated[
        str,
        choice_of("-", "+"),
        "Solid side of a skeletal lattice: '-' is where the nodal value is negative.",
    ] = "-"
    loose: LoosePieces = "drop"


@dataclass(frozen=True)
class LatticeOptions(SolidOptions):
    """The arguments of `lattice`."""

    surface: Surface
    _: KW_ONLY
    cells: Annotated[int | Sequence[int], CELL_COUNTS, "Number of cells along every axis, or along each."] = (1, 1, 1)
    boundary: Annotated[
        str,
        choice_of("box", "natural"),
        "Caps in the faces of the box, or whole patches bridged by gap faces. Under a wrap the box is a tube, a sector of one, "
        "a band or a dome with a round rim, as large as the map makes it.",
    ] = "box"
    phase: Annotated[
        Sequence[float] | None,
        POINT,
        "Shift of the lattice, in cells; (0, 0, 0) is the nodal formula's own place. By default the shift that makes one piece "
        "in a box (see ``tpmscad surfaces``), and none for a natural boundary or a map.",
    ] = None
    map: Annotated[
        Map | Callable[[Array], Array] | None,
        MAP,
        "Smooth function (..., 3) -> (..., 3) of lattice coordinates in model units, or one of `tpmscad.maps`. Walls keep their "
        "thickness. A map that repeats after the length of the lattice closes it to a ring; one that lays walls on each other "
        "is refused.",
    ] = None


@dataclass(frozen=True)
class BodyOptions(WallOptions):
    """The arguments of every lattice in a body."""

    body: Annotated[
        Any,
        SHAPE,
        "One closed solid: a build123d, CadQuery or TopoDS shape, the path of a STEP, IGES or BREP file, or what `read_body` "
        "returns; a closed triangle mesh: the path of an STL, OBJ, PLY or 3MF file, or `fields.mesh`; or any field of "
        "`tpmscad.fields` with a finite solid. What is repaired of a file is told in the notes of the certificate.",
    ]
    _: KW_ONLY
    solid: Annotated[
        int | str | None,
        ONE_SOLID,
        "Which solid, if the body or its file has several: its number from 1, as ``tpmscad check`` lists them, or 'largest'.",
    ] = None
    box: Annotated[
        Sequence[Sequence[float]] | None,
        BOX,
        "Box in which the solid of a field given as `body` is made, model units; planes close the solid at its sides. By default "
        "that of the field's data, or bounds that are found from its formula.",
    ] = None
    rotation: Annotated[
        Sequence[float],
        POINT.described_as("three angles in degrees", "(0, 0, 45)"),
        "Rotation of the lattice about the origin: degrees about x, then about its own y, then about its own z.",
    ] = (0.0, 0.0, 0.0)


@dataclass(frozen=True, kw_only=True)
class PassiveOptions:
    """What of a filled body is not left to the lattice."""

    keep: Annotated[
        Any,
        SHAPE,
        "CAD solids that the result contains with their own, exact faces, such as bosses and flanges; all solids of a shape or "
        "a file, the surroundings of round holes, or a list of both. Within a skin they lie in the body.",
    ] = None
    clear: Annotated[
        Any,
        SHAPE,
        "CAD solids that stay empty, such as bolts in their bores: what of the filled body and of `keep` lies in them is cut "
        "away, with exact faces.",
    ] = None


@dataclass(frozen=True)
class FluidDomainsOptions(PassiveOptions, BodyOptions):
    """The arguments of `fluid_domains`."""

    surface: Surface
    _: KW_ONLY
    phase: Annotated[
        Sequence[float] | None,
        POINT,
        "Shift of the lattice, in cells. By default that of `lattice`, which makes one piece in a box of whole cells.",
    ] = None
    openings: Annotated[
        Mapping[str, Any] | None,
        OPENINGS,
        "Faces at which the channels '+' and '-' open, as in `infill`'s open_faces; both may open at one. Behind all "
        "other faces a channel ends, at the depth of `skin`. By default each opens wherever it meets the body.",
    ] = None
    transition: Annotated[
        float | None,
        NOT_NEGATIVE.described_as(example="10.0"),
        "Length over which a channel closes behind the skin, mm: the wall grows until it fills it. By default 0, an abrupt "
        "end with creases, or the longest edge of the cell if an opening is not plane.",
    ] = None
    skin: Annotated[
        float | None,
        POSITIVE,
        "With `openings`: thickness of the solid wall kept along faces where a channel does not open, mm; by default the "
        "thickness of the wall.",
    ] = None


@dataclass(frozen=True)
class InfillOptions(SolidOptions, PassiveOptions, BodyOptions):
    """The arguments of `infill`."""

    surface: Annotated[
        str | Field | Callable[..., Any],
        NAME_OR_FIELD,
        "Name of a surface (see ``tpmscad surfaces``), or a field in the body's coordinates that is negative where solid. A "
        "field takes `solid`, `tol`, `skin`, `open_faces`, `keep`, `clear`, `loose` and `progress` only.",
    ]
    _: KW_ONLY
    solid: Annotated[
        int | str | None,
        SOLID,
        "Which solid, if the body or its file has several: its number from 1, as ``tpmscad check`` lists them, 'largest', or "
        "'all': each is filled by itself, and the pieces have its name in files.",
    ] = None
    map: Annotated[
        Map | Callable[[Array], Array] | None,
        MAP,
        "Smooth function (..., 3) -> (..., 3) of lattice coordinates in model units, or one of `tpmscad.maps`: the lattice is "
        "made under it, turned by `rotation`, and cut by the body. One between two faces has about cubic cells; others count "
        "cells from the origin of their coordinates. Walls keep their thickness.",
    ] = None
    skin: Annotated[
        float | None,
        POSITIVE,
        "Thickness of a solid wall kept along the body's boundary and joined to the lattice, mm.",
    ] = None
    open_faces: Annotated[
        Iterable[Any],
        FACES,
        "Plane faces of the body that get no skin, so that powder or fluid can pass; they may be adjacent. Faces of "
        "that very shape, their numbers in its order from 0, or text such as `>Z,<Z`: `>Z` for the faces at one "
        "end of an axis, `|Z` for those square to it, `#Z` for those along it, `+Z` and `-Z` by the outward normal.",
    ] = ()
