"""Laws of edits undone in simplified meshes: whatever comes back, the mesh stays a two-manifold of the same topology."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.levelset.test_collapses import full_mesh
from tests.shapes.cut_fields import FIELDS, HI, LO
from tpmscad.levelset.quadmesh.dual_mesh import QuadMesh
from tpmscad.levelset.quadmesh.quality import corner_distortion
from tpmscad.levelset.quadmesh.simplification import edit_history
from tpmscad.levelset.quadmesh.simplification.edit_history import EditHistory
from tpmscad.levelset.quadmesh.simplification.greedy_simplification import simplify_mesh
from tpmscad.levelset.quadmesh.vectors import normalize

FIELD = FIELDS["gyroid"]


@cache
def simplified() -> EditHistory:
    return simplify_mesh(full_mesh("gyroid", share=0.2), FIELD, LO, HI)


def history() -> EditHistory:
    return deepcopy(simplified())


def measure_distortion(mesh: QuadMesh) -> np.ndarray:
    normals = normalize(FIELD.gradient(mesh.vertices))
    return corner_distortion(mesh.vertices, normals, mesh.fixed, mesh.corners)


def directed(mesh: QuadMesh) -> list[tuple[int, int]]:
    rows = [[v for v in corners if v >= 0] for corners in mesh.corners.tolist()]
    return [(row[i - 1], v) for row in rows for i, v in enumerate(row)]


@pytest.mark.slow
@given(draws=st.lists(st.tuples(st.integers(0, 10**6), st.integers(1, 3)), min_size=1, max_size=12))
@settings(max_examples=15, deadline=None)
def test_any_edits_undone_leave_a_two_manifold_of_the_same_topology_on_the_field_and_in_the_box(
    draws: list[tuple[int, int]],
) -> None:
    wanted, original = history(), full_mesh("gyroid", share=0.2)
    for draw, levels in draws:
        numbers = wanted.mesh()[1]
        wanted.undo([int(numbers[draw % len(numbers)])], levels)
    mesh, numbers = wanted.mesh()
    edges = directed(mesh)
    here = set(edges)
    assert len(here) == len(edges)
    on_box = {tuple(sorted(ends)) for ends in mesh.side_ends[mesh.side_plane >= 0].tolist()}
    assert {tuple(sorted(e)) for e in here if e[::-1] not in here} == on_box
    euler = [len(m.vertices) - len(m.side_ends) + len(m.corners) for m in (mesh, original)]
    assert euler[0] == euler[1]
    assert len(numbers) == len(mesh.corners) <= len(original.corners)
    slope = np.linalg.norm(FIELD.gradient(mesh.vertices), axis=1)
    assert (np.abs(FIELD(mesh.vertices)) / slope).max() < 1e-6
    assert ((mesh.vertices >= LO) & (mesh.vertices <= HI)).all()


def test_the_vertices_round_an_undone_edit_return_to_where_they_were_before_it() -> None:
    wanted, moved = history(), 0
    for last in sorted(wanted.edits, reverse=True):
        recorded = wanted.edits[last]
        wanted._undo_edit(last)
        np.testing.assert_array_equal(wanted._vertices[recorded.vertices], recorded.positions)
        moved += (recorded.positions != full_mesh("gyroid", share=0.2).vertices[recorded.vertices]).any()
    assert 0 < moved < len(simplified().edits)


def test_smoothing_that_would_tangle_polygons_is_not_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    edits, differ = simplified().edits, False
    for made in (edits[number].applied.new_numbers for number in sorted(edits)[-5:]):
        smoothed, kept = history(), history()
        assert smoothed.undo(made, 1)
        with monkeypatch.context() as turned:
            turned.setattr(
                edit_history, "smooth_vertices", lambda mesh, *_: replace(mesh, vertices=mesh.vertices[::-1])
            )
            assert kept.undo(made, 1)
        assert measure_distortion(kept.mesh()[0]).max() < 2.5 < measure_distortion(full_mesh("gyroid", share=0.2)).max()
        differ |= not np.array_equal(kept.mesh()[0].vertices, smoothed.mesh()[0].vertices)
    assert differ


@pytest.mark.slow
def test_where_nothing_is_left_to_undo_vertices_go_back_to_where_they_were_to_the_last_bit() -> None:
    wanted, original = history(), full_mesh("gyroid", share=0.2)
    while wanted.undo(wanted.mesh()[1].tolist(), 3):
        pass
    mesh, numbers = wanted.mesh()
    np.testing.assert_array_equal(numbers, np.arange(len(original.corners)))
    np.testing.assert_array_equal(mesh.corners, original.corners)
    np.testing.assert_array_equal(mesh.vertices, original.vertices)


def test_a_side_that_would_come_back_to_where_there_is_one_brings_back_what_made_that_one() -> None:
    wanted = history()
    polygons = wanted.polygons
    last = max(wanted.edits)
    sides = {(p[k - 1], v) for p in wanted.edits[last].applied.old_polygons.values() for k, v in enumerate(p)} - set(
        polygons.polygon_of_half_edge
    )
    assert not wanted._conflicting_edits({last})
    other = next(
        number for number, by in wanted._edit_that_made.items() if by != last and number in polygons.corners_of
    )
    polygons.polygon_of_half_edge[min(sides)] = other
    assert wanted._conflicting_edits({last}) == {wanted._edit_that_made[other]}
