"""Marching of free-form distances: the arcs of quadrics where there are no jumps, ends at masks, and parts next to faces."""

from __future__ import annotations

import numpy as np
import pytest

from tpmscad._typing import Array
from tpmscad.brep.carriers import Plane
from tpmscad.brep.free_form_surface import FreeFormSurface
from tpmscad.errors import TrimmingError
from tpmscad.splines.bspline import BSplineSurface
from tpmscad.splines.knots import bezier_knots
from tpmscad.trimming.intersect.curve_surface import bracketed_newton
from tpmscad.trimming.intersect.marching import Trace, march_patch
from tpmscad.trimming.intersect.marching_masked import march_masked_patches
from tpmscad.trimming.intersect.patch_borders import BorderSide
from tpmscad.trimming.operands.quadric_table import QuadricTable, build_implicit_surfaces

NORMAL = np.array([0.48, 0.6, 0.64])
X = np.array([0.8, 0.0, -0.6])
NO_CORNERS = np.zeros(4, bool)


def saddle_patch() -> BSplineSurface:
    """A bent patch of degrees 3 and 2 about the origin, with unequal sides."""
    u, v = np.meshgrid(np.linspace(-1.2, 1.2, 4), np.linspace(-0.9, 0.9, 3), indexing="ij")
    return BSplineSurface(np.stack([u, v, 0.4 * u * v + 0.2 * u], axis=2), bezier_knots(3), bezier_knots(2), 3, 2)


def sheet(size: float) -> FreeFormSurface:
    """The square of half a side `size` in the plane through the origin with NORMAL, as a free-form surface."""
    y = np.cross(NORMAL, X)
    s, t = np.meshgrid([-size, size], [-size, size], indexing="ij")
    return FreeFormSurface(BSplineSurface(s[..., None] * X + t[..., None] * y, bezier_knots(1), bezier_knots(1), 1, 1))


def read_borders(patch: BSplineSurface, row: QuadricTable, within: float = np.inf) -> tuple[BorderSide, ...]:
    """The roots along the sides, found by bisection of samples; those farther from the origin than `within` are left out."""
    result = []
    for side in range(4):
        curve = patch.side(side)
        low, high = curve.domain
        x = np.linspace(0.0, 1.0, 400)

        def value(at: Array, curve=curve, low: float = low, high: float = high) -> Array:
            return row.value(curve(low + (high - low) * at)[None])[0]

        def slope(at: Array, curve=curve, low: float = low, high: float = high) -> Array:
            point = low + (high - low) * at
            gradient = row.jet(curve(point)[None], 1)[1][0]
            return (high - low) * np.einsum("nk,nk->n", gradient, curve(point, 1))

        d = value(x)
        i = np.flatnonzero((d[1:] < 0) != (d[:-1] < 0))
        roots = bracketed_newton(value, slope, x[i], x[i + 1])
        points = curve(low + (high - low) * roots).reshape(-1, 3)
        roots = roots[np.linalg.norm(points, axis=1) < within]
        result.append(BorderSide(roots, -1 if d[0] < 0 else 1))
    return tuple(result)


def march(patch: BSplineSurface, surface: FreeFormSurface, within: float = np.inf, near: float = np.inf) -> Trace:
    """The trace next to a face that reaches to the distance `near` from the origin."""

    def border_distance(points: Array) -> Array:
        return np.asarray(np.linalg.norm(points, axis=1) - near)

    row = build_implicit_surfaces([surface])
    borders = read_borders(patch, row, within)
    return march_masked_patches([patch], row, [borders], NO_CORNERS[None], 1e-9, [border_distance])[0]


def test_a_wide_sheet_has_the_arcs_of_its_plane() -> None:
    patch, plane = saddle_patch(), build_implicit_surfaces([Plane(np.zeros(3), X, NORMAL)])
    expected = march_patch(patch, plane, read_borders(patch, plane), NO_CORNERS, 1e-9)
    found = march(patch, sheet(5.0))
    assert len(found.arcs) == len(expected.arcs) > 0
    for mine, theirs in zip(found.arcs, expected.arcs, strict=True):
        assert (mine.start, mine.end) == (theirs.start, theirs.end)
        np.testing.assert_allclose(mine.path[[0, -1]], theirs.path[[0, -1]], atol=1e-12)
        # inner points are interpolated along edges of the same grid, but the free-form distance is not linear in the poles
        np.testing.assert_allclose(mine.path, theirs.path, atol=1e-9)


def test_a_branch_ends_at_a_point_where_the_sheet_ends() -> None:
    patch, size = saddle_patch(), 0.4
    found = march(patch, sheet(size), within=size)
    (arc,) = found.arcs
    assert arc.start[0] == arc.end[0] == "point"
    ends = patch(*found.points.T)
    np.testing.assert_allclose(ends @ NORMAL, 0.0, atol=1e-13)
    y = np.cross(NORMAL, X)
    reach = np.abs(np.column_stack([ends @ X, ends @ y])).max(axis=1)
    assert (reach < size).all()
    assert (reach > 0.75 * size).all()


@pytest.mark.parametrize("width", [0.1, 0.02])
def test_the_branch_across_a_strip_that_is_narrower_than_a_cell_crosses_both_of_its_edges(width: float) -> None:
    patch, plane = saddle_patch(), build_implicit_surfaces([Plane(np.zeros(3), X, NORMAL)])
    (arc,) = march_patch(patch, plane, read_borders(patch, plane), NO_CORNERS, 1e-9).arcs
    path = patch(*arc.path.T)
    middle, along = path[len(path) // 2], path[len(path) // 2 + 1] - path[len(path) // 2 - 1]
    along = along / np.linalg.norm(along)
    s, t = np.meshgrid([-0.2, 0.2], [-width, width], indexing="ij")  # the face is half as wide as its surface
    poles = middle + s[..., None] * np.cross(NORMAL, along) + t[..., None] * along
    strip = FreeFormSurface(BSplineSurface(poles, bezier_knots(1), bezier_knots(1), 1, 1))
    row = build_implicit_surfaces([strip])

    def border_distance(points: Array) -> Array:
        return np.asarray(np.abs((points - middle) @ along) - width / 2)

    borders = (BorderSide(np.zeros(0), 1),) * 4
    (found,) = march_masked_patches([patch], row, [borders], NO_CORNERS[None], 1e-9, [border_distance])
    (own,) = found.arcs
    reach = (patch(*own.path.T) - middle) @ along
    assert reach.min() < -width / 2
    assert reach.max() > width / 2


def test_only_what_is_next_to_faces_is_kept() -> None:
    patch, near = saddle_patch(), 0.3
    whole, part = march(patch, sheet(5.0)), march(patch, sheet(5.0), near=near)
    lengths = []
    for trace in (whole, part):
        (arc,) = trace.arcs
        lengths.append(np.linalg.norm(patch(*arc.path.T), axis=1))
    assert lengths[0].max() > 1.0
    assert lengths[1].max() < 0.7
    assert (lengths[1][[0, -1]] > near).all()
    assert march(patch, sheet(5.0), near=-5.0).arcs == ()


def closed_branch() -> tuple[BSplineSurface, FreeFormSurface]:
    """A bowl, and a sheet that cuts it below its rim."""
    u, v = np.meshgrid(np.linspace(-1.0, 1.0, 3), np.linspace(-0.8, 0.8, 3), indexing="ij")
    height = np.array([1.0, -1.0, 1.0])
    bowl = np.stack([u, v, height[:, None] + 0.8 * height], axis=2)
    s, t = np.meshgrid([-3.0, 3.0], [-3.0, 3.0], indexing="ij")
    flat = BSplineSurface(np.stack([s, t, np.full((2, 2), 0.3)], axis=2), bezier_knots(1), bezier_knots(1), 1, 1)
    return BSplineSurface(bowl, bezier_knots(2), bezier_knots(2), 2, 2), FreeFormSurface(flat)


def test_a_closed_branch_is_two_arcs_between_two_points() -> None:
    patch, surface = closed_branch()
    found = march(patch, surface)
    assert [(a.start[1], a.end[1]) for a in found.arcs] == [(0, 1), (1, 0)]
    np.testing.assert_array_equal(found.arcs[0].path[-1], found.arcs[1].path[0])
    np.testing.assert_array_equal(found.arcs[1].path[-1], found.arcs[0].path[0])
    np.testing.assert_allclose(patch(*found.points.T)[:, 2], 0.3, atol=1e-13)


def test_a_side_or_a_corner_in_the_surface_is_refused() -> None:
    patch = saddle_patch()
    row = build_implicit_surfaces([sheet(5.0)])
    borders = read_borders(patch, row)
    with pytest.raises(TrimmingError, match="corner of a patch"):
        march_masked_patches([patch], row, [borders], np.eye(4, dtype=bool)[:1], 1e-9, [lambda p: -np.ones(len(p))])
