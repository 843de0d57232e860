"""A side of a patch that T-vertices divide is trimmed like a whole one: dividing a patch changes nothing in space."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import BSpline

from tests.shapes.misfits import volume
from tests.trimming.conftest import Cover
from tests.trimming.network_operands import trim
from tpmscad._typing import Array
from tpmscad.brep import connectivity
from tpmscad.brep.boundary_representation import Brep, Edges, EdgeUses, Faces
from tpmscad.rigid_motion import Motion
from tpmscad.splines.bspline import BSplineCurve, BSplineSurface
from tpmscad.trimming.operands.polyhedra import box

LO, HI = np.array([0.4, 0.7, 0.9]), np.array([9.1, 8.3, 9.7])
Use = tuple[int, int, int]


def sides_of(brep: Brep, face: int) -> list[int]:
    """The edge uses of a whole patch along v = v0, u = u1, v = v1 and u = u0, in the order of its loop."""
    surface = brep.carriers[brep.faces.carrier[face]]
    assert isinstance(surface, BSplineSurface)
    (u0, u1), (v0, v1) = surface.domain
    first = brep.faces.use_start[brep.faces.loop_start[face]]
    middles = [brep.pcurves[brep.uses.pcurve[k]](np.array([0.5]))[0] for k in range(first, first + 4)]
    mean = 0.5 * (u0 + u1), 0.5 * (v0 + v1)
    wanted = [(mean[0], v0), (u1, mean[1]), (mean[0], v1), (u0, mean[1])]
    return [first + int(np.argmin([np.linalg.norm(m - w) for m in middles])) for w in wanted]


def divide(brep: Brep, face: int) -> Brep:
    """The same boundary with one patch divided along u = 1/2, which gives its neighbours on sides 0 and 2 a T-vertex each."""
    uses, edges, faces = brep.uses, brep.edges, brep.faces
    bottom, right, top, left = sides_of(brep, face)
    surface, motion = brep.carriers[int(faces.carrier[face])], faces.motion[face]
    assert isinstance(surface, BSplineSurface)
    halves = [first_half(surface), mirrored(first_half(mirrored(surface)))]
    middle = BSplineCurve(halves[0].poles[-1], surface.knots_v, surface.degree_v)
    n_edges, n_vertices = len(edges), len(brep.vertices)
    cut = [int(uses.edge[u]) for u in (bottom, top)]

    low, high = edges.span[cut].T
    span, end = edges.span.copy(), edges.end.copy()
    span[cut, 1], end[cut] = 0.5 * (low + high), n_vertices + np.arange(2)
    new_edges = Edges(
        np.concatenate([edges.curve, edges.curve[cut], [len(brep.curves)]]),
        Motion.concatenate([edges.motion, edges.motion[cut], faces.motion[[face]]]),
        np.concatenate([span, np.column_stack([0.5 * (low + high), high]), [middle.domain]]),
        np.concatenate([edges.start, n_vertices + np.arange(2), [n_vertices]]),
        np.concatenate([end, edges.end[cut], [n_vertices + 1]]),
        np.concatenate([edges.deviation, edges.deviation[cut], [0.0]]),
    )

    def parts(use: Use) -> list[Use]:
        """An edge use, as two where its edge was cut."""
        edge, sense, pcurve = use
        if edge not in cut:
            return [use]
        return [(edge, sense, pcurve), (n_edges + cut.index(edge), sense, pcurve)][::sense]

    def use_of(u: int) -> Use:
        return int(uses.edge[u]), int(uses.sense[u]), int(uses.pcurve[u])

    start = faces.use_start[faces.loop_start]
    loops = [[p for u in range(start[f], start[f + 1]) for p in parts(use_of(u))] for f in range(len(faces))]
    (a, b), (c, d) = parts(use_of(bottom)), parts(use_of(top))
    across = (n_edges + 2, 1, len(brep.pcurves))
    loops[face] = [a, across, d, use_of(left)]
    loops.append([b, use_of(right), c, (across[0], -1, across[2])])
    table = np.array([use for loop in loops for use in loop]).T
    whole = np.append(np.arange(len(faces)), face)
    carrier = faces.carrier[whole].copy()
    carrier[[face, -1]] = len(brep.carriers) + np.arange(2)
    across_uv = BSplineCurve(np.array([[0.5, v] for v in middle.domain]), np.repeat(middle.domain, 2), 1)
    return replace(
        brep,
        carriers=(*brep.carriers, *halves),
        curves=(*brep.curves, middle),
        pcurves=(*brep.pcurves, across_uv),
        vertices=np.concatenate([brep.vertices, motion.apply(middle(np.array(middle.domain)))]),
        edges=new_edges,
        uses=EdgeUses(*table),
        faces=Faces(
            carrier,
            faces.motion[whole],
            faces.sense[whole],
            faces.tag[whole],
            np.arange(len(whole) + 1),
            np.cumsum([0, *map(len, loops)]),
        ),
    )


def first_half(surface: BSplineSurface) -> BSplineSurface:
    """The half of a Bezier patch up to u = 1/2."""
    degree = surface.degree_u
    finer = BSpline(surface.knots_u, surface.poles, degree).insert_knot(0.5, degree)
    return replace(surface, poles=finer.c[: degree + 1], knots_u=np.repeat([0.0, 0.5], degree + 1))


def mirrored(surface: BSplineSurface) -> BSplineSurface:
    """The surface with u counted from its other end."""
    return replace(surface, poles=surface.poles[::-1], knots_u=1.0 - surface.knots_u[::-1])


def middles(brep: Brep) -> Array:
    """A point in the middle of each patch: (F, 3)."""
    points = [brep.carriers[c](0.5, 0.5) for c in brep.faces.carrier.tolist()]  # type: ignore[operator]
    return brep.faces.motion.apply(np.array(points))


@pytest.fixture(scope="module")
def lattice(cover: Cover) -> Brep:
    return cover("schwarz_p", (1, 1, 1), (0.13, 0.21, 0.08), (None, 0.05))


def faces_near(lattice: Brep, plane: float) -> list[int]:
    """Patches whose middle is near a plane of the box, nearest first."""
    x = middles(lattice)
    inside = ((x > LO) & (x < HI)).all(axis=1)
    return [int(f) for f in np.argsort(np.abs(x[:, 0] - plane)) if inside[f]]


@pytest.mark.slow
@pytest.mark.parametrize(("plane", "rank"), [(LO[0], 0), (LO[0], 2), (HI[0], 1), (5.0, 0)])
def test_a_divided_patch_is_trimmed_like_a_whole_one(lattice: Brep, plane: float, rank: int) -> None:
    whole = trim(lattice, box(LO, HI)).brep
    divided = trim(divide(lattice, faces_near(lattice, plane)[rank]), box(LO, HI)).brep
    assert connectivity.is_closed(divided)
    assert len(divided.faces) in (len(whole.faces), len(whole.faces) + 1)
    assert volume(divided) == pytest.approx(volume(whole), rel=1e-9)


def test_a_plane_through_a_t_vertex_is_shifted_or_refused(lattice: Brep) -> None:
    divided = divide(lattice, faces_near(lattice, 5.0)[0])
    vertex = divided.vertices[-1]
    found = trim(divided, box(LO, np.array([vertex[0], HI[1], HI[2]])))
    assert found.report.shifted > 0
    assert connectivity.is_closed(found.brep)
    assert connectivity.is_closed(found.brep)
