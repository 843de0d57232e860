"""Triangle meshes as fields: distances, signs, files, and what is repaired or refused."""

from __future__ import annotations

import re
from types import SimpleNamespace

import numpy as np
import pytest

from tpmscad import fields
from tpmscad.brep.winding_numbers import winding_numbers
from tpmscad.errors import InvalidRequest
from tpmscad.fields.analysis.solid_bounds import bound_solid
from tpmscad.fields.data.triangle_distance import build_triangle_tree, grid_winding_numbers
from tpmscad.fields.data.triangle_mesh import close_mesh, read_triangle_mesh

trimesh = pytest.importorskip("trimesh")
RNG = np.random.default_rng(3)


def ball(radius: float = 5.0, subdivisions: int = 3, at: tuple[float, ...] = (1.0, -2.0, 0.5)) -> trimesh.Trimesh:
    made = trimesh.creation.icosphere(subdivisions, radius)
    made.apply_translation(at)
    return made


def holed(mesh: trimesh.Trimesh, kept: np.ndarray) -> SimpleNamespace:
    return SimpleNamespace(vertices=mesh.vertices, faces=mesh.faces[kept])


def test_the_nearest_point_is_that_of_all_triangles() -> None:
    corners = RNG.normal(size=(60, 3, 3))
    tree = build_triangle_tree(corners.reshape(-1, 3), np.arange(180).reshape(60, 3))
    points = 2 * RNG.normal(size=(200, 3))
    distance, feet, found = tree.nearest(points)
    for p, d, foot, t in zip(points, distance, feet, found, strict=True):
        each = trimesh.triangles.closest_point(corners, np.repeat(p[None], 60, axis=0))
        expected = np.linalg.norm(each - p, axis=1)
        assert np.isclose(d, expected.min(), atol=1e-12)
        assert np.allclose(foot, each[t], atol=1e-9)


def test_winding_numbers_of_a_grid_are_those_of_its_points() -> None:
    parts = [ball(), ball(2.0), ball(2.0, at=(5.0, 0.0, 0.0)), trimesh.creation.torus(8.0, 1.0)]
    parts[1].invert()  # a cavity
    both = trimesh.util.concatenate(parts)
    axes = tuple(np.arange(n) * s - 9.3 for n, s in ((19, 1.03), (17, 1.1), (23, 0.8)))
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    found = grid_winding_numbers(both.vertices, both.faces, *axes)
    assert {0, 1, 2} <= set(np.unique(found))
    assert (found.ravel() == winding_numbers(both.vertices, both.faces, points.reshape(-1, 3))).all()


@pytest.mark.slow
def test_the_field_of_a_ball_is_its_distance() -> None:
    field = fields.mesh(ball(subdivisions=4))
    centre = np.array([1.0, -2.0, 0.5])
    points = centre + RNG.uniform(-7, 7, (500, 3))
    radius = np.linalg.norm(points - centre, axis=1)
    near = (radius > 1) & (radius < 5.5)  # the centre is a ridge
    assert np.abs(field(points[near]) - (radius[near] - 5)).max() < 0.02  # the triangles lie .008 below the ball
    assert np.abs(np.linalg.norm(field.gradient(points[near]), axis=1) - 1).max() < 0.05
    low, high = field.domain
    assert (np.array(low) < (-4.0, -7.0, -4.5)).all()
    assert (np.array(high) > (6.0, 3.0, 5.5)).all()


def test_the_deviation_stated_is_that_of_the_triangles() -> None:
    cube = trimesh.creation.box((10, 8, 6))
    fine, coarse = fields.mesh(cube, spacing=0.25), fields.mesh(cube, spacing=1.0)
    points = trimesh.sample.sample_surface(cube, 4000, seed=1)[0]
    for field in (fine, coarse):
        measured = field(points) / np.linalg.norm(field.gradient(points), axis=1)
        assert np.isclose(field.rms_deviation, np.sqrt(np.mean(measured**2)), rtol=0.2)
    assert fine.max_deviation < 0.5 * coarse.max_deviation < 0.5
    assert "12 triangles" in coarse.notes[0]


def turned(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    made = mesh.copy()
    made.invert()
    return made


def make_crossing_tube() -> SimpleNamespace:
    """A tube along a figure of eight, whose arms cross in the middle."""
    t, a = np.linspace(0, 2 * np.pi, 120, endpoint=False), np.linspace(0, 2 * np.pi, 16, endpoint=False)
    side = np.stack([-6 * np.cos(2 * t), 10 * np.cos(t), 0 * t], axis=1)
    side /= np.linalg.norm(side, axis=1)[:, None]
    ring = np.cos(a)[:, None] * side[:, None] + np.sin(a)[:, None] * np.array([0.0, 0.0, 1.0])
    vertices = np.stack([10 * np.sin(t), 3 * np.sin(2 * t), 0 * t], axis=1)[:, None] + 1.5 * ring
    k = np.arange(120 * 16).reshape(120, 16)
    ahead, beside, both = np.roll(k, -1, 0), np.roll(k, -1, 1), np.roll(k, (-1, -1), (0, 1))
    faces = np.concatenate([np.stack([k, both, ahead], axis=-1), np.stack([k, beside, both], axis=-1)])
    return SimpleNamespace(vertices=vertices.reshape(-1, 3), faces=faces.reshape(-1, 3))


BALL, CORE, SEED, NEIGHBOUR = ball(), ball(3.0), ball(1.5), ball(4.0, at=(6, -2, 0.5))
CUBE, BESIDE = trimesh.creation.box((4, 4, 4)), trimesh.creation.box((4, 4, 4)).apply_translation((4, 0, 0))
LENS = np.pi * (5 + 4 - 5) ** 2 * (25 + 2 * 5 * 4 - 3 * 16 + 2 * 5 * 5 - 3 * 25 + 6 * 4 * 5) / (12 * 5)
"""Volume of the lens of balls of radii 5 and 4 whose centres are 5 apart."""
FULL, SHELL, PAIR = 500 / 3 * np.pi, (500 - 108) / 3 * np.pi, (500 + 256) / 3 * np.pi - LENS
SHELLS: dict[str, tuple[list[trimesh.Trimesh], float, str, tuple[float, ...]]] = {
    "nested": ([BALL, CORE], FULL, "within other shells .* left out: shell 2 of 2, 6 wide", (3, 0, 0)),
    "three nested": ([BALL, CORE, SEED], FULL, "left out: shell 2 of 3, .*; shell 3 of 3", (1.5, 0, 0)),
    "cavity": ([BALL, turned(CORE)], SHELL, "", ()),
    "core in a cavity": ([BALL, turned(CORE), SEED], SHELL + 4.5 * np.pi, "", ()),
    "all inside out": ([turned(BALL), CORE], SHELL, "was inside out", ()),
    "one inside out": (
        [ball(at=(20, 0, 0)), turned(CORE)],
        FULL + 36 * np.pi,
        "faces inwards was reversed: shell 2",
        (),
    ),
    "overlapping": (
        [BALL, NEIGHBOUR],
        PAIR,
        "overlap or touch .* shell 1 of 2, 10 wide .*; shell 2 of 2, 8 wide",
        (3, 0, 0),
    ),
    "overlapping and nested": ([BALL, NEIGHBOUR, CORE], PAIR, "one solid", (3, 0, 0)),
    "cavity in one of two": ([BALL, turned(SEED), ball(3.0, at=(7, -2, 0.5))], 0.0, "one solid", ()),
    "twice": ([BALL, BALL], FULL, "several times", ()),
    "touching": ([CUBE, BESIDE], 128.0, "overlap or touch", (2, 0.2, 0.1)),
    "touching alike": (
        [trimesh.Trimesh(CUBE.vertices * (-1, 1, 1), CUBE.faces[:, ::-1]), BESIDE],
        128.0,
        "cancel",
        (2, 0, 0),
    ),
}


@pytest.mark.parametrize("name", SHELLS)
@pytest.mark.slow
def test_the_distance_is_that_from_the_boundary_of_what_the_shells_make_together(name: str) -> None:
    parts, volume, words, deep = SHELLS[name]
    mesh = read_triangle_mesh(trimesh.util.concatenate(parts))
    field = fields.mesh(trimesh.util.concatenate(parts))
    if volume:
        assert mesh.volume == pytest.approx(volume, rel=0.02)
    assert any(re.search(words, note) for note in mesh.notes) if words else not mesh.notes
    assert field.max_deviation < 0.1
    # by each shell alone, the winding number is positive where f < 0, and no triangle is nearer than f says
    points = RNG.uniform(mesh.vertices.min(axis=0), mesh.vertices.max(axis=0), (2000, 3))
    winding = sum(winding_numbers(part.vertices, part.faces, points) for part in parts)
    sure = np.abs(field(points)) > 0.3
    if "inside" not in name:
        assert ((winding > 0) == (field(points) < 0))[sure].all()
    if deep:
        assert field(np.array(deep) + (np.array([1.0, -2.0, 0.5]) if volume != 128 else 0.0)) < -1.4


def test_a_shell_that_overlaps_itself_is_refused_with_its_place() -> None:
    with pytest.raises(InvalidRequest, match=r"overlaps itself: .* off the boundary .*shell 1 of 1, .*Boolean union"):
        fields.mesh(make_crossing_tube())


def test_winding_numbers_about_points_are_those_of_rays_in_general_directions() -> None:
    both = trimesh.util.concatenate([ball(), turned(ball(2.0)), ball(2.0, at=(5.0, 0.0, 0.0))])
    points = RNG.uniform(-8, 8, (3000, 3))
    points[:500, :2] = both.vertices[:500, :2]  # below and above vertices
    found = build_triangle_tree(both.vertices, both.faces).winding_numbers(points)
    assert {0, 1, 2} <= set(np.unique(found))
    assert (found == winding_numbers(both.vertices, both.faces, points)).all()


def test_the_spacing_is_refined_until_a_thin_part_is_kept() -> None:
    plates = trimesh.util.concatenate([trimesh.creation.box((20, 20, 4)), trimesh.creation.box((0.25, 4, 30))])
    thin = trimesh.creation.box((20, 20, 0.1))
    assert (fields.mesh(thin)((0.1, 0.2, 0.0)) < 0).all()
    assert fields.mesh(thin).spacing[0] < 20 / 64
    assert any("overlap" in note for note in fields.mesh(plates).notes)


@pytest.mark.slow
def test_what_is_repaired_is_told() -> None:
    whole = ball(subdivisions=4)
    small = holed(whole, np.arange(len(whole.faces)) != 7)
    closed = fields.mesh(small, spacing=0.4)
    assert np.isclose(closed.mesh.volume, whole.volume, rtol=1e-3)
    assert any("1 hole closed" in note for note in closed.notes)

    turned = SimpleNamespace(
        vertices=whole.vertices, faces=np.where(np.arange(5120)[:, None] < 9, whole.faces[:, ::-1], whole.faces)
    )
    fixed = fields.mesh(turned, spacing=0.4)
    assert np.isclose(fixed.mesh.volume, whole.volume)
    assert any("9 of 5120 triangles faced the wrong way" in note for note in fixed.notes)

    inverted = SimpleNamespace(vertices=whole.vertices, faces=whole.faces[:, ::-1])
    assert any("inside out" in note for note in fields.mesh(inverted, spacing=0.4).notes)

    apart = whole.vertices[whole.faces].reshape(-1, 3) + RNG.normal(scale=1e-7, size=(15360, 3))
    soup = close_mesh("soup", apart, np.arange(15360).reshape(-1, 3))
    assert soup.euler_characteristic == 2
    assert any("made one" in note for note in soup.notes)


@pytest.mark.parametrize(
    ("source", "spacing", "words"),
    [
        (holed(ball(), np.arange(1280) > 300), None, "open: .* edges bound one triangle only, the first near"),
        ("nowhere.stl", None, "no file"),
        (3.5, None, "no body"),
        (SimpleNamespace(vertices=np.zeros((3, 3)), faces=np.array([[0, 1, 5]])), None, "has the vertex 5 of 3"),
        (SimpleNamespace(vertices=np.eye(3), faces=np.array([[0, 1, 2], [2, 1, 0]])), None, "encloses no volume"),
        (ball(), 0.01, "more than 2e.07: give at least 0.037"),
        (ball(), 30.0, "no sample lies within"),
    ],
)
def test_what_is_no_closed_mesh_is_refused(source: object, spacing: float | None, words: str) -> None:
    with pytest.raises(InvalidRequest, match=words):
        fields.mesh(source, spacing=spacing)


BOUNDED = {
    "ball": fields.sphere((5, 0, 0), 3.0),
    "far apart": fields.sphere((5, 0, 0), 3.0) | fields.sphere((-60, 20, 0), 6.0),
    "torus": fields.expression("(x^2 + y^2 + z^2 + 12)^2 - 64*(x^2 + y^2)"),
    "smooth union": fields.smooth_union(fields.sphere((0, 0, 0), 3.0), fields.sphere((4, 0, 0), 2.0), 1.0),
    "turned gyroid in a ball": fields.rotate(fields.tpms("gyroid", 4.0) & fields.sphere((9, 1, 0), 6.0), (1, 2, 3), 40),
    "small": fields.sphere((0, 0, 0), 1e-3),
}


@pytest.mark.parametrize("name", BOUNDED)
def test_the_bounds_contain_the_solid_and_are_not_much_larger(name: str) -> None:
    field = BOUNDED[name]
    found = bound_solid(field)
    assert found is not None
    low, high = found
    grid = np.stack(np.meshgrid(*np.linspace(low, high, 60).T, indexing="ij"), axis=-1)
    inside = grid[field(grid) < 0]
    assert (
        (inside.min(axis=0) - low < 0.2 * (high - low).max()) & (high - inside.max(axis=0) < 0.2 * (high - low).max())
    ).all()
    beyond = RNG.uniform(low - 2 * (high - low), high + 2 * (high - low), (20_000, 3))
    outside = ((beyond < low) | (beyond > high)).any(axis=1)
    assert (field(beyond[outside]) > 0).all()


@pytest.mark.parametrize(
    "field",
    [
        fields.tpms("gyroid", 5.0),
        fields.cylinder((0, 0, 0), 2.0),
        fields.complement(fields.sphere((0, 0, 0), 2.0)),
        fields.from_function(lambda x, y, z: x**2 + y**2 + z**2 - 4),
        fields.constant(1.0),
    ],
)
def test_no_bounds_are_found_where_there_are_none_or_the_formula_is_foreign(field: fields.Field) -> None:
    assert bound_solid(field) is None
