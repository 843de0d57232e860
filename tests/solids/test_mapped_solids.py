"""Fields in a trivariate design domain: the solid is the image of that in the box, to the tolerance, with the same topology."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import BSpline

import tpmscad
from tpmscad import fields, maps
from tpmscad.errors import InvalidRequest

pytestmark = [pytest.mark.kernel, pytest.mark.slow]


def bulged() -> maps.SplineMap:
    """A cubic solid of 20 x 18 x 25 mm, none of whose faces is plane but two."""
    x, y, z = np.meshgrid(*[np.linspace(0, 1, 4)] * 3, indexing="ij")
    return maps.trivariate(np.stack([20 * x + 3 * z**2, 18 * y + 2 * x * z, 25 * z + 4 * x * y], axis=-1))


@pytest.fixture(scope="module")
def ball_pit() -> tuple[maps.SplineMap, tpmscad.Model]:
    """The domain without a ball that its face w = 1 cuts, and without one inside."""
    hole = fields.sphere((0.5, 0.6, 1.0), 0.3) | fields.sphere((0.4, 0.4, 0.35), 0.2)
    map = bulged()
    return map, tpmscad.solidify(~hole, map, tol=0.02, progress=False)


def test_the_certificate_is_met_with_the_topology_of_the_domain(ball_pit) -> None:
    map, model = ball_pit
    c = model.certificate
    assert c.met, c.shortfalls
    assert c.betti == (1, 0, 1)
    assert c.valid
    assert 0 < c.max_deviation <= 0.02
    assert c.figures["least Jacobian determinant of the map, proved"] == map.least_jacobian


def test_the_volume_is_the_integral_of_the_jacobian(ball_pit) -> None:
    map, model = ball_pit
    n = 50
    t = (np.arange(n) + 0.5) / n
    points = np.stack(np.meshgrid(t, t, t, indexing="ij"), axis=-1).reshape(-1, 3)
    hole = (np.linalg.norm(points - [0.5, 0.6, 1.0], axis=1) < 0.3) | (
        np.linalg.norm(points - [0.4, 0.4, 0.35], axis=1) < 0.2
    )
    volume = (np.linalg.det(map.jacobian(points, 1.0)) * ~hole).mean()
    assert model.certificate.volume == pytest.approx(volume, rel=2e-3)


def test_caps_lie_in_the_boundary_surfaces_and_patches_on_the_image_of_the_field(ball_pit) -> None:
    map, model = ball_pit
    points = np.concatenate(
        [np.array([tuple(f.position_at(0.5, 0.5))]) for f in model.solid.faces() if f.geom_type.name == "BSPLINE"]
    )
    at = np.full_like(points, 0.5)
    for _ in range(20):
        at = np.clip(at + np.linalg.solve(map.jacobian(at, 1.0), (points - map(at))[..., None])[..., 0], -0.1, 1.1)
    on_boundary = np.minimum(np.abs(at), np.abs(at - 1)).min(axis=1) < 1e-6
    on_balls = np.minimum(
        np.abs(np.linalg.norm(at - [0.5, 0.6, 1.0], axis=1) - 0.3),
        np.abs(np.linalg.norm(at - [0.4, 0.4, 0.35], axis=1) - 0.2),
    )
    assert (on_boundary | (25 * on_balls < 0.03)).all()
    assert on_boundary.any()


def test_a_file_of_it_is_read_back_whole(ball_pit, tmp_path) -> None:
    _, model = ball_pit
    model.export_step(tmp_path / "domain.step")
    report = tpmscad.check_step(tmp_path / "domain.step")
    assert report.ok


def test_a_closed_domain_is_refused_for_fields() -> None:
    n = 12
    angle, radius, height = np.meshgrid(-np.arange(n + 3) * 2 * np.pi / n, [10.0, 15.0], [0.0, 5.0], indexing="ij")
    net = np.stack([radius * np.cos(angle), radius * np.sin(angle), height], axis=-1)
    periodic = BSpline(np.arange(-3.0, n + 4.0), net, 3)
    t = np.concatenate([[0.0] * 4, np.arange(1.0, n), [float(n)] * 4])
    sites = np.array([t[i + 1 : i + 4].mean() for i in range(n + 3)])
    poles = np.linalg.solve(BSpline(t, np.eye(n + 3), 3)(sites), periodic(sites).reshape(n + 3, -1)).reshape(
        n + 3, 2, 2, 3
    )
    ring = maps.trivariate(poles, [t, [0, 0, 1, 1], [0, 0, 1, 1]], (3, 1, 1))
    assert ring.closed == (True, False, False)
    with pytest.raises(InvalidRequest, match="closes along u"):
        tpmscad.solidify(fields.sphere((1.0, 0.5, 0.5), 0.2), ring, tol=0.1)
