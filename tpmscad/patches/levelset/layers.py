"""A field taken apart into the level sets that bound its solid, each laid out by itself.

The solid of an intersection is bounded by parts of both level sets, and where these never meet inside the box (the two walls of a
sheet) each is whole: {max(f, g) = 0} is {f = 0} and {g = 0} side by side. So a thin wall costs what a thick one does. Level sets
that meet make an edge, which patches that join smoothly can't follow.
"""

from __future__ import annotations

import numpy as np

from tpmscad.fields.booleans import Extreme
from tpmscad.fields.field import Field
from tpmscad.patches.levelset.caps import LayoutError
from tpmscad.patches.levelset.layout.octree import Array


def layers(field: Field) -> tuple[Field, ...]:
    """The fields whose level sets bound the solid of `field`."""
    if isinstance(field, Extreme):
        return (*layers(field.first), *layers(field.second))
    return (field,)


def rejoined(field: Field, parts: tuple[Field, ...]) -> Field:
    """`field` with its layers, as `layers` takes them apart, replaced by others."""
    if isinstance(field, Extreme):
        n = len(layers(field.first))
        return Extreme(rejoined(field.first, parts[:n]), rejoined(field.second, parts[n:]), field.sign)
    return parts[0]


def check_apart(field: Field, parts: tuple[Field, ...], points: list[Array], tol: float) -> float:
    """The least distance between the layers, to first order, at `points` (n, 3) of each; LayoutError unless above 2 tol.

    On {f = 0} the whole field must vanish, too: elsewhere that part of the level set does not bound the solid.
    """
    least = np.inf
    for i, part in enumerate(parts):
        if len(parts) == 1 or not len(points[i]):
            continue
        off = np.abs(field(points[i])) / np.linalg.norm(part.gradient(points[i]), axis=1)
        if off.max() > tol:
            raise LayoutError(
                f"two surfaces cross near {_text(points[i][off.argmax()])}: an edge that smooth patches can't follow; "
                "round it (fields.smooth_intersection, smooth_union) or cut the solid by the kernel instead"
            )
        for other in (o for j, o in enumerate(parts) if j != i):
            value, slope = other.value_and_gradient(points[i])
            wall = np.abs(value) / np.maximum(np.linalg.norm(slope, axis=1), 1e-300)
            least = min(least, float(wall.min()))
            if least <= 2 * tol:
                raise LayoutError(
                    f"the wall is {wall.min():.3g} thick near {_text(points[i][wall.argmin()])}, which tol {tol:g} can't "
                    f"tell from none: use a tol below {wall.min() / 2:.2g}, or a thicker wall"
                )
    return least


def _text(point: Array) -> str:
    return "(" + ", ".join(f"{x:.5g}" for x in point) + ")"
