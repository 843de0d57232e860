"""Two networks of patches that cut each other: closed results, exact volumes, shared curves, and refusals that name the place."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

from tests.shapes.misfits import volume
from tests.shapes.round_shapes import sphere
from tests.trimming.conftest import Cover, cover
from tests.trimming.network_operands import combine, rod, trim
from tpmscad import fields
from tpmscad.brep import connectivity
from tpmscad.brep.boundary_representation import Brep, move_brep, reverse_faces, select_faces, translate_brep
from tpmscad.brep.free_form_surface import FreeFormSurface
from tpmscad.errors import InvalidRequest, TrimmingError
from tpmscad.lattices.strut_brep import build_strut_brep
from tpmscad.levelset.field_solid import fit_field
from tpmscad.rigid_motion import Motion
from tpmscad.splines.alike_curves import interpolate_alike
from tpmscad.splines.bspline import BSplineCurve, BSplineSurface, line_segment
from tpmscad.trimming.classify.network_edges import points_in_network
from tpmscad.trimming.intersect.common_curves import DEGREE, _choose_parameters, _find_turned
from tpmscad.trimming.intersect.edge_face import intersect_edges_with_faces
from tpmscad.trimming.intersect.face_face import _jumps
from tpmscad.trimming.intersect.network_hits import prepare_networks
from tpmscad.trimming.network_boolean import KEPT_PARTS, NetworkResult, Operation, combine_networks
from tpmscad.trimming.operands.network_tables import (
    find_overlapping_boxes,
    tabulate_edges,
    tabulate_faces,
    tabulate_segments,
)
from tpmscad.trimming.operands.patch_polynomials import evaluate_face
from tpmscad.trimming.operands.polyhedra import box

__all__ = ["cover"]

LOW, HIGH = np.full(3, -2.0), np.full(3, 2.0)
SKEW = Motion(np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]]), np.array([0.11, -0.23, 0.31]))


@lru_cache
def ball(centre: tuple[float, float, float], radius: float) -> Brep:
    return fit_field(fields.sphere(centre, radius), LOW, HIGH, 1e-2).brep


def assert_volumes_add_up(first: Brep, second: Brep, found: dict[Operation, NetworkResult]) -> None:
    """Union and intersection have the volumes of the operands together; the difference is what the intersection leaves."""
    v = {operation: volume(result.brep) for operation, result in found.items()}
    total = volume(first) + volume(second)
    assert v["union"] + v["intersection"] == pytest.approx(total, rel=1e-9)
    assert v["difference"] + v["intersection"] == pytest.approx(volume(first), abs=1e-9 * total)


def measure_edges(brep: Brep) -> float:
    """The largest distance of edges between spline faces from both of them, by foot points on their carriers."""
    worst = 0.0
    uses = np.argsort(brep.uses.edge, kind="stable").reshape(-1, 2)
    for f in range(len(brep.faces)):
        carrier = brep.carriers[brep.faces.carrier[f]]
        own = np.flatnonzero((brep.face_of_use[uses] == f).any(axis=1))
        if not isinstance(carrier, BSplineSurface):
            continue
        surface = FreeFormSurface(carrier.moved(brep.faces.motion[f]), continuation=0.1)
        points = []
        for e in own.tolist():
            low, high = brep.edges.span[e]
            local = brep.curves[brep.edges.curve[e]](low + (high - low) * np.linspace(0.0, 1.0, 31))
            points.append(brep.edges.motion[e].apply(local))
        worst = max(worst, float(np.abs(surface.distance(np.concatenate(points))).max()))
    return worst


@pytest.mark.parametrize("operation", sorted(KEPT_PARTS))
def test_boxes_combine_as_their_volumes_say(operation: Operation) -> None:
    first, second = box((0, 0, 0), (2, 3, 4)), box((1.2, 0.7, -1), (3, 4, 3.5))
    common = 0.8 * 2.3 * 3.5
    expected = {"intersection": common, "union": 24 + 1.8 * 3.3 * 4.5 - common, "difference": 24 - common}[operation]
    result = combine_networks(first, second, operation)
    assert connectivity.is_closed(result.brep)
    assert volume(result.brep) == pytest.approx(expected, rel=1e-12)
    assert result.report.shift.tolist() == [0.0, 0.0, 0.0]


def test_two_balls_meet_in_a_lens() -> None:
    first, second = ball((-0.41, 0.05, 0.13), 1.2), ball((0.53, 0.21, -0.07), 0.9)
    found = combine(first, second)
    assert_volumes_add_up(first, second, found)
    d, r, s = float(np.linalg.norm([0.94, 0.16, -0.2])), 1.2, 0.9
    lens = np.pi * (r + s - d) ** 2 * (d * d + 2 * d * (r + s) - 3 * (r - s) ** 2) / (12 * d)
    assert volume(found["intersection"].brep) == pytest.approx(lens, abs=1e-2 * 4 * np.pi)
    assert euler(found["intersection"].brep) == [2]


def euler(brep: Brep) -> list[int]:
    return sorted(connectivity.euler_characteristic(brep, connectivity.label_shells(brep)[1]).tolist())


@pytest.mark.slow
def test_the_edges_lie_on_both_networks() -> None:
    found = combine(ball((-0.41, 0.05, 0.13), 1.2), ball((0.53, 0.21, -0.07), 0.9))
    for result in found.values():
        assert result.report.max_deviation <= 5e-8
        assert measure_edges(result.brep) <= 1e-7


@pytest.mark.slow
def test_caps_and_t_vertices_are_cut_as_patches_are() -> None:
    first, second = rod(), move_brep(rod(), SKEW)
    assert_volumes_add_up(first, second, combine(first, second))


def test_a_closed_curve_inside_one_pair_of_faces_is_found() -> None:
    """A plane cuts a small circle out of the middle of a patch: no edge meets the other operand."""
    sphere = ball((0.0, 0.0, 0.0), 1.3)
    centres = [np.asarray(c(*np.mean(c.domain, axis=1))) for c in sphere.carriers if isinstance(c, BSplineSurface)]
    middle = max(centres, key=lambda c: float(np.linalg.norm(c)))
    height = float(np.linalg.norm(middle))
    across = np.linalg.svd(middle[None])[2][1:]
    frame = np.column_stack([*across, middle / height])
    frame[:, 0] *= np.linalg.det(frame)
    half_space = move_brep(box((-3, -3, -3), (3, 3, height - 0.004)), Motion(frame, np.zeros(3)))
    found = combine(sphere, half_space)
    assert found["intersection"].report.hits == 0
    assert found["intersection"].report.arcs == 2
    cap = volume(sphere) - volume(found["intersection"].brep)
    assert cap == pytest.approx(np.pi * 0.004**2 * (3 * 1.3 - 0.004) / 3, rel=0.05)
    assert_volumes_add_up(sphere, half_space, found)


@pytest.mark.parametrize(("angle", "overlap", "turns"), [(0.918, 0.343, (5.33, 0.914)), (0.393, 0.051, (5.592, 5.167))])
def test_a_closed_curve_is_found_in_whichever_halves_of_cylinders_it_lies(
    angle: float, overlap: float, turns: tuple[float, float]
) -> None:
    """Both halves of a cylinder lie on one carrier, and near both of the other, but only one pair has the curve."""
    cylinder = build_strut_brep(
        np.array([[0.0, 0.0, -9.0], [0.0, 0.0, 9.0]]), np.array([[0, 1]]), np.full(2, 2.0), np.zeros(2)
    )

    def place(angle: float, height: float, turn: float) -> Brep:
        along, up = np.array([np.cos(angle), np.sin(angle), 0.0]), np.array([0.0, 0.0, 1.0])
        spin = np.array([[np.cos(turn), -np.sin(turn), 0.0], [np.sin(turn), np.cos(turn), 0.0], up])
        return move_brep(cylinder, Motion(np.column_stack([up, np.cross(along, up), along]) @ spin, height * up))

    first, second = place(0.0, 0.0, turns[0]), place(angle, 4.0 - overlap, turns[1])
    found = combine(first, second)
    assert found["intersection"].report.hits == 0
    paraboloid = np.pi * overlap**2 * 2.0 / np.sin(angle)
    assert volume(found["intersection"].brep) == pytest.approx(paraboloid, rel=0.1)
    assert_volumes_add_up(first, second, found)


def test_operands_apart_and_inside_one_another() -> None:
    outer, inner = ball((0.0, 0.1, 0.0), 1.5), ball((0.2, 0.0, 0.3), 0.6)
    found = combine(outer, inner)
    assert volume(found["intersection"].brep) == pytest.approx(volume(inner), rel=1e-12)
    assert volume(found["difference"].brep) == pytest.approx(volume(outer) - volume(inner), rel=1e-12)
    away = translate_brep(inner, np.array([9.0, 0.0, 0.0]))
    assert volume(combine_networks(outer, away, "union").brep) == pytest.approx(
        volume(outer) + volume(inner), rel=1e-12
    )
    with pytest.raises(TrimmingError, match="nothing is left"):
        combine_networks(outer, away, "intersection")


@pytest.mark.slow
def test_the_cut_by_a_box_is_that_of_the_trim(cover: Cover) -> None:
    """Two routes: the lattice trimmed by both boxes at once, and first by one, then by the other as a network."""
    lattice = cover("gyroid", (1, 1, 1), (0.0, 0.0, 0.0), (-0.05, 0.05))
    whole = trim(lattice, box(np.zeros(3), np.full(3, 10.0))).brep
    lo, hi = np.array([2.13, -1.0, 3.21]), np.array([11.0, 7.77, 9.13])
    expected = trim(lattice, box(np.maximum(lo, 0.0), np.minimum(hi, 10.0))).brep
    found = combine_networks(whole, box(lo, hi), "intersection").brep
    assert volume(found) == pytest.approx(volume(expected), rel=1e-8)


def test_every_crossing_of_a_line_with_a_face_is_found() -> None:
    """Against a dense search for changes of sign of the sphere's equation along lines."""
    sphere = ball((0.0, 0.0, 0.0), 1.3)
    rng = np.random.default_rng(5)
    begin, end = rng.uniform(-2, 2, (200, 3)), rng.uniform(-2, 2, (200, 3))
    lines = tuple(line_segment(p, q) for p, q in zip(begin, end, strict=True))
    table = tabulate_segments(lines, np.arange(200), Motion.identity(200), np.tile([0.0, 1.0], (200, 1)))
    faces = tabulate_faces(sphere)
    pairs = find_overlapping_boxes(table.low, table.high, faces.low, faces.high, 0.0)
    hits = intersect_edges_with_faces(table, faces, pairs)
    t = np.linspace(0, 1, 4001)[:, None, None]
    radius = np.linalg.norm(begin + t * (end - begin), axis=2)
    crossings = (np.diff(radius < 1.3, axis=0)).sum(axis=0)
    clear = np.abs(radius.min(axis=0) - 1.3) > 1e-2
    counted = np.bincount(pairs[hits.pair, 0], minlength=200)
    assert clear.sum() > 150
    assert np.array_equal(counted[clear], crossings[clear])


@pytest.mark.parametrize(("length", "crossings"), [(0.05, 1), (0.1, 2)])
def test_short_edges_of_many_pieces_that_run_along_a_face_pierce_it(length: float, crossings: int) -> None:
    """Edges far shorter than the faces, at two degrees to them: by the squared distance from the centre, exact on a line."""
    n, rng = 200, np.random.default_rng(5)
    normal, other = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in rng.normal(size=(2, n, 3)))
    tangent = np.cross(normal, other)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    begin, along = 1.301 * normal, length * (tangent - 0.04 * normal)
    knots = np.concatenate([[0.0], np.linspace(0.0, 1.0, 25), [1.0]])
    edges = tuple(
        BSplineCurve(p + np.linspace(0.0, 1.0, 25)[:, None] * d, knots, 1) for p, d in zip(begin, along, strict=True)
    )
    table = tabulate_segments(edges, np.arange(n), Motion.identity(n), np.tile([0.0, 1.0], (n, 1)))
    faces = tabulate_faces(ball((0.0, 0.0, 0.0), 1.3))
    pairs = find_overlapping_boxes(table.low, table.high, faces.low, faces.high, 0.0)
    hits = intersect_edges_with_faces(table, faces, pairs)
    assert not len(hits.touching)
    assert np.array_equal(np.bincount(pairs[hits.pair, 0], minlength=n), np.full(n, crossings))
    a, b, c = ((v * w).sum(axis=1) for v, w in ((along, along), (along, begin), (begin, begin)))
    root = (-b - np.sqrt(b**2 - a * (c - 1.3**2))) / a
    first = np.full(n, np.inf)
    np.minimum.at(first, pairs[hits.pair, 0], hits.t)
    assert np.abs(first - root).max() * length < 1e-3  # the ball's patches are 2e-5 off, 25 times that along the edge


@pytest.mark.slow
def test_points_are_told_from_the_network_alone() -> None:
    rng = np.random.default_rng(7)
    points = rng.uniform(-1.7, 1.7, (300, 3))
    value = fields.rod(fields.tpms("schwarz_p", 3.0), -0.6)(points)
    clear = np.abs(value) > 0.1
    inside = points_in_network(prepare_networks(rod(), rod(), 0.0)[0], points[clear])
    assert np.array_equal(inside, value[clear] < 0)


def test_tables_hold_the_carriers() -> None:
    brep = move_brep(rod(), SKEW)
    table, jet = tabulate_faces(brep), np.empty((3, 3))
    for f in range(len(brep.faces)):
        carrier = brep.carriers[brep.faces.carrier[f]]
        if not isinstance(carrier, BSplineSurface):
            continue
        (u0, u1), (v0, v1) = carrier.domain
        u, v = u0 + 0.31 * (u1 - u0), v0 + 0.83 * (v1 - v0)
        evaluate_face(table.patches, f, u, v, jet)
        motion = brep.faces.motion[f]
        expected = [
            motion.apply(carrier(u, v)),
            *(motion.apply_to_vectors(carrier(u, v, *d)) for d in ((1, 0), (0, 1))),
        ]
        np.testing.assert_allclose(jet, expected, atol=1e-12)
        cells = slice(table.cells.first[f], table.cells.first[f + 1])
        points = motion.apply(carrier.grid(np.linspace(u0, u1, 19), np.linspace(v0, v1, 17)).reshape(-1, 3))
        apart = np.linalg.norm(points[:, None] - table.cells.centre[cells], axis=2)
        assert (apart <= table.cells.radius[cells]).any(axis=1).all()
    assert len(tabulate_edges(brep).low) == len(brep.edges)


def test_coincident_faces_are_told_apart_by_a_shift_that_is_told() -> None:
    first = box((0, 0, 0), (2, 2, 2))
    result = combine_networks(first, first, "intersection")
    shift = result.report.shift
    assert (shift > 0).all()
    assert result.report.reason
    assert volume(result.brep) == pytest.approx(float(np.prod(2 - shift)), rel=1e-12)
    with pytest.raises(TrimmingError):
        combine_networks(first, first, "intersection", may_move=False)


@pytest.mark.slow
def test_contact_over_an_area_is_refused_with_the_place() -> None:
    """A network and its own image a hair away: the faces coincide over an area within the tolerance."""
    ball = sphere(1.3)
    with pytest.raises(TrimmingError, match=r"\("):
        combine_networks(ball, translate_brep(ball, np.array([2e-9, 1e-9, 0.0])), "intersection")


def test_aligned_edges_are_resolved_by_a_shift_that_is_told() -> None:
    """Both boxes have edges in the plane z = 0 that cross: the second one moves by a few tolerances."""
    first, second = box((0, 0, 0), (2, 2, 2)), box((1, 1, 0), (3, 3, 1))
    result = combine_networks(first, second, "intersection")
    assert 0 < np.linalg.norm(result.report.shift) < 1e-5
    assert result.report.reason
    assert volume(result.brep) == pytest.approx(1.0, abs=1e-5)


def test_requests_are_checked() -> None:
    cube = box((0, 0, 0), (1, 1, 1))
    with pytest.raises(InvalidRequest, match="tol"):
        combine_networks(cube, cube, "union", -1.0)
    with pytest.raises(InvalidRequest, match="operation 'sum'"):
        combine_networks(cube, cube, "sum")  # type: ignore[arg-type]
    with pytest.raises(InvalidRequest, match="not join two faces"):
        combine_networks(cube, _open(cube), "union")


def _open(brep: Brep) -> Brep:
    return select_faces(brep, np.arange(len(brep.faces) - 1))


def test_a_reversed_operand_is_a_hole() -> None:
    """The intersection with the complement is the difference."""
    first, second = ball((-0.41, 0.05, 0.13), 1.2), ball((0.53, 0.21, -0.07), 0.9)
    difference = combine_networks(first, second, "difference").brep
    hole = combine_networks(first, reverse_faces(second), "difference").brep
    assert volume(hole) + volume(difference) == pytest.approx(volume(first), rel=1e-9)


@pytest.mark.parametrize("ratio", [1.0, 1.6, 2.2])
def test_curves_through_graded_sites_do_not_swing(ratio: float) -> None:
    """A curve that leaves the fold of a patch, where its parameter goes with the square root of the length."""
    s = np.concatenate([[0.0], np.cumsum(ratio ** np.arange(13.0))])
    s /= s[-1]

    def curve(x: np.ndarray) -> np.ndarray:
        return np.column_stack([np.cos(x), np.sin(x), 0.1 * x**2, np.sqrt(1e-3 + x)])

    spline = make_interp_spline(_choose_parameters(curve(s)[None])[0], curve(s), DEGREE)
    at = spline(np.linspace(spline.t[0], spline.t[-1], 500))
    turn = np.arctan2(at[:, 1], at[:, 0])
    assert np.abs(at - curve(turn)).max() < 0.03


def test_a_spline_that_runs_back_beyond_a_site_is_found() -> None:
    """It lies on the curve that it interpolates, so that its deviation does not tell: here on a line."""
    t = np.arange(12.0)[None]
    even, uneven = (np.zeros((1, 12, 7)) for _ in range(2))
    even[0, :, 0], uneven[0, :, 0] = t[0], [*t[0, :-1], 10.001]
    assert not _find_turned(interpolate_alike(t, even, DEGREE), t, even).any()
    found = _find_turned(interpolate_alike(t, uneven, DEGREE), t, uneven)[0]
    assert found[-1]
    assert not found[:4].any()


def test_a_curve_that_passes_beside_the_pole_of_a_ball_is_traced_once() -> None:
    """The pole lies on the far side of a free end; a thinner strut leaves the ball in a circle that passes it in a 400th."""
    nodes = [[31.02984, 28.76335, 39.06495], [29.58008, 40.56492, 38.73778], [40.67946, 29.06346, 40.10775]]
    diameters = [[1.69112, 1.91310], [1.69997, 1.37419]]
    pair, radii = np.array([[0, 1]]), np.array(diameters) / 2
    thick = build_strut_brep(np.array(nodes[:2]), pair, radii[0], radii[0])
    thin = build_strut_brep(np.array(nodes[::2]), pair, radii[1], radii[1] * [0, 1])
    found = combine_networks(thick, thin, "union").brep
    assert connectivity.is_closed(found)


def test_steps_onto_another_branch_of_a_folded_patch_are_told_by_their_parameters() -> None:
    """Both branches may have the same d(u, v)/dx, and the place may be the one expected: u of a face went from .61 to .97 so."""
    before, rate = np.array([0.61, 0.93, 0.34, 0.84]), np.array([0.21, 0.41, -0.31, 0.15])
    expected = before + 0.24 * rate
    assert not _jumps.py_func(before, expected + np.array([0.02, -0.02, 0.0, 0.01]), rate, 0.24)
    for branch in ([0.31, 0.11, 0.0, 0.0], [0.0, 0.0, -0.03, -0.03]):  # of one face or of the other
        assert _jumps.py_func(before, expected + np.array(branch), rate, 0.24)
