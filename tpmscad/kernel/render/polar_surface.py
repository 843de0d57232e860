"""Pictures of a quantity that depends on direction, such as stiffness: the surface that has it as its radius."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from OCP.BRepPrimAPI import BRepPrimAPI_MakeSphere

from tpmscad._typing import Array, IntArray
from tpmscad.kernel.render.palette import ColourScale
from tpmscad.kernel.render.picture import draw_scene
from tpmscad.kernel.render.scene import Scene
from tpmscad.kernel.render.viewpoints import View

FACET_ANGLE = 0.03
"""Radians between neighbouring facets of the sphere of directions."""

DIRECTION_DECIMALS = 9
"""Decimals up to which directions are the same: the sphere repeats its points at seam and poles."""


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
    points = values[:, None] * directions
    normals = _normals(points, directions, sphere.triangles)
    return replace(sphere, points=points, normals=normals, values=values)


def _normals(points: Array, directions: Array, triangles: IntArray) -> Array:
    """Unit normals (n, 3): the mean of those of the triangles around each direction, weighted by area."""
    _, same = np.unique(directions.round(DIRECTION_DECIMALS) + 0.0, axis=0, return_inverse=True)
    a, b, c = (points[triangles[:, k]] for k in range(3))
    sums = np.zeros((same.max() + 1, 3))
    for corner in triangles.T:
        np.add.at(sums, same.ravel()[corner], np.cross(b - a, c - a))
    normals = sums[same.ravel()]
    return np.asarray(normals / np.linalg.norm(normals, axis=1, keepdims=True))
