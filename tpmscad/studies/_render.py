"""Pictures of models, shapes and STEP files: views, sections, and colours by piece, tag, deviation or curvature."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from tpmscad._typing import Array
from tpmscad.api.argument_kinds import POINT
from tpmscad.api.public_calls import validate_call
from tpmscad.api.shared_kinds import ANYTHING, PATH, PICTURE_SIZE, TEXT, TEXTS
from tpmscad.atomic_file import validate_output_path
from tpmscad.errors import InvalidRequest
from tpmscad.kernel.occt.exploration import faces_of
from tpmscad.kernel.render.palette import SURFACE_COLOUR, diverging_scale, sequential_scale
from tpmscad.kernel.render.picture import draw_scene, write_picture
from tpmscad.kernel.render.polar_surface import draw_polar_surface
from tpmscad.kernel.render.scene import Scene
from tpmscad.simulation.properties import HomogenizedProperties
from tpmscad.studies.picture_pieces import PicturePiece, base_names, choose_colours, find_pieces, hide_pieces

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

CURVATURE_SHARE = 0.99
"""Share of the points whose mean curvature the scale of colours spans; a few extreme points would make the rest look flat."""

Colour = tuple[float, float, float]


@validate_call()
def render(
    source: Annotated[
        Any,
        ANYTHING,
        "A result of this package, a build123d, CadQuery or TopoDS shape, or the path of a STEP file. Of homogenised "
        "properties the surface is drawn whose radius along a direction is Young's modulus there.",
    ],
    path: Annotated[str | Path, PATH, "The PNG file to write. It is complete or absent."],
    *,
    view: Annotated[
        str | Sequence[float],
        TEXT.or_else(POINT).described_as(example='"iso"'),
        '"iso", "front", "back", "left", "right", "top", "bottom", or the direction from the model to the eye, also '
        'as "x,y,z".',
    ] = "iso",
    section: Annotated[
        Any,
        ANYTHING,
        'Planes that cut the model open: "z=5", "z" for the middle, "x=0,y=0" for a quarter, or a point (3,) and the '
        "normal (3,) of the side that is taken away. Of several planes, what lies in front of all is taken away. Cuts "
        "through solids are filled.",
    ] = None,
    size: Annotated[tuple[int, int], PICTURE_SIZE, "Width and height in pixels."] = (1200, 900),
    color_by: Annotated[
        str | None,
        TEXT.described_as(example='"piece"'),
        "A colour for each solid or domain; for each group of faces (surface +, surface -, cap, body); the orthogonal "
        "distance to the reference surface, as the certificate measures it; or the mean curvature, half the sum of "
        "the principal curvatures, positive where the solid is convex. By default the domains of an exchanger have "
        "their colours, a STEP file has those that it holds, and anything else has one.",
    ] = None,
    hide: Annotated[
        str | Sequence[str], TEXTS.described_as(example='"skin"'), 'Names of pieces to leave out, such as "wall".'
    ] = (),
) -> None:
    """Draw a model, a shape or a STEP file as a PNG picture, without a display.

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
    target = validate_output_path(path, (".png",))
    picture = render_bytes(source, view=view, section=section, size=size, color_by=color_by, hide=hide)
    write_picture(picture, target)


@validate_call()
def render_bytes(
    source: Annotated[Any, ANYTHING, "TODO."],
    *,
    view: Annotated[str | Sequence[float], TEXT.or_else(POINT).described_as(example='"iso"'), "TODO."] = "iso",
    section: Annotated[Any, ANYTHING, "TODO."] = None,
    size: Annotated[tuple[int, int], PICTURE_SIZE, "TODO."] = (1200, 900),
    color_by: Annotated[str | None, TEXT.described_as(example='"piece"'), "TODO."] = None,
    hide: Annotated[str | Sequence[str], TEXTS.described_as(example='"skin"'), "TODO."] = (),
) -> bytes:
    """The bytes of the PNG picture that `render` writes, for notebooks; arguments and errors are those of `render`."""
    if color_by is not None and color_by not in COLOURINGS:
        raise InvalidRequest(
            f"color_by {color_by!r} is unknown; choose one of {', '.join(map(repr, COLOURINGS))}, or None"
        )
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
        return draw(scene.with_values(values), scale=scale)
    if color_by == "curvature":
        values = scene.mean_curvature()
        scale = diverging_scale("mean curvature, 1/mm\n(convex: positive)", values, CURVATURE_SHARE)
        return draw(scene.with_values(values), scale=scale)
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
    """Names and colours of the groups of faces."""
    return tuple(
        {
            group: colour
            for piece in pieces
            for group, colour in zip(piece.face_groups, piece.face_colours, strict=False)
            if colour is not None
        }.items()
    )


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
