"""Foot points of spline surfaces, as the rows of implicit surfaces ask for them: derivatives, cells, and steps."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tests.brep import test_surface_feet
from tests.brep.test_surface_feet import beside, points_about, wave, with_poles
from tpmscad._typing import Array
from tpmscad.brep.foot_cells import prepare_foot_surface
from tpmscad.brep.foot_points import find_foot_points
from tpmscad.brep.free_form_surface import FreeFormSurface
from tpmscad.splines.bspline import BSplineSurface
from tpmscad.splines.knots import insert_knot

carrier = test_surface_feet.carrier


def test_derivatives_are_those_of_the_values(carrier: FreeFormSurface) -> None:
    points, *_ = beside(carrier, 60)
    h = 1e-4

    def slope(values: Callable[[Array], Array]) -> Array:
        """Fourth-order differences along x, y and z."""
        return np.stack(
            [
                (
                    8 * (values(points + h * e) - values(points - h * e))
                    - values(points + 2 * h * e)
                    + values(points - 2 * h * e)
                )
                / (12 * h)
                for e in np.eye(3)
            ],
            axis=-1,
        )

    size = max(1.0, np.abs(carrier.hessian(points)).max())
    np.testing.assert_allclose(carrier.gradient(points), slope(carrier.distance), atol=2e-10 * size**2)
    np.testing.assert_allclose(carrier.hessian(points), slope(carrier.gradient), atol=2e-9 * size**3)


def test_each_cell_lies_in_its_ball_and_its_box(carrier: FreeFormSurface) -> None:
    surface = prepare_foot_surface(carrier.spline, carrier.closed, 0.05)
    spans, cells = surface.spans, surface.cells
    rng = np.random.default_rng(4)
    u, v = (rng.uniform(*interval, 5000) for interval in spans.box)
    cell = (np.searchsorted(cells.lines_u, u) - 1) * (len(cells.lines_v) - 1) + np.searchsorted(cells.lines_v, v) - 1
    arm = carrier.spline(u + surface.origin[0], v + surface.origin[1]) - surface.centre - cells.point[cell]
    assert (np.linalg.norm(arm, axis=1) <= cells.radius[cell]).all()
    inside = np.einsum("nrc,nc->nr", cells.axes[cell], arm)
    assert (inside >= cells.low[cell]).all()
    assert (inside <= cells.high[cell]).all()
    np.testing.assert_allclose(
        cells.axes @ cells.axes.swapaxes(1, 2), np.broadcast_to(np.eye(3), cells.axes.shape), atol=1e-12
    )


def test_cells_do_not_follow_short_spans() -> None:
    spline = with_poles(wave, (4, 3), (3, 2))
    poles, knots = spline.poles, spline.knots_u
    for t in np.linspace(0.31, 0.32, 60):
        poles, knots = insert_knot(poles, knots, 3, t)
    refined = BSplineSurface(poles, knots, spline.knots_v, 3, 2)
    one, other = prepare_foot_surface(spline), prepare_foot_surface(refined)
    assert len(other.spans.breaks_u) == len(one.spans.breaks_u) + 60
    assert abs(len(other.cells.radius) - len(one.cells.radius)) < 0.1 * len(one.cells.radius)
    points = points_about(FreeFormSurface(spline), 1000)
    found = find_foot_points(other, points)
    assert found.failures == 0
    np.testing.assert_allclose(
        np.abs(found.distance), np.abs(find_foot_points(one, points).distance), rtol=0, atol=1e-12
    )


def test_a_run_needs_few_steps_and_most_points_one_run(carrier: FreeFormSurface) -> None:
    points, *_ = beside(carrier, 2000)
    found = carrier.foot_points(points)
    assert found.runs.mean() < 1.6
    assert (found.steps / found.runs).mean() < 8
