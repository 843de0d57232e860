"""Struts on graphs as boundary representations: envelopes, volumes, topology, contacts."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from benchmarks.struts import exact_volume
from tpmscad import fields, maps
from tpmscad.brep import connectivity
from tpmscad.brep.boundary_representation import Brep
from tpmscad.brep.moments import integral_properties
from tpmscad.brep.solid_properties import measure_solid
from tpmscad.errors import InvalidRequest, TrimmingError
from tpmscad.fields.data.edge_radii import greatest_radii
from tpmscad.fields.kinds.strut_graphs import StrutsField, map_struts
from tpmscad.lattices import strut_classes
from tpmscad.lattices.strut_brep import build_strut_brep
from tpmscad.lattices.strut_contacts import find_contact
from tpmscad.lattices.strut_ends import Waves, find_envelope
from tpmscad.strut_cells import FLAT_KINDS, KINDS

BOX = np.zeros(3), np.full(3, 10.0)


def bound(field: StrutsField, box: tuple[np.ndarray, np.ndarray] | None = None) -> Brep:
    return build_strut_brep(*graph(field), box)


def graph(field: StrutsField) -> tuple[np.ndarray, ...]:
    radii = greatest_radii(len(field.points), field.edges, field.radii)
    assert (field.radii == radii[field.edges]).all()
    return field.points, field.edges, radii, field.balls


def count_classes(field: StrutsField, box: tuple[np.ndarray, np.ndarray]) -> int:
    return len(strut_classes.group_facets(*graph(field), box)[1])


def volume(brep: Brep) -> float:
    assert not len(connectivity.find_unmatched_edges(brep))
    return float(integral_properties.volume(integral_properties.integrate_faces(brep))[0])


def sample_volume(field: StrutsField, lo: np.ndarray, hi: np.ndarray) -> tuple[float, float]:
    """The volume of a field in a box by random points, and its standard error."""
    inside = (field(lo + (hi - lo) * np.random.default_rng(5).random((200_000, 3))) < 0).mean()
    whole = float(np.prod(hi - lo))
    return inside * whole, whole * float(np.sqrt(inside * (1 - inside) / 200_000))


def star(directions: np.ndarray, diameter: float, node_radius: float) -> StrutsField:
    ends = 12 * directions / np.linalg.norm(directions, axis=1)[:, None]
    edges = [[0, k + 1] for k in range(len(ends))]
    return fields.struts(np.concatenate([np.zeros((1, 3)), ends]), edges, diameter, node_radius)


@given(st.lists(st.tuples(*[st.floats(-2, 2)] * 3), min_size=1, max_size=8))
def test_the_envelope_is_the_greatest_of_its_functions(rows: list[tuple[float, float, float]]) -> None:
    waves = np.array(rows)
    found = find_envelope(Waves(waves), 0.0, 2 * np.pi)
    angles = np.linspace(0, 2 * np.pi, 101)
    expected = Waves(waves).values(angles).max(axis=0)
    np.testing.assert_allclose([found.value(a) for a in angles], expected, atol=1e-6)


def test_a_single_strut_is_a_capsule() -> None:
    capsule = fields.struts([[1, 2, 3], [4, 6, 3]], [[0, 1]], 2.0)
    assert volume(bound(capsule)) == pytest.approx(np.pi * 5 + 4 / 3 * np.pi, rel=1e-9)


def test_struts_that_cross_have_the_volume_of_steinmetz() -> None:
    cross = fields.struts(
        [[-5, 0, 0], [5, 0, 0], [0, -5, 0], [0, 5, 0], [0, 0, 0]], [[0, 4], [4, 1], [2, 4], [4, 3]], 2.0
    )
    expected = 2 * (10 * np.pi + 4 / 3 * np.pi) - 16 / 3  # the common part of both cylinders
    assert volume(bound(cross)) == pytest.approx(expected, rel=1e-9)


WITH_BALLS = [(kind, 0.9 * (number % 2)) for number, kind in enumerate(KINDS)]
"""Kinds of struts with and without balls at their nodes, in turn."""


@settings(max_examples=15, deadline=None)
@given(st.integers(2, 7), st.integers(0, 1000), st.sampled_from([0.0, 0.6, 0.9, 1.6]))
def test_a_node_of_any_struts_is_closed_and_has_the_fields_volume(count: int, seed: int, node_radius: float) -> None:
    directions = np.random.default_rng(seed).normal(size=(count, 3))
    field = star(directions, 1.0, node_radius)
    contact = find_contact(*graph(field))
    if contact is not None and contact.ratio <= 1:
        return
    expected, error = sample_volume(field, np.full(3, -14.0), np.full(3, 14.0))
    assert abs(volume(bound(field)) - expected) < 5 * error


@pytest.mark.parametrize(("kind", "node_radius"), WITH_BALLS)
def test_a_cell_of_every_kind_fills_what_its_field_does(kind: str, node_radius: float) -> None:
    field = fields.strut_lattice(kind, 10.0, 1.0, node_radius=node_radius)
    brep = bound(field, BOX)
    expected, error = sample_volume(field, *BOX)
    assert abs(volume(brep) - expected) < 4 * error
    assert (brep.vertices >= -1e-9).all()
    assert (brep.vertices <= 10 + 1e-9).all()


@pytest.mark.parametrize(("kind", "node_radius"), WITH_BALLS)
@pytest.mark.slow
def test_a_cell_has_the_volume_of_an_integral_over_the_angle_of_each_strut(kind: str, node_radius: float) -> None:
    field = fields.strut_lattice(kind, 10.0, 1.0, node_radius=node_radius)
    assert volume(bound(field, BOX)) == pytest.approx(exact_volume(field, *BOX, steps=2000), rel=3e-7)


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "diamond"])  # its sides cut unlike halves of joints
def test_opposite_sides_have_the_same_vertices(kind: str) -> None:
    vertices = bound(fields.strut_lattice(kind, 10.0, 1.6), BOX).vertices
    for axis in range(3):
        low, high = (np.delete(vertices[np.abs(vertices[:, axis] - side) < 1e-9], axis, axis=1) for side in (0.0, 10.0))
        assert len(low) == len(high)
        assert np.linalg.norm(low[:, None] - high, axis=2).min(axis=1).max() < 1e-6


def test_a_cell_of_bcc_has_as_few_faces_as_can_be() -> None:
    brep = bound(fields.strut_lattice("bcc", 10.0, 1.0), BOX)
    assert len(brep.faces) == 8 * 2 + 8 * 3  # half cylinders, and three sides of the box at each corner


def test_struts_in_the_sides_of_the_box_are_halved() -> None:
    field = fields.strut_lattice("cubic", (10.0, 8.0, 6.0), 1.0)
    whole = volume(
        bound(fields.strut_lattice("cubic", (10.0, 8.0, 6.0), 1.0, 2), (np.zeros(3), np.array([20.0, 16, 12])))
    )
    assert whole == pytest.approx(8 * volume(bound(field, (np.zeros(3), np.array([10.0, 8, 6])))), rel=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "node_radius"), [("octet", 0.0), ("kelvin", 0.8)])
def test_classes_of_struts_change_nothing(kind: str, node_radius: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two cells against one of them, against the graph, and against every strut worked out by itself."""
    field, box = fields.strut_lattice(kind, 10.0, 1.0, (2, 1, 1), node_radius), (np.zeros(3), np.array([20.0, 10, 10]))
    brep = bound(field, box)
    assert volume(brep) == pytest.approx(2 * volume(bound(fields.strut_lattice(kind, 10.0, 1.0, 1, node_radius), BOX)))
    assert measure_solid(brep).betti == (1, len(field.edges) - len(np.unique(field.edges)) + 1, 0)
    assert count_classes(field, box) < len(field.edges)
    monkeypatch.setattr(strut_classes, "_label_rows", lambda rows: (np.arange(len(rows)), np.arange(len(rows))))
    assert count_classes(field, box) == len(field.edges)
    single = bound(field, box)
    assert len(single.faces) == len(brep.faces)
    assert len(single.edges) == len(brep.edges)
    assert volume(single) == pytest.approx(volume(brep), rel=1e-12)


@pytest.mark.slow
def test_more_cells_have_no_more_classes() -> None:
    counts = [
        count_classes(fields.strut_lattice("octet", 10.0, 1.0, n), (np.zeros(3), np.full(3, 10.0 * n))) for n in (4, 5)
    ]
    assert counts[0] == counts[1] < 250


def test_collinear_struts_are_one_without_a_seam() -> None:
    bent = fields.struts([[0, 0, 0], [3, 0, 0], [9, 0, 0]], [[0, 1], [1, 2]], 1.0)
    assert bent.edges.tolist() == [[0, 1]]
    assert len(bent.points) == 2
    beaded = fields.struts([[0, 0, 0], [3, 0, 0], [9, 0, 0]], [[0, 1], [1, 2]], 1.0, 0.8)
    assert len(beaded.edges) == 2


@given(st.integers(0, 1000), st.sampled_from([0.0, 0.9]))
def test_struts_of_unequal_diameters_are_the_union_of_each(seed: int, node_radius: float) -> None:
    rng = np.random.default_rng(seed)
    nodes, diameters = 8 * rng.random((6, 3)), rng.uniform(0.2, 2.5, 5)
    edges = [[0, 1], [1, 2], [2, 3], [0, 4], [4, 5]]
    field = fields.struts(nodes, edges, diameters, node_radius)
    each = [
        fields.struts(nodes, [edge], diameter, node_radius) for edge, diameter in zip(edges, diameters, strict=True)
    ]
    points = rng.uniform(-3, 11, (200, 3))
    np.testing.assert_allclose(field(points), np.min([one(points) for one in each], axis=0), rtol=0, atol=1e-12)


def test_collinear_struts_of_unequal_diameters_stay_two() -> None:
    stepped = fields.struts([[0, 0, 0], [3, 0, 0], [9, 0, 0], [12, 0, 0]], [[0, 1], [1, 2], [2, 3]], [1.0, 0.5, 0.5])
    assert stepped.edges.tolist() == [[0, 1], [1, 2]]
    assert stepped.radii.tolist() == [[0.5, 0.5], [0.25, 0.25]]
    assert repr(stepped) == "StrutsField(3 points, 2 struts, diameters from 0.5 to 1)"


@pytest.mark.parametrize(
    ("diameter", "message"),
    [
        ([1.0, 2.0], "diameter has 2 values for 1 edges: give one number, one for each edge, or a pair"),
        ([0.0], "holds 0 at index 0, and must be positive"),
        ([[1.0]], r"of shape \(1, 1\) must have one value or two for each edge"),
        ([[1.0, 0.0]], "holds 0 at index 0, and must be positive"),
        (-1.0, "diameter -1.0"),
    ],
)
def test_diameters_that_no_strut_has_are_refused(diameter: object, message: str) -> None:
    with pytest.raises(InvalidRequest, match=message):
        fields.struts([[0, 0, 0], [1, 0, 0]], [[0, 1]], diameter)


@pytest.mark.parametrize(
    ("points", "edges", "message"),
    [
        ([[0, 0, 0], [1, 0, 0]], [[0, 2]], "edge 0 joins nodes 0 and 2: the nodes are numbered from 0 to 1"),
        ([[0, 0, 0], [1, 0, 0], [1, 0, 0]], [[0, 1], [1, 2]], "edge 1 between nodes 1 and 2 has no length"),
        ([[0, 0, 0], [1, 0, 0]], [[0, 1], [1, 0]], "edge 1 joins nodes 1 and 0 once more"),
        ([[0, 0, 0], [1, 0, 0]], [[0.0, 1.0]], "holds float64, no whole numbers"),
        ([[0, 0], [1, 0]], [[0, 1]], r"points \(2, 2\)"),
    ],
)
def test_a_graph_that_is_none_is_refused(points: object, edges: object, message: str) -> None:
    with pytest.raises(InvalidRequest, match=message):
        fields.struts(points, edges, 0.1)


@pytest.mark.parametrize(
    ("points", "edges", "ratio"),
    [
        ([[0, 0, 0], [9, 0, 0], [0, 0, 0.8], [9, 0, 0.8]], [[0, 1], [2, 3]], 0.8),  # side by side
        ([[0, 0, 0], [9, 0, 0], [4, -3, 0.9], [4, 3, 0.9]], [[0, 1], [2, 3]], 0.9),  # across
        ([[0, 0, 0], [9, 0, 0], [4, 0, 0.7], [4, 0, 6]], [[0, 1], [2, 3]], 0.7),  # an end above a strut
        ([[0, 0, 0], [0.5, 0, 0], [0, 5, 0], [0.5, 5, 0]], [[0, 1], [0, 2], [1, 3]], 0.5),  # shorter than its joints
    ],
)
def test_struts_that_touch_are_found(points: list[list[float]], edges: list[list[int]], ratio: float) -> None:
    contact = find_contact(np.array(points, float), np.array(edges), *[np.full(len(points), 0.5)] * 2)
    assert contact is not None
    assert contact.ratio == pytest.approx(ratio)


def conical_star(count: int, seed: int, node_radius: float) -> StrutsField:
    """Struts of radius 1 in a node, with radii of 0.3 to 1.8 at their other ends, no two within 40 degrees."""
    rng = np.random.default_rng(seed)
    directions: list[np.ndarray] = []
    while len(directions) < count:
        tried = rng.normal(size=3)
        tried /= np.linalg.norm(tried)
        if all(tried @ other < np.cos(np.radians(40)) for other in directions):
            directions.append(tried)
    ends = np.array(directions) * rng.uniform(9, 12, (count, 1))
    diameters = 2 * np.column_stack([np.ones(count), rng.uniform(0.3, 1.8, count)])
    edges = [[0, k + 1] for k in range(count)]
    return fields.struts(np.concatenate([np.zeros((1, 3)), ends]), edges, diameters, node_radius)


def test_a_conical_strut_is_the_hull_of_two_balls() -> None:
    first, last, length = 1.0, 0.4, 6.0
    sine = (first - last) / length
    caps = [np.pi * r**3 * (2 - 3 * s + s**3) / 3 for r, s in ((first, -sine), (last, sine))]
    a, b = (r * np.sqrt(1 - sine**2) for r in (first, last))
    frustum = np.pi * (length + (last - first) * sine) * (a**2 + a * b + b**2) / 3
    hull = fields.struts([[0, 0, 0], [length, 0, 0]], [[0, 1]], [[2 * first, 2 * last]])
    assert volume(bound(hull)) == pytest.approx(sum(caps) + frustum, rel=1e-12)


@settings(max_examples=6)
@given(st.integers(2, 7), st.integers(0, 2**20), st.sampled_from([0.0, 1.3]))
def test_a_node_of_any_cones_is_closed_and_has_the_fields_volume(count: int, seed: int, node_radius: float) -> None:
    field = conical_star(count, seed, node_radius)
    contact = find_contact(*graph(field))
    assert contact is not None
    assume(contact.ratio > 1.05)
    brep = bound(field)
    assert connectivity.is_closed(brep)
    points = np.random.default_rng(seed).uniform(-15, 15, (400_000, 3))
    share = (field(points) < 0).mean()
    assert abs(volume(brep) / 30**3 - share) < 4.5 * np.sqrt(share / len(points))


def test_a_graded_lattice_of_struts_has_cones_between_its_nodes() -> None:
    field = fields.strut_lattice("bcc", 10.0, lambda p: 1.0 + 0.08 * p[:, 2], cells=(1, 1, 2))
    np.testing.assert_allclose(field.diameters, 1.0 + 0.08 * field.points[field.edges][..., 2])
    box = np.zeros(3), np.array([10.0, 10, 20])
    brep = bound(field, box)
    assert connectivity.is_closed(brep)
    points = np.random.default_rng(2).random((400_000, 3)) * box[1]
    share = (field(points) < 0).mean()
    assert abs(volume(brep) / 2000 - share) < 4 * np.sqrt(share / len(points))
    by_formula = fields.strut_lattice("bcc", 10.0, "1 + 0.08*z", cells=(1, 1, 2))
    np.testing.assert_allclose(by_formula.radii, field.radii)
    with pytest.raises(InvalidRequest, match=r"diameter is -0.\d* at the node .*, and must be positive"):
        fields.strut_lattice("bcc", 10.0, lambda p: 1.0 - 0.08 * p[:, 2], cells=(1, 1, 2))


def test_a_thin_strut_without_a_ball_ends_in_a_disc() -> None:
    pair, radii = np.array([[0, 1]]), np.array([0.95, 0.95])
    thin = build_strut_brep(np.array([[0.0, 0, 0], [0, 9, 0]]), pair, radii, np.array([0.0, 0.95]))
    assert volume(thin) == pytest.approx(np.pi * (0.95**2 * 9 + 2 / 3 * 0.95**3), rel=1e-9)


def test_borders_that_nearly_meet_in_a_point_close() -> None:
    """Six struts in a plane but for a millionth, as in a file of single precision: their borders meet in two poles."""
    angles = np.arange(6) * np.pi / 3 + 0.1
    ends = np.column_stack([np.cos(angles), np.sin(angles), 1e-6 * np.random.default_rng(3).uniform(-1, 1, 6)])
    field = star(ends, 2.0, 0.0)
    brep = bound(field)
    assert connectivity.is_closed(brep)
    assert brep.edges.deviation.max() < 1e-4
    assert volume(brep) == pytest.approx(volume(bound(star(ends * [1, 1, 0], 2.0, 0.0))), rel=1e-5)


def test_cones_that_leave_a_node_side_by_side_are_refused() -> None:
    ends = [[0, 0, 0], [10, 0, 0], [10, 1.0, 0]]
    with pytest.raises(TrimmingError, match="nearly one direction"):
        bound(fields.struts(ends, [[0, 1], [0, 2]], [[1.0, 4.0], [1.0, 0.5]]))


def test_cones_keep_their_ends_where_a_map_lays_nodes_on_each_other() -> None:
    """The third node becomes the first one, so that the strut between the second and the third begins at its other end."""
    field = fields.struts([[0, 0, 0], [5, 1, 0], [10, 0, 0], [3, 3, 0]], [[0, 3], [1, 2]], [[2.0, 2.0], [1.0, 2.0]])
    closed = map_struts(field, lambda p: np.column_stack([p[:, 0] % 10.0, p[:, 1:]]))
    at_ends = dict(zip(closed.edges.ravel().tolist(), closed.diameters.ravel().tolist(), strict=True))
    assert {tuple(closed.points[node].tolist()): diameter for node, diameter in at_ends.items()} == {
        (0.0, 0.0, 0.0): 2.0,
        (5.0, 1.0, 0.0): 1.0,
        (3.0, 3.0, 0.0): 2.0,
    }


@pytest.mark.parametrize("kind", FLAT_KINDS)
def test_nets_on_a_cylinder_have_the_tunnels_of_their_graph(kind: str) -> None:
    radius = 12 * 3 / (2 * np.pi)
    field = map_struts(fields.strut_lattice(kind, 3.0, 0.3, cells=(12, 1, 2)), maps.cylinder(radius))
    np.testing.assert_allclose(np.hypot(*field.points[:, :2].T), radius)
    assert measure_solid(bound(field)).betti == (1, len(field.edges) - len(field.points) + 1, 0)
