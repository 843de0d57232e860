"""The pieces of what a picture shows: the solids of a model, of the domains of an exchanger, of a shape or of a STEP file.

Models and domains list their named solids, with groups of faces and colours; a STEP file holds names and colours of its own.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from tpmscad._typing import Colour
from tpmscad.brep.solid_names import strip_place
from tpmscad.errors import InvalidRequest
from tpmscad.kernel.body_import.isolated_reader import read_foreign_coloured_solids
from tpmscad.kernel.occt.construction import make_compound
from tpmscad.kernel.render.palette import piece_colour
from tpmscad.kernel.render.scene import pieces_of
from tpmscad.kernel.step.face_labels import find_label_colour


@dataclass(frozen=True, slots=True, eq=False)
class PicturePiece:
    """A TopoDS solid, or the faces outside solids, with its name; its colour, its faces' colours and groups where known."""

    name: str
    shape: Any
    colour: Colour | None = None
    face_colours: tuple[Colour | None, ...] = ()
    face_groups: tuple[str, ...] = ()


def find_pieces(source: Any, *, with_groups: bool) -> list[PicturePiece]:
    """The pieces of a model, of domains, of a shape or of a STEP file.

    with_groups: whether names and groups of faces are wanted of a single model, too; to find them may take seconds.
    """
    if isinstance(source, str | os.PathLike):
        return [
            PicturePiece(read.name or f"solid {number}", read.solid, face_colours=read.face_colours)
            for number, read in enumerate(read_foreign_coloured_solids(source), 1)
        ]
    if hasattr(source, "named_solids") and (with_groups or not hasattr(source, "built")):
        return [
            PicturePiece(
                named.name,
                named.solid,
                named.colour,
                tuple(map(find_label_colour, named.labels)),
                tuple(map(_find_group, named.labels)),
            )
            for named in source.named_solids()
        ]
    if hasattr(source, "vals") and not hasattr(source, "wrapped"):  # the stack of a CadQuery workplane
        source = make_compound([value.wrapped for value in source.vals()])
    found = pieces_of(source)
    labels = [child.label for child in getattr(source, "children", ()) for _ in child.solids()]  # a build123d assembly
    labels += [""] * (len(found) - len(labels))
    return [
        PicturePiece(label or (f"piece {k}" if k > 1 else "piece"), shape)
        for k, (label, shape) in enumerate(zip(labels, found, strict=False), 1)
    ]


def hide_pieces(pieces: list[PicturePiece], hidden: Sequence[str]) -> list[PicturePiece]:
    """The pieces that are not hidden; a name hides all pieces of the thing. InvalidRequest for an unknown name."""
    if not pieces:
        raise InvalidRequest("the shape has no face that can be drawn")
    names = base_names(pieces)
    kept = [p for p, name in zip(pieces, names, strict=True) if p.name not in hidden and name not in hidden]
    unknown = [name for name in hidden if name not in names and name not in [p.name for p in pieces]]
    if unknown or not kept:
        reason = f"there is no piece {unknown[0]!r} to hide" if unknown else "every piece is hidden"
        raise InvalidRequest(f"{reason}; the pieces are {', '.join(map(repr, dict.fromkeys(names)))}")
    return kept


def base_names(pieces: Sequence[PicturePiece]) -> list[str]:
    """The name of each piece, without its place or number if there is a piece of that name: "wall" for "wall (X+ Y- Z-)"."""
    names = {piece.name for piece in pieces}
    bases = [strip_place(piece.name) for piece in pieces]
    return [base if base in names else piece.name for base, piece in zip(bases, pieces, strict=True)]


def choose_colours(pieces: Sequence[PicturePiece]) -> list[Colour]:
    """A colour for each piece: its own, that of its name, or the next of the palette; pieces of one thing stay alike.

    Pieces that have no names but numbers differ.
    """
    names = base_names(pieces)
    if len(set(names)) == 1:
        names = [piece.name for piece in pieces]
    number = {name: k for k, name in enumerate(dict.fromkeys(names))}
    return [p.colour or piece_colour(name, number[name]) for name, p in zip(names, pieces, strict=True)]


def _find_group(label: str) -> str:
    """The group of a face: "cap" for the label "cap X+", "surface +" for itself."""
    group, _, rest = label.partition(" ")
    return label if rest in ("+", "-") else group
