"""The triangles of fields of struts and meshes without their solid: balls and cones that may overlap, united by Manifold."""

from __future__ import annotations

import math
from functools import partial

import numpy as np

from tpmscad._typing import Array
from tpmscad.brep.triangles.closed_mesh import SolidMesh, combine_meshes
from tpmscad.fields.analysis.exact_leaves import StrutLeaf, find_exact
from tpmscad.fields.analysis.outermost_extremes import combine_complements
from tpmscad.fields.field import Field, MinMaxField, ScaledField
from tpmscad.fields.kinds.beam_lattices import BeamsField
from tpmscad.fields.kinds.strut_graphs import StrutsField
from tpmscad.fields.kinds.triangle_meshes import MeshField

LEAST_SIDES = 8
"""Corners of the circles of struts: at least so many, and a multiple of four."""


def triangulate_tree(field: Field, deviation: float) -> tuple[SolidMesh, bool, float]:
    """The triangles of a field of struts and meshes (`is_of_struts`), whether its complement is meant, and their deviation."""
    if isinstance(field, BeamsField):
        return triangulate_tree(field.field, deviation)
    if isinstance(field, MeshField):
        own = field.mesh
        return SolidMesh(own.vertices, own.triangles, np.zeros(len(own.triangles), np.int64)), False, 0.0
    if isinstance(field, MinMaxField):
        one, other = (triangulate_tree(part, deviation) for part in (field.first, field.second))
        mesh, complement = combine_complements(
            field.sign,
            [one[:2], other[:2]],
            unite=partial(combine_meshes, "union"),
            intersect=partial(combine_meshes, "intersection"),
            subtract=lambda first, others: combine_meshes("difference", [first, *others]),
        )
        return mesh, complement, max(one[2], other[2])
    found = find_exact(field)
    if isinstance(found, StrutLeaf):
        made, reached = triangulate_struts(found.struts, deviation)
        return made, found.sign < 0, reached
    assert isinstance(field, ScaledField)
    mesh, complement, reached = triangulate_tree(field.field, deviation)
    return mesh, complement != (field.factor < 0), reached


def triangulate_struts(field: StrutsField, deviation: float) -> tuple[SolidMesh, float]:
    """The closed triangles of struts, and the greatest distance of the triangles from the surfaces of struts and balls.

    Corners lie outside of the surfaces, and middles of triangles inside, so that the volumes of struts are kept.
    """
    parts, reached = [], 0.0
    for point, radius in zip(field.points, field.balls.tolist(), strict=True):
        sides = _count_sides(radius, deviation)
        latitudes = np.linspace(-math.pi / 2, math.pi / 2, sides // 2 + 1)
        factor = 2 / (
            1 + math.cos(math.pi / sides) ** 2
        )  # between meridians and parallels the middle is cos^2 as far away
        profile = factor * radius * np.column_stack([np.sin(latitudes), np.cos(latitudes)])
        parts.append(_revolve(point, np.array([0.0, 0.0, 1.0]), profile, sides))
        reached = max(reached, (factor - 1) * radius)
    for (i, j), (first, last) in zip(field.edges.tolist(), field.radii.tolist(), strict=True):
        along = field.points[j] - field.points[i]
        length = float(np.linalg.norm(along))
        sine = (first - last) / length
        if abs(sine) >= 1:  # one ball holds the other
            continue
        sides = _count_sides(max(first, last), deviation)
        factor = math.sqrt(2 * math.pi / sides / math.sin(2 * math.pi / sides))  # the polygon has the circle's area
        away = factor * math.sqrt(1 - sine * sine)
        low, high = first * sine, length + last * sine  # where the cone touches its balls
        profile = np.array([[low, 0.0], [low, first * away], [high, last * away], [high, 0.0]])
        parts.append(_revolve(field.points[i], along / length, profile, sides))
        reached = max(reached, (factor - 1) * max(first, last))
    return combine_meshes("union", parts), reached


def _count_sides(radius: float, deviation: float) -> int:
    """Corners of circles at which triangles of a ball of a radius, half outside and half inside, deviate so much at most."""
    least = max(0.0, 2 / (1 + deviation / radius) - 1)
    return max(LEAST_SIDES, 4 * math.ceil(math.pi / math.acos(math.sqrt(least)) / 4))


def _revolve(origin: Array, axis: Array, profile: Array, sides: int) -> SolidMesh:
    """The triangles of a solid of revolution, of heights and radii (n, 2) that begin and end on the axis."""
    x_axis = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    x_axis /= np.linalg.norm(x_axis)
    turn = 2 * math.pi * np.arange(sides)[:, None] / sides
    circle = np.cos(turn) * x_axis + np.sin(turn) * np.cross(axis, x_axis)
    rings = profile[1:-1, :1, None] * axis + profile[1:-1, 1:, None] * circle
    ends = profile[[0, -1], :1] * axis
    points = origin + np.concatenate([rings.reshape(-1, 3), ends])
    own, following = np.arange(sides), np.roll(np.arange(sides), -1)
    low, high = len(points) - 2, len(points) - 1
    top = sides * (len(profile) - 3)
    triangles = [np.column_stack([np.full(sides, low), following, own])]
    for first in range(0, top, sides):
        a, b, c, d = own + first, following + first, following + first + sides, own + first + sides
        triangles += [np.column_stack([a, b, c]), np.column_stack([a, c, d])]
    triangles.append(np.column_stack([own + top, following + top, np.full(sides, high)]))
    found = np.concatenate(triangles)
    return SolidMesh(points, found, np.zeros(len(found), np.int64))
