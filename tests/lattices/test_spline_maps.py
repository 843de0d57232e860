"""Trivariate splines as maps: exact Jacobians, a proved bound, folds and overlaps refused with their place."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest
from scipy.interpolate import BSpline

from tests.splines.test_common_space import clamped
from tpmscad import maps
from tpmscad.errors import InvalidRequest

RNG = np.random.default_rng(3)


def control_net(shape: tuple[int, int, int], warp: float = 0.2) -> np.ndarray:
    """A net over a box of 8 x 6 x 10, its poles moved by up to `warp` of their spacing."""
    axes = [np.linspace(0, 1, n) for n in shape]
    net = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    moved = net + warp * (RNG.random(net.shape) - 0.5) / np.array(shape)
    return moved * np.array([8.0, 6.0, 10.0])


@lru_cache(1)
def uneven() -> maps.SplineMap:
    """Unequal degrees, spans and numbers of poles along the three axes."""
    return maps.trivariate(
        control_net((4, 5, 6)), [clamped(3, []), clamped(2, [0.3, 0.6]), clamped(3, [0.4, 0.7])], (3, 2, 3)
    )


def test_the_jacobian_is_the_derivative_inside_and_beyond_the_domain() -> None:
    map, h = uneven(), 1e-5
    points = 1.2 * RNG.random((60, 3)) - 0.1
    points = points[(np.abs(points[:, :, None] - [0.3, 0.4, 0.6, 0.7]) > 1e-3).all(axis=(1, 2))]
    for axis in range(3):
        step = h * np.eye(3)[axis]
        difference = (map(points + step) - map(points - step)) / (2 * h)
        np.testing.assert_allclose(map.jacobian(points, 1.0)[..., axis], difference, rtol=0, atol=1e-6)


def test_a_point_is_the_sum_of_basis_functions_times_poles() -> None:
    map = uneven()
    volume, points = map.volume, RNG.random((20, 3))
    basis = [
        BSpline(k, np.eye(n), p)(x)
        for k, p, n, x in zip(volume.knots, volume.degrees, volume.poles.shape, points.T, strict=False)
    ]
    np.testing.assert_allclose(map(points), np.einsum("ni,nj,nk,ijkd->nd", *basis, volume.poles), atol=1e-13)


def test_the_least_jacobian_is_a_lower_bound_and_close() -> None:
    map = uneven()
    values = np.linalg.det(map.jacobian(RNG.random((20_000, 3)), 1.0))
    assert 0 < map.least_jacobian <= values.min()
    box = maps.trivariate(np.stack(np.meshgrid([0, 2.0], [0, 3.0], [0, 5.0], indexing="ij"), axis=-1))
    assert box.least_jacobian == pytest.approx(30)


def test_a_block_of_cells_fills_the_domain() -> None:
    map, size = uneven(), np.array([20.0, 30.0, 10.0])
    block = map.over_block(size)
    points = RNG.random((10, 3))
    np.testing.assert_allclose(block(size * points), map(points), atol=1e-12)
    np.testing.assert_allclose(block.jacobian(size * points, 1.0) * size, map.jacobian(points, 1.0), atol=1e-11)


def spiral(turns: float) -> maps.SplineMap:
    """A bar of 5 x 5 bent around the z axis."""
    n = 12
    angle, radius, height = np.meshgrid(np.linspace(0, 2 * np.pi * turns, n), [10.0, 15.0], [0.0, 5.0], indexing="ij")
    net = np.stack([radius * np.cos(angle), -radius * np.sin(angle), height], axis=-1)
    return maps.trivariate(net, [clamped(3, [*np.linspace(0, 1, 10)[1:-1]]), clamped(1, []), clamped(1, [])], (3, 1, 1))


def test_a_map_that_is_regular_everywhere_but_lies_on_itself_is_refused_with_the_place() -> None:
    assert spiral(0.9).least_jacobian > 0
    with pytest.raises(InvalidRequest, match=r"lies on itself: \(.*\) in the model is the image of \(.*\) and of \("):
        spiral(1.2)


def test_a_map_that_almost_comes_to_a_point_is_refused_with_the_place() -> None:
    net = np.stack(np.meshgrid([0, 1.0], [0, 2.0], [0, 3.0], indexing="ij"), axis=-1)
    net[:, :, 0, :2] *= 1e-9
    with pytest.raises(
        InvalidRequest, match=r"too close to zero to be proved positive: 6e-18 at \(0, 0, 0\) in its domain"
    ):
        maps.trivariate(net)


def test_a_fold_is_refused_with_its_place() -> None:
    net = control_net((4, 4, 4), 0.0)
    net[3, 3, 3] = net[1, 1, 1]
    with pytest.raises(
        InvalidRequest, match=r"folds: .* at \(1, 1, 1\) in its domain, \(2.667, 2, 3.333\) in the model"
    ):
        maps.trivariate(net)
    with pytest.raises(InvalidRequest, match="reverse one axis"):
        maps.trivariate(control_net((4, 4, 4))[::-1])


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"degrees": (3, 3, 4)}, "degree 4 along w must be .* below the number of poles, 4"),
        ({"knots": [clamped(3, [])] * 2}, "must be three knot vectors"),
        ({"knots": [clamped(3, []), clamped(3, [0.5]), clamped(3, [])]}, "4 poles of degree 3 along v need 8 knots"),
        ({"knots": [[0, 0, 0, 0, 1, 1, 1, 0.5]] * 3}, "knots along u must be finite and must not decrease"),
        (
            {
                "poles": control_net((4, 5, 4)),
                "knots": [clamped(3, []), clamped(2, [0.5, 0.5]), clamped(3, [])],
                "degrees": (3, 2, 3),
            },
            "a knot along v is repeated 2 times at degree 2: the map must be smooth",
        ),
        ({"knots": [[0, 0, 0, 1, 1, 2, 2, 2]] * 3}, "must be repeated 4 times"),
        ({"poles": np.zeros((4, 4, 4, 2))}, "three coordinates"),
    ],
)
def test_knots_and_degrees_that_do_not_fit_are_refused(change: dict[str, object], match: str) -> None:
    with pytest.raises(InvalidRequest, match=match):
        maps.trivariate(**{"poles": control_net((4, 4, 4)), **change})  # type: ignore[arg-type]
