"""Directions of view and section planes of pictures, as a caller names them.

The projection is orthographic. A section takes away what lies in front of its plane, on the side of the eye; of several sections,
what lies in front of all of them, so that two planes cut out a quarter.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tpmscad._typing import Array
from tpmscad.errors import InvalidRequest

VIEWS = {
    "iso": (1.0, -1.35, 0.85),  # rotated so that the three visible faces of a cube differ
    "front": (0.0, -1.0, 0.0),
    "back": (0.0, 1.0, 0.0),
    "left": (-1.0, 0.0, 0.0),
    "right": (1.0, 0.0, 0.0),
    "top": (0.0, 0.0, 1.0),
    "bottom": (0.0, 0.0, -1.0),
}
"""Direction from the model to the eye of each named view."""

EDGE_ON = 1e-9
"""Sine of the angle to the plane of section below which the eye sees the plane as a line."""

View = str | Sequence[float]
"""A name of `VIEWS`, "x,y,z", or the direction (3,) from the model to the eye."""


@dataclass(frozen=True, slots=True, eq=False)
class SectionPlane:
    """The points p with normal . p = offset; what lies on the side of the unit normal (3,) is taken away."""

    normal: Array
    offset: float


def view_frame(view: View) -> Array:
    """Rows: unit vectors to the right, up, and towards the eye. z is up, or y in views along z."""
    towards_eye = _direction(view)
    z = towards_eye / np.linalg.norm(towards_eye)
    x = np.cross([0.0, 0.0, 1.0], z)
    if np.linalg.norm(x) < EDGE_ON:
        x = np.array([1.0, 0.0, 0.0])
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z])


def section_planes(section: Any, towards_eye: Array, low: Array, high: Array) -> tuple[SectionPlane, ...]:
    """The planes of a request for sections of a model in the box [low, high]; InvalidRequest if one is not understood.

    section: None, "z=5", "z" for the middle, several separated by commas, (point, normal), or an iterable of these. Planes
    given by an axis face the eye; a normal is taken as it is.
    """
    if section is None:
        return ()
    if isinstance(section, str):
        return tuple(_plane_across_axis(part, towards_eye, low, high) for part in section.split(","))
    if isinstance(section, Iterable):
        parts = list(section)
        if len(parts) == 2 and all(_is_vector(part) for part in parts):
            point, normal = (np.asarray(part, float) for part in parts)
            length = float(np.linalg.norm(normal))
            if length == 0.0:
                raise InvalidRequest("the normal of a section plane must not be zero")
            return (SectionPlane(normal / length, float(normal @ point) / length),)
        if parts and not all(np.isscalar(part) and not isinstance(part, str) for part in parts):
            return tuple(plane for part in parts for plane in section_planes(part, towards_eye, low, high))
    raise InvalidRequest(f'section {section!r} is not understood: give "z=5", "z" for the middle, or (point, normal)')


def require_cuts(planes: Sequence[SectionPlane], low: Array, high: Array) -> None:
    """InvalidRequest for a plane that passes beside the box [low, high]."""
    corners = np.array(np.meshgrid(*np.transpose([low, high]))).reshape(3, -1)
    for plane in planes:
        height = plane.normal @ corners - plane.offset
        if height.min() > 0 or height.max() < 0:
            x0, y0, z0, x1, y1, z1 = (f"{value:.6g}" for value in (*low, *high))
            raise InvalidRequest(
                f"a section plane passes beside the part, which lies between ({x0}, {y0}, {z0}) and ({x1}, {y1}, {z1}): give a "
                "position between these"
            )


def _plane_across_axis(text: str, towards_eye: Array, low: Array, high: Array) -> SectionPlane:
    """The plane "z=5", or "z" for the middle of the box."""
    name, equals, value = (part.strip() for part in text.lower().partition("="))
    axis = "xyz".find(name) if len(name) == 1 else -1
    try:
        offset = float(value) if equals else 0.5 * float(low[axis] + high[axis])
    except ValueError:
        offset = np.nan
    if axis < 0 or not np.isfinite(offset):
        raise InvalidRequest(f'section {text!r} is not understood: give an axis and a position, such as "z=5"')
    sign = -1.0 if towards_eye[axis] < -EDGE_ON else 1.0
    return SectionPlane(sign * np.eye(3)[axis], sign * offset)


def _direction(view: View) -> Array:
    """The direction (3,) from the model to the eye."""
    if isinstance(view, str):
        named = VIEWS.get(view.lower())
        if named is not None:
            return np.array(named)
        parts: Sequence[Any] = view.split(",")
    else:
        parts = view
    try:
        direction = np.asarray([float(part) for part in parts])
    except (TypeError, ValueError):
        direction = np.zeros(0)
    if direction.shape != (3,) or not np.isfinite(direction).all() or not direction.any():
        raise InvalidRequest(
            f"view {view!r} is unknown: choose one of {', '.join(VIEWS)}, or a direction such as 1,-1,0.5"
        )
    return direction


def _is_vector(value: Any) -> bool:
    """Whether the value is three finite numbers."""
    try:
        return np.asarray(value, float).shape == (3,) and bool(np.isfinite(np.asarray(value, float)).all())
    except (TypeError, ValueError):
        return False
