"""Files of layers: SVG, Common Layer Interface, and 3MF with its slice extension.

Sources: "Common Layer Interface (CLI)", version 2.0, 1996 (EuRAM project BE 2578); 3MF Slice Extension 1.0.2 (3MF Consortium).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np

from tpmscad._typing import Array
from tpmscad.atomic_file import atomic_write
from tpmscad.brep.loops import signed_area
from tpmscad.fields.data.threemf_files import CORE, SCHEMAS
from tpmscad.kernel.export.threemf_file import escape_text, write_model_archive

DIGITS = 6
"""Decimals of a coordinate in mm: a nanometre."""

NUMBER_LIST = f"%.{DIGITS}f,"
"""A number and a comma. Numbers of a whole contour are formatted at once, which takes 0.6 of the time of one by one."""

SLICE_NAMESPACE = f"{SCHEMAS}slice/2015/07"


@dataclass(frozen=True, slots=True)
class Layer:
    """One layer: its lower and upper height in mm, and its contours.

    A contour is an array (n, 2) of points in mm whose last point joins the first; outer contours run counter-clockwise, holes
    clockwise. area and perimeter (mm2, mm) are those of the exact contour in the middle of the layer, not of the polygons. volume
    (mm3) is that of the part between the two heights, integrated from the areas of exact sections.
    """

    bottom: float
    top: float
    contours: tuple[Array, ...]
    area: float
    perimeter: float
    volume: float

    @property
    def middle(self) -> float:
        """The height at which the part is cut, mm."""
        return 0.5 * (self.bottom + self.top)


def write_svg(layers: Sequence[Layer], path: Path, title: str) -> None:
    """Write an SVG file in mm: a group for each layer with its height, and one path with all contours of the layer.

    The y-axis of SVG points down, so contours are mirrored as a whole to be seen from above.
    """
    points = _join_contours(layers)
    (x0, y0), (x1, y1) = points.min(axis=0).tolist(), points.max(axis=0).tolist()
    with atomic_write(path) as aside, aside.open("w", encoding="utf-8", newline="\n") as file:
        file.write(
            '<?xml version="1.0" encoding="UTF-8"?>\n'
            f'<svg xmlns="http://www.w3.org/2000/svg" width="{x1 - x0:.{DIGITS}f}mm" height="{y1 - y0:.{DIGITS}f}mm" '
            f'viewBox="{x0:.{DIGITS}f} {-y1:.{DIGITS}f} {x1 - x0:.{DIGITS}f} {y1 - y0:.{DIGITS}f}">'
            f"<title>{escape_text(title)}</title>\n"
        )
        for number, layer in enumerate(layers):
            outline = "".join(
                "M" + " ".join(f"{x:.{DIGITS}f},{-y:.{DIGITS}f}" for x, y in c.tolist()) + "Z" for c in layer.contours
            )
            file.write(
                f'<g id="layer{number}" data-bottom="{layer.bottom:.{DIGITS}f}" data-top="{layer.top:.{DIGITS}f}">'
                f'<path fill-rule="evenodd" d="{outline}"/></g>\n'
            )
        file.write("</svg>\n")


def write_cli(layers: Sequence[Layer], path: Path, title: str) -> None:
    """Write an ASCII file of the Common Layer Interface in mm; the height of a layer is that of its upper side.

    Direction 1 is an outer contour, 0 a hole; the first point of a contour is repeated as its last.
    """
    points = _join_contours(layers)
    low, high = points.min(axis=0).tolist(), points.max(axis=0).tolist()
    box = [*low, layers[0].bottom, *high, layers[-1].top]
    with atomic_write(path) as aside, aside.open("w", encoding="ascii", newline="\n") as file:
        file.write("$$HEADERSTART\n$$ASCII\n$$UNITS/1\n$$VERSION/200\n")
        name = title.encode("ascii", "replace").decode().replace(",", " ")
        file.write(
            f"$$LABEL/1,{name}\n$$DIMENSION/{','.join(f'{x:.{DIGITS}f}' for x in box)}\n$$LAYERS/{len(layers)}\n"
        )
        file.write("$$HEADEREND\n$$GEOMETRYSTART\n")
        for layer in layers:
            file.write(f"$$LAYER/{layer.top:.{DIGITS}f}\n")
            for contour in layer.contours:
                closed = np.concatenate([contour, contour[:1]])
                values = NUMBER_LIST * closed.size % tuple(closed.ravel().tolist())
                file.write(f"$$POLYLINE/1,{int(signed_area(contour) > 0)},{len(closed)},{values[:-1]}\n")
        file.write("$$GEOMETRYEND\n")


def write_sliced_3mf(layers: Sequence[Layer], path: Path, title: str) -> None:
    """Write a 3MF file whose object is a stack of slices; its mesh is the box of the part, as a preview of low resolution."""
    with atomic_write(path) as aside:
        write_model_archive(aside, _format_stack(layers, title))


def _format_stack(layers: Sequence[Layer], title: str) -> Iterator[str]:
    """The XML of the model, layer by layer. Slices start at the bottom of the object, which the build puts in its place."""
    bottom = layers[0].bottom
    yield (
        f'<?xml version="1.0" encoding="UTF-8"?>\n<model unit="millimeter" xml:lang="en-US" xmlns="{CORE}" '
        f'xmlns:s="{SLICE_NAMESPACE}" requiredextensions="s"><metadata name="Title">{escape_text(title)}</metadata>\n'
        f'<resources><s:slicestack id="1" zbottom="0">\n'
    )
    for layer in layers:
        yield f'<s:slice ztop="{layer.top - bottom:.{DIGITS}f}">'
        if layer.contours:
            yield "<s:vertices>"
            for x, y in np.concatenate(layer.contours).tolist():
                yield f'<s:vertex x="{x:.{DIGITS}f}" y="{y:.{DIGITS}f}"/>'
            yield "</s:vertices>"
        start = 0
        for contour in layer.contours:
            following = [*range(start + 1, start + len(contour)), start]
            yield (
                f'<s:polygon startv="{start}">' + "".join(f'<s:segment v2="{v}"/>' for v in following) + "</s:polygon>"
            )
            start += len(contour)
        yield "</s:slice>\n"
    yield "</s:slicestack>\n"
    points = _join_contours(layers)
    low, high = np.append(points.min(axis=0), 0.0), np.append(points.max(axis=0), layers[-1].top - bottom)
    corners = [np.where([i & 1, i & 2, i & 4], high, low).tolist() for i in range(8)]
    vertices = "".join(f'<vertex x="{x:.{DIGITS}f}" y="{y:.{DIGITS}f}" z="{z:.{DIGITS}f}"/>' for x, y, z in corners)
    triangles = "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in BOX_TRIANGLES)
    yield (
        f'<object id="2" type="model" name={quoteattr(title)} s:slicestackid="1" s:meshresolution="lowres">'
        f"<mesh><vertices>{vertices}</vertices><triangles>{triangles}</triangles></mesh></object></resources>\n"
        f'<build><item objectid="2" transform="1 0 0 0 1 0 0 0 1 0 0 {bottom:.{DIGITS}f}"/></build></model>\n'
    )


BOX_TRIANGLES = (
    *((0, 2, 1), (1, 2, 3), (4, 5, 6), (5, 7, 6), (0, 1, 4), (1, 5, 4)),
    *((2, 6, 3), (3, 6, 7), (0, 4, 2), (2, 4, 6), (1, 3, 5), (3, 7, 5)),
)
"""Triangles of a box whose corner i is at the upper end of x, y, z where bit 0, 1, 2 of i is set; normals outwards."""


def _join_contours(layers: Sequence[Layer]) -> Array:
    """The points (n, 2) of all contours; the origin if there are none."""
    return np.concatenate([contour for layer in layers for contour in layer.contours] or [np.zeros((1, 2))])
