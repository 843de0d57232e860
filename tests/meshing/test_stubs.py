"""Ducts in front of openings: conformal, of the openings' cross-section, with the openings at their ends."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.meshing.mesh_facets import boundary_facets
from tests.meshing.test_edge_collapse import areas
from tests.meshing.test_volume_mesh import EXTENT, block
from tpmscad.errors import InvalidRequest
from tpmscad.meshing.volume_mesh import VolumeMesh


def open_block(kind: str) -> VolumeMesh:
    """The block with openings in its lower half at both ends of x and in the middle of its top; two regions."""
    mesh = replace(block(kind), periodic={}, periods=np.full(3, np.nan))
    ((_, facets),) = mesh.facets.items()
    corners = mesh.points[facets[:, :3]]
    low = corners[:, :, 1].max(axis=1) < 0.5 * EXTENT[1] + 1e-9
    at = {
        "channel: opening X-": (np.abs(corners[:, :, 0]).max(axis=1) < 1e-9) & low,
        "channel: opening X+": (np.abs(corners[:, :, 0] - EXTENT[0]).max(axis=1) < 1e-9) & low,
        "channel: opening Z+": np.abs(corners[:, :, 2] - EXTENT[2]).max(axis=1) < 1e-9,
    }
    groups = {name: np.flatnonzero(of) for name, of in at.items()}
    groups["rest"] = np.flatnonzero(~np.any(list(at.values()), axis=0))
    ((_, cells),) = mesh.cells.items()
    lower = mesh.points[cells[:, :4], 1].mean(axis=1) < 0.5 * EXTENT[1]
    regions = {"channel": np.flatnonzero(lower), "wall": np.flatnonzero(~lower), "body": np.arange(len(cells))}
    return replace(mesh, facet_groups=groups, cell_groups=regions, openings=frozenset(at))


@pytest.mark.parametrize("kind", ["tetra", "tetra10"])
@pytest.mark.parametrize("length", [0.3, 5.0])
def test_stubs_continue_the_openings(kind: str, length: float) -> None:
    before = open_block(kind)
    after = before.add_stubs(length)
    assert after.quality.inverted == 0
    opened, made = areas(before), areas(after)
    total = sum(opened[name] for name in before.openings)
    assert after.volume == pytest.approx(before.volume + length * total, rel=1e-12)
    ((_, facets),) = after.facets.items()
    ((_, outer),) = boundary_facets(after.cells).items()  # none is left inside: elements share their faces
    assert {frozenset(row) for row in facets.tolist()} == {frozenset(row) for row in outer.tolist()}
    assert len(facets) == len(outer)
    assert len(np.unique(after.points.round(9), axis=0)) == len(after.points)
    half = 2 * (0.5 * EXTENT[1] + EXTENT[2])
    for name, rim in {"X-": half, "X+": half, "Z+": 2 * (EXTENT[0] + EXTENT[1])}.items():
        axis = "XYZ".index(name[0])
        assert made[f"channel: opening {name}"] == pytest.approx(opened[f"channel: opening {name}"], rel=1e-12)
        assert made[f"channel: stub {name}"] == pytest.approx(length * rim, rel=1e-12)
        ends = after.points[after.node_sets[f"channel: opening {name}"], axis]
        place = -length if name[1] == "-" else EXTENT[axis] + length
        np.testing.assert_allclose(ends, place, atol=1e-12)
    volumes = after.cell_volumes
    sides = 2 * length * opened["channel: opening X-"]
    top = length * opened["channel: opening Z+"]
    assert volumes[after.cell_groups["channel"]].sum() == pytest.approx(
        0.5 * before.volume + sides + 0.5 * top, rel=1e-12
    )
    assert volumes[after.cell_groups["wall"]].sum() == pytest.approx(0.5 * before.volume + 0.5 * top, rel=1e-12)
    assert after.openings == before.openings
    ((_, cells),) = after.cells.items()
    upper = after.points[cells[:, :4], 1].mean(axis=1) > 0.5 * EXTENT[1]
    np.testing.assert_array_equal(after.cell_groups["wall"], np.flatnonzero(upper))


def test_openings_with_names_of_their_own_keep_their_facets() -> None:
    before = open_block("tetra")
    groups = {name.replace("channel: opening X-", "inlet"): of for name, of in before.facet_groups.items()}
    after = replace(before, facet_groups=groups, openings=frozenset({"inlet"})).add_stubs(1.0)
    assert areas(after)["inlet"] == pytest.approx(areas(before)["channel: opening X-"], rel=1e-12)
    assert areas(after)["inlet: stub"] == pytest.approx(EXTENT[1] + 2 * EXTENT[2], rel=1e-12)


def test_what_has_no_ends_is_refused() -> None:
    with pytest.raises(InvalidRequest, match="the mesh has no openings: mesh a channel of fluid_domains"):
        block("tetra").add_stubs(1.0)
    mesh = open_block("tetra")
    with pytest.raises(InvalidRequest, match="a periodic mesh has no ends for stubs"):
        replace(mesh, periodic=block("tetra").periodic).add_stubs(1.0)
    bent = mesh.points.copy()
    node = mesh.node_sets["channel: opening Z+"][0]
    bent[node, 2] += 0.1
    with pytest.raises(
        InvalidRequest, match=r"'channel: opening Z\+' is not in one plane, its nodes are 0\.0917 apart"
    ):
        replace(mesh, points=bent).add_stubs(1.0)
    with pytest.raises(InvalidRequest, match="elements other than tetrahedra"):
        replace(block("hexahedron"), periodic={}).add_stubs(1.0)
