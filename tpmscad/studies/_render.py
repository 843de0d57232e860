"""Pictures of models, shapes and STEP files: views, sections, and colours by piece, tag, deviation or curvature.

Models and domains list their named solids, with groups of faces and colours; a STEP file holds names and colours of its own.
"""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tpmscad._typing import Array, Colour
from tpmscad.api.arguments import select_arguments
from tpmscad.api.public_calls import validate_options
from tpmscad.atomic_file import atomic_write, validate_output_path
from tpmscad.brep.solid_names import strip_place
from tpmscad.errors import InvalidRequest
from tpmscad.fields.data.triangle_mesh import is_mesh_path
from tpmscad.kernel.body_import.isolated_reader import read_foreign_coloured_solids
from tpmscad.kernel.occt.construction import make_compound
from tpmscad.kernel.occt.exploration import faces_of
from tpmscad.kernel.render.palette import (
    SURFACE_COLOUR,
    diverging_scale,
    numbered_colour,
    piece_colour,
    sequential_scale,
)
from tpmscad.kernel.render.picture import draw_scene
from tpmscad.kernel.render.polar_surface import draw_polar_surface
from tpmscad.kernel.render.scene import Scene, pieces_of
from tpmscad.kernel.step.face_labels import find_label_colour
from tpmscad.requests.study_options import PiecesPictureOptions, RenderOptions
from tpmscad.simulation.properties import HomogenizedProperties
from tpmscad.studies.mesh_picture import draw_triangles, read_drawn_triangles

COLOURINGS = ("piece", "tag", "deviation", "curvature")
VALUE_COLOURINGS = ("deviation", "curvature")

OFF_REFERENCE_FACTOR = 10.0
"""A face belongs to a cap, a body or a skin if it lies off the reference by more than this many times the greatest deviation
measured, or the tolerance."""

VALUE_FACET_ANGLE = 0.05
"""Radians between neighbouring facets where values are shown, which are linear on a triangle, of up to `N_FINE_FACES` faces."""

N_FINE_FACES = 600
"""Faces up to which values are shown in full detail; beyond, facets grow as faces get smaller on the picture."""

SECTION_FACET_ANGLE = 0.12
"""Radians between neighbouring facets where a section shows them from the side."""

_AXIS = re.compile(r" [XYZ][+-]$")
_BODY_FACE = re.compile(r"body (\d+)")

CURVATURE_SHARE = 0.99
"""Share of the points whose mean curvature the scale of colours spans; a few extreme points would make the rest look flat."""


@validate_options(RenderOptions, 'render(model, "part.png", section="z")')
def render(options: RenderOptions) -> None:
    """Draw a model, a shape, a CAD file or a file of triangles as a PNG picture, without a display.

    Raises
    ------
    InvalidRequest
        If an argument is not understood, or the source lacks what the colouring needs.
    KernelError
        If the kernel cannot read the file, or there is nothing to draw.

    Examples
    --------
    >>> parts = tpmscad.fluid_domains(body, "gyroid", cell=10, thickness=1)  # doctest: +SKIP
    >>> render(parts, "exchanger.png", section="z=2", hide="channel +")  # doctest: +SKIP
    """
    target = validate_output_path(options.path, (".png",))
    picture = render_bytes(options.source, **select_arguments(options, PiecesPictureOptions))
    with atomic_write(target) as aside:
        aside.write_bytes(picture)


def render_bytes(source: Any, **picture: Any) -> bytes:
    """The bytes of the PNG picture that `render` writes, for notebooks; keywords are those of `PiecesPictureOptions`."""
    return _draw(source, PiecesPictureOptions(**picture))


def _draw(source: Any, options: PiecesPictureOptions) -> bytes:
    """The bytes of the PNG picture of a result, a shape or a file."""
    view, section, size, color_by, hide = options.view, options.section, options.size, options.color_by, options.hide
    if color_by is not None and color_by not in COLOURINGS:
        raise InvalidRequest(
            f"color_by {color_by!r} is unknown; choose one of {', '.join(map(repr, COLOURINGS))}, or None"
        )
    if is_mesh_path(source):
        return draw_triangles(read_drawn_triangles(Path(source)), options)
    if isinstance(source, HomogenizedProperties):
        if color_by is not None or hide:
            raise InvalidRequest(
                "a picture of effective stiffness has the colours of its moduli: leave color_by and hide out"
            )
        title = f"Young's modulus of\n{source.name}"
        return draw_polar_surface(source.directional_modulus, title, view=view, section=section, size=size)
    distance = _reference_distance(source) if color_by == "deviation" else None
    found = find_pieces(source, with_groups=color_by in ("piece", "tag"))
    pieces = hide_pieces(found, (hide,) if isinstance(hide, str) else tuple(hide))
    has_axes = view != "iso" or section is not None
    draw = partial(draw_scene, view=view, section=section, size=size, axes=has_axes)
    scene = Scene.of_pieces([piece.shape for piece in pieces], angle=_facet_angle(pieces, color_by, section))
    if distance is not None:
        values = _values_on_reference(distance(scene.points), scene, source)
        scale = sequential_scale("distance from the\nreference, mm", values)
        return draw(replace(scene, values=values), scale=scale)
    if color_by == "curvature":
        values = scene.mean_curvature()
        scale = diverging_scale("mean curvature, 1/mm\n(convex: positive)", values, CURVATURE_SHARE)
        return draw(replace(scene, values=values), scale=scale)
    if color_by == "tag" or (color_by is None and not any(piece.colour for piece in pieces)):
        return draw(_paint_faces(pieces, scene, color_by), key=_key_of_groups(pieces) if color_by == "tag" else ())
    colours = choose_colours(pieces)
    key = tuple(dict(zip(base_names(pieces), colours, strict=True)).items())
    if len(key) == 1:
        key = tuple((piece.name, colour) for piece, colour in zip(pieces, colours, strict=True))
    return draw(scene.with_piece_colours(colours), key=key if len(key) > 1 else ())


def _facet_angle(pieces: Sequence[PicturePiece], color_by: str | None, section: Any) -> float | None:
    """Radians between neighbouring facets; None for the default."""
    if color_by in VALUE_COLOURINGS:
        n_faces = sum(len(faces_of(piece.shape)) for piece in pieces)
        return float(
            np.clip(VALUE_FACET_ANGLE * np.sqrt(n_faces / N_FINE_FACES), VALUE_FACET_ANGLE, SECTION_FACET_ANGLE)
        )
    return None if section is None else SECTION_FACET_ANGLE


def _paint_faces(pieces: Sequence[PicturePiece], scene: Scene, color_by: str | None) -> Scene:
    """The scene with the colours of the faces, as it is where they have none; InvalidRequest if they were asked for."""
    if not any(any(piece.face_colours) for piece in pieces):
        if color_by is not None:
            raise InvalidRequest(
                'color_by="tag" needs groups of faces, which this shape has not: draw the model that made it, or a STEP file '
                "that was written with colours"
            )
        return scene
    plain = SURFACE_COLOUR
    uniform = [colours.pop() if len(colours) == 1 else None for colours in ({*piece.face_colours} for piece in pieces)]
    scene = scene.with_piece_colours([colour or plain for colour in uniform])
    return scene.with_face_colours([colour or plain for piece in pieces for colour in piece.face_colours])


def _key_of_groups(pieces: Sequence[PicturePiece]) -> tuple[tuple[str, Colour], ...]:
    """Names and colours of the groups of faces, numbered ones in their order."""
    found = {
        group: colour
        for piece in pieces
        for group, colour in zip(piece.face_groups, piece.face_colours, strict=False)
        if colour is not None
    }
    return tuple((group, found[group]) for group in sorted(found, key=_number_parts))


def _number_parts(text: str) -> list[str | int]:
    """Words and numbers of a text by turns, by which "body 2" is sorted before "body 10"."""
    return [int(part) if part.isdigit() else part for part in re.split(r"(\d+)", text)]


def _reference_distance(source: Any) -> Any:
    """The function of points (n, 3) that gives their distance from the reference surface; InvalidRequest without a reference."""
    distance = getattr(source, "distance_to_reference", None)
    if distance is None:
        raise InvalidRequest(
            'color_by="deviation" needs the surface that the model was made from, which only the result of lattice, infill or '
            "solidify knows: call its render"
        )
    return distance


def _values_on_reference(distance: Array, scene: Scene, model: Any) -> Array:
    """The distances at points of faces on the reference; NaN on caps, the body's faces and skins."""
    certificate = model.certificate
    limit = OFF_REFERENCE_FACTOR * max(certificate.tol, certificate.max_deviation)
    greatest = np.where(scene.has_spline(), 0.0, np.inf)
    np.maximum.at(greatest, scene.face, np.nan_to_num(distance, nan=np.inf))
    return np.where(greatest[scene.face] <= limit, distance, np.nan)


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
                _paint_groups(named.labels),
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
    """The group of a face: "cap" for the label "cap X+", other labels for themselves."""
    return _AXIS.sub("", label)


def _paint_groups(labels: Sequence[str]) -> tuple[Colour, ...]:
    """The colour of each label's group; the numbered faces of a body differ from one another."""
    return tuple(
        find_label_colour(label) if match is None else numbered_colour(int(match[1]))
        for label, match in ((label, _BODY_FACE.match(label)) for label in labels)
    )
