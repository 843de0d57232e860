"""Bodies with free-form faces read exactly and cut on the patches' parameters: closed, valid, and complements of each other."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

pytest.importorskip("OCP")

import build123d as bd

from benchmarks.small_bodies import FREE_FORM_BODIES
from tests.shapes.misfits import volume
from tests.trimming.conftest import Cover, cover
from tests.trimming.network_operands import trim
from tpmscad.brep import connectivity
from tpmscad.brep.boundary_representation import reverse_faces
from tpmscad.brep.moments import integral_properties
from tpmscad.errors import NotQuadric
from tpmscad.kernel.body_import.body_brep import FreeFormBody, brep_from_shape, read_free_form_body
from tpmscad.kernel.boolean.boolean_operations import intersect_solids
from tpmscad.kernel.build.solids import build_solids
from tpmscad.kernel.measure.mass_properties import face_moments
from tpmscad.kernel.measure.validity import is_brep_valid
from tpmscad.kernel.occt.construction import make_shell, make_solid
from tpmscad.kernel.occt.exploration import faces_of, unwrap

pytestmark = [pytest.mark.kernel, pytest.mark.slow]

__all__ = ["cover"]


def place(body: bd.Shape, angles: tuple[float, float, float]) -> bd.Shape:
    """The body turned, with its bounding box about the middle of a cell."""
    turned = bd.Rotation(*angles) * body
    return bd.Pos(*(np.array([5.0, 5.0, 5.0]) - np.array(tuple(turned.bounding_box().center())))) * turned


SURFACES = dict(zip(FREE_FORM_BODIES, itertools.cycle(("P", "gyroid"))))
"""The surface of the lattice that each body is filled with."""


@pytest.fixture(scope="module", params=FREE_FORM_BODIES)
def case(request: pytest.FixtureRequest) -> tuple[bd.Shape, FreeFormBody, str]:
    body = place(FREE_FORM_BODIES[request.param](), (20.0, 35.0, 50.0))
    return body, read_free_form_body(body), SURFACES[request.param]


def test_a_body_is_read_closed_with_its_volume_and_tight_edges(case) -> None:
    body, read, _ = case
    assert len(connectivity.find_unmatched_edges(read.brep)) == 0
    assert volume(read.brep) == pytest.approx(face_moments(faces_of(unwrap(body)))[:, 1].sum(), rel=1e-6)
    assert read.brep.edges.deviation.max() < 5e-8
    assert len(read.free_form) > 0
    for number, surface in read.free_form.items():
        assert read.brep.carriers[number] is surface.spline
        low, high = read.brep.vertices.min(axis=0), read.brep.vertices.max(axis=0)
        assert 0 < surface.continuation < np.linalg.norm(high - low)
    with pytest.raises(NotQuadric, match="free-form"):
        brep_from_shape(body)


def test_what_is_inside_the_lattice_and_what_is_outside_make_up_the_body(case, cover: Cover) -> None:
    _, read, name = case
    lattice = cover(name, (1, 1, 1), (0.07, 0.11, 0.19), (-0.04, 0.04))
    parts = [trim(half, read.brep) for half in (lattice, reverse_faces(lattice))]
    whole, (wall, rest) = volume(read.brep), (volume(part.brep) for part in parts)
    assert 0.05 * whole < wall < 0.6 * whole
    # Edges deviate by up to 1e-7 from the surfaces on both of their sides; the faces of both parts share them.
    assert wall + rest == pytest.approx(whole, rel=1e-7)
    for part in parts:
        assert part.report.max_deviation < 3e-7
        built = build_solids(part.brep)
        assert is_brep_valid(part.brep, built.known_faces)


def test_it_is_what_the_kernel_cuts(cover: Cover) -> None:
    body = place(FREE_FORM_BODIES["elbow"](), (20.0, 35.0, 50.0))
    read, lattice = read_free_form_body(body), cover("P", (1, 1, 1), (0.07, 0.11, 0.19), (-0.04, 0.04))
    own = volume(trim(lattice, read.brep).brep)
    box = brep_from_shape(unwrap(bd.Pos(5, 5, 5) * bd.Box(9.9, 9.9, 9.9)))
    block = build_solids(trim(lattice, box).brep)
    faces = [face for solid in intersect_solids(block.shape, unwrap(body)) for face in faces_of(solid)]
    assert own == pytest.approx(face_moments(faces)[:, 1].sum(), rel=1e-6)


def test_tags_are_those_of_the_shapes_faces() -> None:
    body = FREE_FORM_BODIES["ellipse"]()
    names = [f"face {i}" for i in range(len(body.faces()))]
    read = read_free_form_body(body, names)
    area = dict.fromkeys(names, 0.0)
    moments = integral_properties.integrate_faces(read.brep)
    for tag, own in zip(read.brep.faces.tag.tolist(), moments.area.tolist(), strict=True):
        area[names[tag]] += own
    expected = {name: face.area for name, face in zip(names, body.faces(), strict=True)}
    assert area == pytest.approx(expected, rel=1e-4)  # the kernel's area of an extruded ellipse is 5e-6 off


def lemon_volume(radius: float, offset: float) -> float:
    """Of the lens that an arc bounds, whose centre is beyond the axis by `offset`: pi int (sqrt(R^2 - z^2) - c)^2 dz."""
    tip = np.sqrt(radius**2 - offset**2)
    area = offset * tip + radius**2 * np.arcsin(tip / radius)
    return float(2 * np.pi * ((radius**2 + offset**2) * tip - tip**3 / 3 - offset * area))


def test_a_self_intersecting_torus_is_read_with_its_tips() -> None:
    from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeFace
    from OCP.Geom import Geom_ToroidalSurface
    from OCP.gp import gp_Ax3, gp_Dir, gp_Pnt

    surface = Geom_ToroidalSurface(gp_Ax3(gp_Pnt(1, 2, 3), gp_Dir(1, 2, 2)), 2.0, 4.0)
    half = np.pi / 3  # of the tube, from its innermost circle to the axis
    face = BRepBuilderAPI_MakeFace(surface, 0.0, 2 * np.pi, np.pi - half, np.pi + half, 1e-7).Face()
    read = read_free_form_body(make_solid([make_shell([face.Reversed()])]))  # the normals of the lens point into it
    assert volume(read.brep) == pytest.approx(lemon_volume(4.0, 2.0), rel=1e-9)
    assert len(read.brep.faces) == 2
    solids = build_solids(read.brep)
    assert is_brep_valid(read.brep, solids.known_faces)


def test_a_body_with_a_sharp_tip_is_cut(cover: Cover) -> None:
    """The distance has no gradient at the tip, and curves turn sharply beside it."""
    side = bd.Spline((3.2, 0), (2.0, 2.4), (0, 5.2))
    profile = bd.make_face([side, *bd.Polyline((0, 5.2), (0, 0), (3.2, 0)).edges()])
    read = read_free_form_body(place(bd.revolve(bd.Plane.XZ * profile, bd.Axis.Z), (229.3, 97.1, 14.8)))
    lattice = cover("gyroid", (1, 1, 1), (0.0166, 0.8133, 0.9128), (-0.04, 0.04))
    parts = [trim(half, read.brep).brep for half in (lattice, reverse_faces(lattice))]
    assert sum(map(volume, parts)) == pytest.approx(volume(read.brep), rel=1e-7)
    for part in parts:
        assert is_brep_valid(part, build_solids(part).known_faces)
