"""Faces of a file join with continuous position, tangent plane and, in lattices, curvature, as the kernel evaluates them.

OCCT evaluates its own faces along its own pcurves; the boundary representation is not used. Joined faces differ from gap
faces in degree: a ruled gap face has degree 1 in one direction.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytestmark = pytest.mark.kernel

from OCP.BRep import BRep_Tool
from OCP.BRepAdaptor import BRepAdaptor_Curve, BRepAdaptor_Curve2d, BRepAdaptor_Surface
from OCP.GeomAbs import GeomAbs_BSplineSurface
from OCP.gp import gp_Pnt, gp_Vec
from OCP.TopAbs import TopAbs_REVERSED, TopAbs_VERTEX
from OCP.TopExp import TopExp_Explorer

import tpmscad
from tpmscad import fields, surfaces
from tpmscad.brep.boundary_representation import scale_brep
from tpmscad.kernel.build.solids import build_solids
from tpmscad.kernel.occt import convert
from tpmscad.kernel.occt.exploration import edges_of, faces_of
from tpmscad.kernel.step.brep_writer import write_step
from tpmscad.kernel.step.step_reader import FITTING_PRECISION, read_step
from tpmscad.lattices import copies
from tpmscad.lattices.primitive import fit_offset_surfaces

CELL = 10.0
SHARES = np.array([0.0, *np.random.default_rng(7).uniform(size=9), 1.0])
"""Where joints are measured: the ends of an edge, and nine places at random between them."""

GAP, TURN, BEND = 1e-9, 1e-6, 1e-6
"""The gap in cells, the tangent jump in degrees, the curvature jump over the greatest curvature at any joint."""


@dataclass(frozen=True)
class Here:
    """A face at one point: where it is (3,), its outward unit normal (3,), its curvature tensor (3, 3)."""

    point: np.ndarray
    normal: np.ndarray
    tensor: np.ndarray


def evaluate(face: Any, surface: Any, u: float, v: float) -> Here:
    """From the kernel's derivatives: K = A I^-1 II I^-1 A^T, A the tangents, I and II the fundamental forms."""
    p, (du, dv, duu, dvv, duv) = gp_Pnt(), (gp_Vec() for _ in range(5))
    surface.D2(u, v, p, du, dv, duu, dvv, duv)
    a, b, aa, bb, ab = (np.array(d.Coord()) for d in (du, dv, duu, dvv, duv))
    n = np.cross(a, b)
    n *= (-1 if face.Orientation() == TopAbs_REVERSED else 1) / np.linalg.norm(n)
    tangents = np.column_stack([a, b])
    dual = tangents @ np.linalg.inv(tangents.T @ tangents)
    return Here(np.array(p.Coord()), n, dual @ np.array([[aa @ n, ab @ n], [ab @ n, bb @ n]]) @ dual.T)


def smooth(surface: Any) -> bool:
    return surface.GetType() == GeomAbs_BSplineSurface and min(surface.UDegree(), surface.VDegree()) > 1


@dataclass(frozen=True)
class Joins:
    """The worst of all edges that two smooth faces share, or of all pairs of smooth faces at a vertex; what was met there."""

    gap: float
    turn: float
    bend: float
    valences: tuple[int, ...]  # smooth faces at each edge or vertex, sorted


def compare(groups: list[list[Here]], steepest: float, valences: list[int]) -> Joins:
    pairs = [pair for group in groups for pair in combinations(group, 2)]
    gap = max(np.linalg.norm(a.point - b.point) for a, b in pairs)
    turn = max(np.arctan2(np.linalg.norm(np.cross(a.normal, b.normal)), a.normal @ b.normal) for a, b in pairs)
    bend = max(np.linalg.norm(a.tensor - b.tensor, ord=2) for a, b in pairs)
    return Joins(float(gap) / CELL, float(np.degrees(turn)), float(bend / steepest), tuple(sorted(valences)))


def joins(shape: Any, gap: float = GAP * CELL) -> tuple[Joins, Joins]:
    """Over every edge between smooth faces, the edge's own curve included; at every vertex, the vertex's own place included."""
    along: dict[int, list[tuple[Any, list[Here]]]] = defaultdict(list)
    at: dict[int, list[tuple[Any, Any, Here]]] = defaultdict(list)
    for face in faces_of(shape):
        surface = BRepAdaptor_Surface(face)
        if not smooth(surface):
            continue
        for edge in edges_of(face):
            curve, flat = BRepAdaptor_Curve(edge), BRepAdaptor_Curve2d(edge, face)
            row, first = [], curve.FirstParameter()
            for t in (first + (curve.LastParameter() - first) * SHARES).tolist():
                row.append(evaluate(face, surface, *flat.Value(t).Coord()))
                assert np.linalg.norm(row[-1].point - curve.Value(t).Coord()) <= gap
            along[hash(edge)].append((edge, row))
            vertices = TopExp_Explorer(edge, TopAbs_VERTEX)
            while vertices.More():
                vertex = convert.as_vertex(vertices.Current())
                place = np.array(BRep_Tool.Pnt_s(vertex).Coord())
                end = min((row[0], row[-1]), key=lambda here: np.linalg.norm(here.point - place))
                assert np.linalg.norm(end.point - place) <= gap
                at[hash(vertex)].append((vertex, face, end))
                vertices.Next()

    steepest = max(np.linalg.norm(here.tensor, ord=2) for uses in along.values() for _, row in uses for here in row)
    for uses in (*along.values(), *at.values()):
        assert all(use[0].IsSame(uses[0][0]) for use in uses)  # hashes may collide
    shared = [[row for _, row in uses] for uses in along.values() if len(uses) == 2]
    assert max(len(uses) for uses in along.values()) == 2
    edges = compare([list(pair) for rows in shared for pair in zip(*rows, strict=True)], steepest, [2] * len(shared))
    corners = [[here for _, _, here in uses] for uses in at.values()]
    valences = [len({hash(face) for _, face, _ in uses}) for uses in at.values()]
    return edges, compare(corners, steepest, valences)


CASES = {
    "gyroid": ("gyroid", (1, 1, 1), (-0.06, 0.06), 1e-4),
    "gyroid, unequal offsets, 1e-6": ("gyroid", (1, 1, 1), (-0.03, 0.09), 1e-6),
    "diamond": ("diamond", (1, 1, 1), (-0.05, 0.05), 1e-4),
    "schwarz_p": ("schwarz_p", (1, 1, 1), (-0.08, 0.08), 1e-4),
    "schwarz_p, two cells": ("schwarz_p", (2, 1, 1), (-0.08, 0.08), 1e-5),
}


@pytest.mark.parametrize("case", CASES)
def test_offset_faces_read_back_join_with_continuous_curvature_at_every_edge_and_vertex(
    case: str, tmp_path: Path
) -> None:
    name, cells, layers, tol = CASES[case]
    sheet = fit_offset_surfaces(name, "minimal", layers, 1.0, tol).surfaces
    placed = copies.place_whole_cells(name, cells, np.zeros(3))
    brep = scale_brep(copies.build_natural_lattice(surfaces.patch_symmetry(name), sheet, placed), CELL)
    write_step(brep, build_solids(brep).nesting, tmp_path / "lattice.step")
    shape = read_step(tmp_path / "lattice.step").shape
    edges, vertices = joins(shape)

    whole = sum(smooth(BRepAdaptor_Surface(face)) for face in faces_of(shape))
    gaps = len(faces_of(shape)) - whole  # each lies on two open sides
    assert whole == 2 * surfaces.find_surface(name).patches_per_cell * np.prod(cells)
    assert len(edges.valences) == (4 * whole - 2 * gaps) / 2
    assert max(vertices.valences) == 6
    assert_continuous(edges, vertices)


@pytest.mark.slow
def test_so_do_those_of_a_lattice_cut_by_a_box(tmp_path: Path) -> None:
    model = tpmscad.lattice("gyroid", cell=CELL, kind="skeletal", tol=1e-3, boundary="box")
    model.export_step(tmp_path / "lattice.step")
    # OCCT's reader fits the pcurves of cuts, which no file holds, to its own precision
    edges, vertices = joins(read_step(tmp_path / "lattice.step").shape, FITTING_PRECISION)
    assert max(vertices.valences) == 6
    assert_continuous(edges, vertices)


def test_joints_of_a_field_are_tangent_in_the_file_and_in_the_certificate(tmp_path: Path) -> None:
    field = fields.rod(fields.tpms("gyroid", CELL), 0.1)
    model = tpmscad.solidify(field, ((0.0, 0.0, 0.0), (CELL, CELL, CELL)), tol=0.01)
    model.export_step(tmp_path / "cell.step")
    edges, _ = joins(read_step(tmp_path / "cell.step").shape)
    assert len(edges.valences) > 100
    assert edges.turn < 1e-3
    assert model.certificate.met
    assert model.certificate.tangent_jump_deg < 1e-6


def assert_continuous(edges: Joins, vertices: Joins) -> None:
    for found in (edges, vertices):
        assert found.gap <= GAP
        assert found.turn <= TURN
        assert found.bend <= BEND
