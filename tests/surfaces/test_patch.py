"""Laws of the patches: geometry of minimal surfaces and level sets, joints with the neighbours, offsets and their limit."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.spatial import cKDTree

from tpmscad import surfaces
from tpmscad.errors import InvalidRequest
from tpmscad.surfaces.differential_geometry import maximise_on_unit_square

NAMES = [info.name for info in surfaces.CATALOGUE.values() if info.primitives == "exact"]
BOTH = list(itertools.product(NAMES, ("minimal", "nodal")))
U, V = np.meshgrid(np.linspace(0, 1, 23), np.linspace(0, 1, 19), indexing="ij")
OFFSETS = (0.0, 0.12, -0.14)
SIDES = {  # start of the side, its direction and the outward direction, in (u, v)
    0: ((0, 0), (1, 0), (0, -1)),
    1: ((1, 0), (0, 1), (1, 0)),
    2: ((1, 1), (-1, 0), (0, 1)),
    3: ((0, 1), (0, -1), (-1, 0)),
}


def formula(name: str):
    """The catalogue's printed formula as a function of points in cells."""

    def f(points: np.ndarray) -> np.ndarray:
        angles = dict(zip("xyz", np.moveaxis(2 * np.pi * points, -1, 0), strict=True))
        return eval(surfaces.CATALOGUE[name].formula, {"sin": np.sin, "cos": np.cos} | angles)

    return f


def along_gradient(f, points: np.ndarray, direction: np.ndarray, h: float = 1e-4) -> np.ndarray:
    return (f(points + h * direction) - f(points - h * direction)) / (2 * h)


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return (a * b).sum(axis=-1)


def curvatures(jet: surfaces.SurfaceJet) -> tuple[np.ndarray, np.ndarray]:
    """Mean and Gauss curvature from position derivatives alone (do Carmo, section 3.3)."""
    normal = np.cross(jet.du, jet.dv)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    e, f, g = dot(jet.du, jet.du), dot(jet.du, jet.dv), dot(jet.dv, jet.dv)
    ee, ff, gg = dot(jet.duu, normal), dot(jet.duv, normal), dot(jet.dvv, normal)
    area = e * g - f * f
    return (e * gg - 2 * f * ff + g * ee) / (2 * area), (ee * gg - ff * ff) / area


def differences(f, h: float = 4e-3) -> np.ndarray:
    """f' at 0, eighth order."""
    weights = (4 / 5, -1 / 5, 4 / 105, -1 / 280)
    return sum(w * (f(k * h) - f(-k * h)) for k, w in enumerate(weights, 1)) / h


@pytest.mark.parametrize(("name", "reference"), BOTH)
@pytest.mark.parametrize("offset", OFFSETS)
def test_the_normal_is_unit_and_normal_and_du_dv_n_is_right_handed(name: str, reference: str, offset: float) -> None:
    jet = surfaces.primitive_patch(name, reference).jet(U, V, offset)
    np.testing.assert_allclose(dot(jet.normal, jet.normal), 1, rtol=0, atol=1e-14)
    for tangent in (jet.du, jet.dv):
        np.testing.assert_allclose(dot(jet.normal, tangent), 0, rtol=0, atol=1e-14)
    assert (dot(np.cross(jet.du, jet.dv), jet.normal) > 0).all()
    assert surfaces.patch_symmetry(name).handedness == 1


@pytest.mark.parametrize("name", NAMES)
def test_the_minimal_surface_has_no_mean_curvature_and_its_offsets_steiners(name: str) -> None:
    surface = surfaces.primitive_patch(name)
    mean, gauss = curvatures(surface.jet(U, V))
    np.testing.assert_allclose(mean, 0, rtol=0, atol=1e-11)
    np.testing.assert_array_less(gauss, 1e-12)
    for d in OFFSETS:
        mean_d, gauss_d = curvatures(surface.jet(U, V, d))
        shrink = 1 + gauss * d**2
        np.testing.assert_allclose(gauss_d, gauss / shrink, rtol=1e-10, atol=1e-10)
        np.testing.assert_allclose(mean_d, -gauss * d / shrink, rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize(("name", "reference"), BOTH)
@pytest.mark.parametrize("offset", OFFSETS)
def test_each_derivative_is_the_derivative_of_the_one_below(name: str, reference: str, offset: float) -> None:
    at = surfaces.primitive_patch(name, reference).jet
    u, v = U[::4, ::3], V[::4, ::3]
    jet = at(u, v, offset)
    for lower, by_u, by_v in (("position", "du", "dv"), ("du", "duu", "duv"), ("dv", "duv", "dvv")):
        for axis, upper in enumerate((by_u, by_v)):
            step = np.eye(2)[axis]
            slope = differences(lambda h, s=step, low=lower: getattr(at(u + h * s[0], v + h * s[1], offset), low))
            np.testing.assert_allclose(getattr(jet, upper), slope, rtol=0, atol=2e-10, err_msg=upper)


@pytest.mark.parametrize(("name", "reference"), BOTH)
def test_corners_are_flat_points_where_six_patches_meet_at_sixty_degrees(name: str, reference: str) -> None:
    u, v = np.array([[0, 1, 1, 0], [0, 0, 1, 1]], float)
    jet = surfaces.primitive_patch(name, reference).jet(u, v)
    cosine = dot(jet.du, jet.dv) / np.sqrt(dot(jet.du, jet.du) * dot(jet.dv, jet.dv))
    np.testing.assert_allclose(
        cosine, [0.5, -0.5, 0.5, -0.5], rtol=0, atol=1e-14
    )  # cos 60 between the sides inside the patch
    for curvature in curvatures(jet):
        np.testing.assert_allclose(curvature, 0, rtol=0, atol=1e-12)
    np.testing.assert_allclose(jet.position, np.rint(8 * jet.position) / 8, rtol=0, atol=2e-16)
    np.testing.assert_allclose(
        np.abs(jet.normal), np.rint(np.abs(jet.normal) ** 2 * 3) ** 0.5 / 3**0.5, rtol=0, atol=2e-16
    )


@pytest.mark.parametrize(("name", "reference"), BOTH)
@pytest.mark.parametrize("offset", OFFSETS)
def test_joints_are_curvature_continuous_with_the_projective_transition(
    name: str, reference: str, offset: float
) -> None:
    """In Klein's coordinates the neighbour's parameters are a projective half-turn of the patch's own (a harmonic homology).

    xi outward, y along the side, c half the square's side, L = 1/c - c; T the half-turn in space about m, linear part R.
    """
    c = 3**-0.5
    length = 1 / c - c
    y = np.linspace(-c, c, 21)
    symmetry = surfaces.patch_symmetry(name)
    surface = surfaces.primitive_patch(name, reference)
    for side, (start, along, out) in SIDES.items():
        along, out = np.array(along, float), np.array(out, float)
        u, v = (np.array(start) + np.outer((y / c + 1) / 2, along)).T
        jet = surface.jet(u, v, offset)
        first = np.stack([jet.du, jet.dv]) / (2 * c)
        second = np.stack([np.stack([jet.duu, jet.duv]), np.stack([jet.duv, jet.dvv])]) / (2 * c) ** 2
        x_out, x_along = np.einsum("ka,ani->kni", [out, along], first)
        x_oo, x_oa, x_aa = (
            np.einsum("a,b,abni->ni", p, q, second) for p, q in ((out, out), (out, along), (along, along))
        )
        s = y[:, None]
        d1 = length * x_out - s * x_along
        d2 = length**2 * x_oo - 2 * s * length * x_oa + s**2 * x_aa - 2 * length * x_out + 2 * s * x_along
        turn, shift = symmetry.edge_motions.rotation[side], symmetry.edge_motions.translation[side]
        np.testing.assert_allclose(jet.position[::-1], jet.position @ turn.T + shift, rtol=0, atol=4e-15)
        np.testing.assert_allclose(jet.normal[::-1], jet.normal @ turn.T, rtol=0, atol=4e-15)
        np.testing.assert_allclose(d1[::-1], -d1 @ turn.T, rtol=0, atol=1e-14)
        np.testing.assert_allclose(d2[::-1], d2 @ turn.T, rtol=0, atol=1e-13)


@pytest.mark.parametrize(("name", "distance"), [("gyroid", 1.345e-3), ("diamond", 7.53e-4), ("schwarz_p", 1.191e-2)])
def test_the_minimal_surface_lies_on_its_nodal_namesake(name: str, distance: float) -> None:
    """The published greatest distances, found by bisection of the printed formula along the minimal surface's normals."""
    minimal, nodal = surfaces.primitive_patch(name).jet(U, V), surfaces.primitive_patch(name, "nodal").jet(U, V)
    f = formula(name)
    np.testing.assert_allclose(f(nodal.position), 0, rtol=0, atol=1e-14)
    low, high = np.full(U.shape, -0.02), np.full(U.shape, 0.02)
    for _ in range(60):
        middle = (low + high) / 2
        below = f(minimal.position + middle[..., None] * minimal.normal) < 0
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    assert np.abs(high).max() == pytest.approx(distance, rel=1e-3)
    np.testing.assert_allclose(minimal.position + high[..., None] * minimal.normal, nodal.position, rtol=0, atol=4e-15)


@pytest.mark.parametrize(("name", "reference"), BOTH)
def test_the_normal_points_up_the_nodal_function_handedness_included(name: str, reference: str) -> None:
    symmetry = surfaces.patch_symmetry(name)
    jet = surfaces.primitive_patch(name, reference).jet(U, V)
    points = symmetry.cell_motions[:, None, None].apply(jet.position)
    normals = symmetry.cell_motions[:, None, None].apply_to_vectors(jet.normal)
    f = formula(name)
    steepness = np.sqrt(sum(along_gradient(f, points, e) ** 2 for e in np.eye(3)))
    cosine = along_gradient(f, points, normals) / steepness
    assert cosine.min() > (1 - 1e-6 if reference == "nodal" else 0.99)


@pytest.mark.parametrize(("name", "reference"), BOTH)
def test_offsets_are_regular_up_to_the_greatest_and_have_cusps_from_there(name: str, reference: str) -> None:
    surface = surfaces.primitive_patch(name, reference)
    u, v = np.meshgrid(*[np.linspace(0, 1, 61)] * 2, indexing="ij")
    mid, normal = surface.mid_and_normal(u, v)
    whole = dot(np.cross(mid[1], mid[2]), normal[0])
    for side in (-1, 1):
        at = mid + side * surface.max_offset * normal
        left = dot(np.cross(at[1], at[2]), normal[0]) / whole
        assert -1e-9 < left.min() < 1e-3


@pytest.mark.parametrize(
    ("name", "limit"),
    [
        ("gyroid", 0.5 / 2.656243496748273),
        ("diamond", 0.5 / 3.3715007096251908),
        ("schwarz_p", 0.5 / 2.1565156474996432),
    ],
)
def test_the_greatest_offset_is_half_a_weierstrass_unit(name: str, limit: float) -> None:
    assert surfaces.primitive_patch(name).max_offset == pytest.approx(limit, rel=1e-15)


@pytest.mark.parametrize("name", NAMES)
def test_the_greatest_offset_of_the_nodal_surface_is_its_least_radius_of_curvature(name: str) -> None:
    """At the centre of the gyroid's and Schwarz P's patch, which has closed forms; on a diagonal of Diamond's."""
    limit = surfaces.primitive_patch(name, "nodal").max_offset
    u = np.linspace(0, 1, 4001)
    mean, gauss = curvatures(surfaces.primitive_patch(name, "nodal").jet(u, u))
    assert limit == pytest.approx(1 / (np.abs(mean) + np.sqrt(mean**2 - np.minimum(gauss, 0))).max(), rel=1e-7)
    closed = {"gyroid": 1 / (np.pi * np.sqrt(3)), "schwarz_p": 1 / (2 * np.pi)}
    assert limit == pytest.approx(closed.get(name, limit), rel=1e-14)


@pytest.mark.parametrize(("name", "reference"), BOTH)
def test_no_other_sheet_comes_nearer_than_the_greatest_offset(name: str, reference: str) -> None:
    """Reach by Federer's formula: the least |q - p|^2 / 2 |(q - p) . n(p)| over pairs of points, remote ones included."""
    symmetry, surface = surfaces.patch_symmetry(name), surfaces.primitive_patch(name, reference)
    u, v = np.meshgrid(*[np.linspace(0, 1, 9)] * 2, indexing="ij")
    jet = surface.jet(u, v)
    p, n = jet.position.reshape(-1, 3), jet.normal.reshape(-1, 3)
    cell = symmetry.cell_motions[:, None].apply(p)
    shifts = np.array(list(itertools.product((-1, 0, 1), repeat=3)))
    middle = cell.reshape(-1, 3)
    q = (middle - np.floor(middle - p.mean(axis=0) + 0.5) + shifts[:, None]).reshape(-1, 3)
    near = cKDTree(q).query_ball_point(p, 2 * surface.max_offset)
    for point, direction, indices in zip(p, n, near, strict=True):
        gap = q[indices] - point
        square, height = dot(gap, gap), np.abs(gap @ direction)
        assert (square >= 2 * height * surface.max_offset * (1 - 1e-9) - 1e-14).all()


@pytest.mark.parametrize(("name", "reference"), BOTH)
def test_an_offset_past_the_limit_is_refused_with_the_limit_and_the_remedy(name: str, reference: str) -> None:
    surface = surfaces.primitive_patch(name, reference)
    surface.jet(0.5, 0.5, np.nextafter(surface.max_offset, 0))
    for offset in (surface.max_offset, -surface.max_offset, 1.0, np.nan):
        with pytest.raises(
            InvalidRequest, match=f"offset {offset:g}.*{surface.max_offset:.6g}.*thickness.*thin the wall"
        ):
            surface.jet(0.5, 0.5, offset)


def test_parameters_far_outside_the_square_are_refused() -> None:
    surface = surfaces.primitive_patch("gyroid")
    for u, v in ((1.06, 0.5), (0.5, -0.06), (np.nan, 0.5)):
        with pytest.raises(InvalidRequest, match="outside the unit square"):
            surface.jet([0.5, u], v)


@pytest.mark.parametrize("shape", [(), (3,), (2, 3), (0,)])
@pytest.mark.parametrize(("name", "reference"), BOTH)
def test_jets_have_the_shape_of_their_parameters(name: str, reference: str, shape: tuple[int, ...]) -> None:
    u = np.linspace(0.1, 0.9, int(np.prod(shape))).reshape(shape)
    jet = surfaces.primitive_patch(name, reference).jet(u, 0.25, 0.1)
    for field in ("position", "du", "dv", "duu", "duv", "dvv", "normal"):
        assert getattr(jet, field).shape == (*shape, 3)
    if u.size:
        last = surfaces.primitive_patch(name, reference).jet(u.ravel()[-1], 0.25, 0.1)
        np.testing.assert_allclose(jet.duv.reshape(-1, 3)[-1], last.duv, rtol=0, atol=4e-15)


@pytest.mark.parametrize("corner", [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)])
def test_the_maximum_of_what_grows_beyond_a_corner_is_at_the_corner(corner: tuple[float, float]) -> None:
    a, b = corner
    simplex = np.array([[0.5, 0.5], [0.6, 0.5], [0.5, 0.6]])
    found = maximise_on_unit_square(lambda u, v: (2 * a - 1) * u + (2 * b - 1) * v, simplex, fatol=1e-12)
    assert found == pytest.approx(a + b, abs=1e-6)
