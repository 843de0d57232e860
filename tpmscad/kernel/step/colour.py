"""Colours of faces by their tags, as STEP presentation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from tpmscad.errors import InvalidRequest
from tpmscad.kernel.step.text import Entities, reals, references

Colour = tuple[float, float, float]

TAG_COLOURS: Mapping[str, Colour] = {
    "offset+": (0.36, 0.56, 0.74),
    "offset-": (0.87, 0.60, 0.32),
    "gap": (0.62, 0.64, 0.66),
    "cap": (0.78, 0.80, 0.82),
    "body": (0.60, 0.70, 0.58),
}
"""A colour for every tag that lattices give."""


def write_colours(
    entities: Entities, context: int, faces: Sequence[int], tags: Sequence[str], colours: Mapping[str, Colour]
) -> None:
    """Style every face (entity number) whose tag has a colour, red, green and blue from 0 to 1."""
    styles = {tag: _style(entities, colours[tag]) for tag in dict.fromkeys(tags) if tag in colours}
    styled = [(face, styles[tag]) for face, tag in zip(faces, tags, strict=True) if tag in styles]
    if styled:
        items = entities.extend([f"STYLED_ITEM('color',(#{style}),#{face})" for face, style in styled])
        entities.add(f"MECHANICAL_DESIGN_GEOMETRIC_PRESENTATION_REPRESENTATION('',{references(items)},#{context})")


def _style(entities: Entities, colour: Colour) -> int:
    if not all(0.0 <= c <= 1.0 for c in colour):
        raise InvalidRequest(f"colour {colour} is not red, green and blue from 0 to 1")
    red, green, blue = reals([float(c) for c in colour])
    rgb = entities.add(f"COLOUR_RGB('',{red},{green},{blue})")
    fill = entities.add(f"FILL_AREA_STYLE_COLOUR('',#{rgb})")
    style = entities.add(f"FILL_AREA_STYLE('',(#{fill}))")
    area = entities.add(f"SURFACE_STYLE_FILL_AREA(#{style})")
    side = entities.add(f"SURFACE_SIDE_STYLE('',(#{area}))")
    usage = entities.add(f"SURFACE_STYLE_USAGE(.BOTH.,#{side})")
    return entities.add(f"PRESENTATION_STYLE_ASSIGNMENT((#{usage}))")
