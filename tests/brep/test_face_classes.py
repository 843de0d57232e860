"""Classes of congruent faces and simple planar faces: rigid copies share a class, whatever differs has a class of its own."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from tests.shapes.box_shapes import plane_box
from tests.shapes.mutants import move_face, move_pole_of_edge, move_pole_of_pcurve, move_vertex, split_vertex
from tpmscad.brep.boundary_representation import Brep, Edges, EdgeUses, Faces, move_brep
from tpmscad.brep.carriers import Plane
from tpmscad.brep.connectivity import find_broken_loops, is_closed
from tpmscad.brep.face_classes import group_congruent_faces
from tpmscad.brep.planar_faces import find_simple_planar_faces
from tpmscad.brep.welding import weld_patches
from tpmscad.rigid_motion import Motion
from tpmscad.splines.bspline import BSplineSurface, line_segment

RESOLUTION = 1e-8


def strip(count: int) -> Brep:
    """`count` copies of a curved patch side by side along x."""
    u, v = np.meshgrid(np.linspace(0, 1, 4), np.linspace(0, 1, 4), indexing="ij")
    poles = np.stack([u, v, u * (1 - u) * v], axis=-1)
    knots = np.repeat([0.0, 1.0], 4)
    motion = Motion.translations(np.arange(count)[:, None] * np.array([1.0, 0.0, 0.0]))
    which, sense = np.zeros(count, int), np.ones(count, int)
    return weld_patches([BSplineSurface(poles, knots, knots, 3, 3)], which, motion, sense, which, ["a"])


def test_rigid_copies_are_one_class_whichever_neighbour_owns_their_edges() -> None:
    brep = strip(5)
    assert len(np.unique(brep.uses.sense.reshape(5, 4), axis=0)) > 1  # the first neighbour owns the edge between two
    assert len(group_congruent_faces(brep, RESOLUTION).first) == 1


def test_classes_outlive_rotations_and_mirrors_of_the_whole() -> None:
    brep = strip(4)
    a, b = 0.3, 1.1
    turn = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]]) @ np.array(
        [[1, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]]
    )
    for rotation in (turn, turn @ np.diag([-1.0, 1.0, 1.0])):
        moved = move_brep(brep, Motion(rotation, np.array([7.0, -3.0, 11.0])))
        assert len(group_congruent_faces(moved, RESOLUTION).first) == 1


@pytest.mark.parametrize("fault", [move_face, move_pole_of_edge, move_pole_of_pcurve, move_vertex])
def test_a_face_that_differs_leaves_its_class(fault) -> None:
    brep = strip(6)
    assert len(group_congruent_faces(fault(brep, np.random.default_rng(3)), RESOLUTION).first) > 1


def test_a_difference_below_the_resolution_is_none() -> None:
    brep = strip(3)
    poles = brep.faces.motion.translation + 1e-12
    near = replace(brep, faces=replace(brep.faces, motion=Motion(brep.faces.motion.rotation, poles)))
    assert len(group_congruent_faces(near, RESOLUTION).first) == 1


def test_a_vertex_that_is_split_breaks_a_loop_though_every_edge_stays_matched() -> None:
    box = plane_box()
    assert not len(find_broken_loops(box))
    split = split_vertex(box, np.random.default_rng(0))
    assert is_closed(split)
    assert len(find_broken_loops(split)) >= 1


def test_faces_of_a_box_are_simple_and_stay_so_far_away() -> None:
    for box in (plane_box(), plane_box(translation=(1e3, -2e3, 5e2))):
        assert find_simple_planar_faces(box, 1e-7).all()


def test_a_loop_that_crosses_itself_runs_backwards_or_leaves_the_plane_is_not_simple() -> None:
    box = plane_box()
    assert find_simple_planar_faces(box, 1e-7)[0]
    uses = slice(int(box.faces.use_start[0]), int(box.faces.use_start[1]))
    backwards = box.uses.sense.copy()
    backwards[uses] *= -1
    order = np.arange(len(box.uses))
    order[uses] = order[uses][::-1]
    turned = replace(
        box, uses=replace(box.uses, edge=box.uses.edge[order], sense=backwards[order], pcurve=box.uses.pcurve[order])
    )
    assert not find_simple_planar_faces(turned, 1e-7)[0]
    lifted = replace(
        box, edges=replace(box.edges, motion=Motion(box.edges.motion.rotation, box.edges.motion.translation + 1e-3))
    )
    assert not find_simple_planar_faces(lifted, 1e-7).any()
    swapped = order.copy()
    swapped[uses] = np.arange(uses.start, uses.stop)[[1, 0, 2, 3]]
    mixed = replace(box, uses=replace(box.uses, edge=box.uses.edge[swapped], sense=box.uses.sense[swapped]))
    assert not find_simple_planar_faces(mixed, 1e-7)[0]


def test_a_loop_of_very_short_and_very_long_edges_takes_no_memory() -> None:
    """A comb of notches of 1e-6 in a square of 1000: chords as short as most of its edges would be a billion."""
    notches = np.array([[i * 1e-6 + x, y] for i in range(20) for x, y in ((0, 0), (0.5e-6, 1e-6))])
    corners = np.concatenate([notches, [[1e3, 0], [1e3, 1e3], [0, 1e3]]])
    points = np.column_stack([corners, np.zeros(len(corners))])
    n, none = len(points), np.full(len(points), -1)
    order = np.arange(n)
    plane = Plane(np.zeros(3), np.array([1.0, 0, 0]), np.array([0, 0, 1.0]))
    face = Brep(
        (plane,),
        tuple(line_segment(a, b) for a, b in zip(points, np.roll(points, -1, axis=0), strict=True)),
        (),
        points,
        Edges(order, Motion.identity(n), np.tile([0.0, 1.0], (n, 1)), order, np.roll(order, -1), np.zeros(n)),
        EdgeUses(order, np.ones(n, int), none),
        Faces(
            *(np.zeros(1, int), Motion.identity(1), np.ones(1, int), np.zeros(1, int)),
            np.array([0, 1]),
            np.array([0, n]),
        ),
        ("a",),
    )
    tracemalloc.start()
    try:
        find_simple_planar_faces(face, 1e-9)
        assert tracemalloc.get_traced_memory()[1] < 3e8
    finally:
        tracemalloc.stop()
