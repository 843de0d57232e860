"""Pictures of a quantity that depends on direction, such as stiffness: the surface that has it as its radius."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from OCP.BRepPrimAPI import BRepPrimAPI_MakeSphere

from tpmscad._typing import Array
from tpmscad.kernel.render.palette import ColourScale
from tpmscad.kernel.render.picture import draw_scene
from tpmscad.kernel.render.scene import Scene
from tpmscad.kernel.render.viewpoints import View

FACET_ANGLE = 0.05
"""Radians between neighbouring facets of the sphere of directions."""

STEP = 1e-5
"""Radians between directions whose radii give the slope: the cube root of round-off, about."""


def draw_polar_surface(
    radius: Callable[[Array], Array], title: str, *, view: View, section: Any, size: tuple[int, int]
) -> bytes:
    """The bytes of a PNG picture of the surface with a positive radius (n,) along unit vectors (n, 3), coloured by radius."""
    scene = make_polar_surface(radius)
    assert scene.values is not None
    least, greatest = float(scene.values.min()), float(scene.values.max())
    scale = ColourScale(title, least, greatest, least, greatest)
    return draw_scene(scene, view=view, section=section, size=size, scale=scale, axes=True)


def make_polar_surface(radius: Callable[[Array], Array]) -> Scene:
    """The surface as triangles, with the radius as its values."""
    sphere = Scene.of_pieces([BRepPrimAPI_MakeSphere(1.0).Shape()], angle=FACET_ANGLE)
    directions = sphere.points / np.linalg.norm(sphere.points, axis=1, keepdims=True)
    values = radius(directions)
    normals = values[:, None] * directions - _surface_gradient(radius, directions)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return replace(sphere, points=values[:, None] * directions, normals=normals, values=values)


def _surface_gradient(radius: Callable[[Array], Array], directions: Array) -> Array:
    """Gradient (n, 3) of the radius on the unit sphere, by central differences."""
    across = np.eye(3)[np.abs(directions).argmin(axis=1)]
    first = np.cross(directions, across)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    gradient = np.zeros_like(directions)
    for tangent in (first, np.cross(directions, first)):
        ahead, behind = (directions + sign * STEP * tangent for sign in (1.0, -1.0))
        scale = np.linalg.norm(ahead, axis=1, keepdims=True)
        slope = (radius(ahead / scale) - radius(behind / scale)) / (2.0 * STEP)
        gradient += slope[:, None] * tangent
    return gradient
