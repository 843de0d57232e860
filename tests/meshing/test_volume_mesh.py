"""Volume meshes: measures are exact on polynomial elements, and files say to their readers what the mesh says."""

from __future__ import annotations

import itertools
import pickle
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.meshing.mesh_facets import boundary_facets
from tpmscad._typing import Array
from tpmscad.errors import InvalidRequest
from tpmscad.meshing.element_shapes import SHAPES, jacobian_coefficients
from tpmscad.meshing.facet_search import owners_of_facets
from tpmscad.meshing.inp_files import format_name
from tpmscad.meshing.mesh_arrays import sort_nodes
from tpmscad.meshing.tetrahedra import pair_sides, untangle
from tpmscad.meshing.volume_mesh import VolumeMesh

meshio = pytest.importorskip("meshio")
skfem = pytest.importorskip("skfem")

CELLS = (3, 2, 2)
EXTENT = np.array([3.0, 4.0, 2.0])


def block(kind: str, bend: float = 0.0) -> VolumeMesh:
    """A periodic box of hexahedra, or of six tetrahedra for each, whose nodes a quadratic map moves by `bend`."""
    shape = SHAPES[kind]
    tetra = [np.eye(3)[list(p)].cumsum(axis=0) for p in itertools.permutations(range(3))]
    frames = [np.vstack([np.zeros(3), t]) for t in tetra] if shape.is_simplex else [None]
    points, cells = [], []
    for index in np.ndindex(CELLS):
        for frame in frames:
            if frame is None:
                local = shape.nodes
            else:
                frame = frame if np.linalg.det(frame[1:] - frame[0]) > 0 else frame[[0, 2, 1, 3]]
                local = frame[0] + shape.nodes @ (frame[1:] - frame[0])
            cells.append(range(len(points), len(points) + len(local)))
            points.extend(index + local)
    unique, inverse = np.unique(np.round(np.array(points) * 4).astype(int), axis=0, return_inverse=True)
    nodes = inverse.ravel()[np.array(cells)]
    at = unique / 4 / CELLS
    pairs = {}
    for axis, name in enumerate("xyz"):
        others = [i for i in range(3) if i != axis]
        near, far = (np.flatnonzero(at[:, axis] == level) for level in (0.0, 1.0))
        pairs[name] = np.column_stack([near[np.lexsort(at[near][:, others].T)], far[np.lexsort(at[far][:, others].T)]])
    facets = boundary_facets({kind: nodes})
    ((_, faces),) = facets.items()
    low = np.flatnonzero((at[faces][:, :, 0] == 0.0).all(axis=1))
    mesh = VolumeMesh(
        at * EXTENT,
        {kind: nodes},
        facets,
        {"body": np.arange(len(nodes)), "first": np.array([0, 1])},
        {"cap X-": low, "rest": np.setdiff1d(np.arange(len(faces)), low)},
        pairs,
        EXTENT,
    )
    return sort_nodes(replace(mesh, points=bent(mesh.points, bend)))


def bent(points: Array, bend: float) -> Array:
    """A quadratic map that keeps the planes y = const and z = const; its Jacobian determinant is 1 + 2 bend x."""
    return np.column_stack([points[:, 0] + bend * points[:, 0] ** 2, points[:, 1], points[:, 2]])


@pytest.mark.parametrize("kind", ["tetra", "tetra10", "hexahedron", "hexahedron20", "hexahedron27"])
def test_a_box_has_its_volume_and_its_closed_boundary(kind: str) -> None:
    mesh = block(kind)
    assert mesh.volume == pytest.approx(24.0, rel=1e-13)
    assert mesh.quality.inverted == 0
    assert mesh.mismatch == 0.0
    ((facet_kind, faces),) = mesh.facets.items()
    corners = mesh.points[faces[:, : SHAPES[facet_kind].corners]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, -1] - corners[:, 0])
    assert np.einsum("ij,ij->i", normals, corners.mean(axis=1) - EXTENT / 2).min() > 0  # outwards
    assert np.abs(normals.sum(axis=0)).max() < 1e-12
    edges = [
        tuple(e) for face in faces[:, : SHAPES[facet_kind].corners] for e in zip(face, np.roll(face, -1), strict=True)
    ]
    assert sorted(edges) == sorted((b, a) for a, b in edges)


def test_a_mesh_travels_between_processes() -> None:
    mesh = block("hexahedron27", bend=0.1)
    copy = pickle.loads(pickle.dumps(mesh))
    for name in ("cells", "facets", "cell_groups", "facet_groups", "periodic"):
        own, other = getattr(mesh, name), getattr(copy, name)
        assert own.keys() == other.keys()
        assert all(np.array_equal(own[key], other[key]) for key in own)
    assert np.array_equal(copy.points, mesh.points)
    assert np.array_equal(copy.periods, mesh.periods, equal_nan=True)
    assert (copy.name, copy.quality) == (mesh.name, mesh.quality)


@pytest.mark.parametrize("kind", ["tetra10", "hexahedron27"])
def test_a_quadratic_map_has_its_volume_exactly(kind: str) -> None:
    mesh = block(kind, bend=0.1)
    assert mesh.volume == pytest.approx(8.0 * (3.0 + 0.1 * 9.0), rel=1e-13)


@pytest.mark.parametrize("kind", ["tetra10", "hexahedron20", "hexahedron27"])
def test_bernstein_coefficients_bound_the_jacobian(kind: str) -> None:
    rng = np.random.default_rng(1)
    nodes = SHAPES[kind].nodes + 0.1 * rng.standard_normal(SHAPES[kind].nodes.shape)
    found = jacobian_coefficients(kind, nodes, np.arange(len(nodes))[None])[0]
    at = rng.dirichlet(np.ones(4), 500)[:, :3] if kind == "tetra10" else rng.random((500, 3))
    determinants = np.linalg.det(np.einsum("nc,pnd->pcd", nodes, SHAPES[kind].gradients(at)))
    assert found.min() <= determinants.min() + 1e-12
    assert found.max() >= determinants.max() - 1e-12
    assert found[-1] == pytest.approx(
        np.linalg.det(np.einsum("nc,nd->cd", nodes, SHAPES[kind].gradients(np.eye(3)[:1])[0]))
        if kind == "tetra10"
        else np.linalg.det(np.einsum("nc,nd->cd", nodes, SHAPES[kind].gradients(np.ones((1, 3)))[0]))
    )


def test_an_inverted_element_is_counted_though_its_corners_are_right() -> None:
    mesh = block("tetra10")
    points = mesh.points.copy()
    first, second, middle = mesh.cells["tetra10"][0][[0, 1, 4]]
    points[middle] = points[first] + 0.1 * (points[second] - points[first])
    spoilt = replace(mesh, points=points)
    assert spoilt.quality.inverted > 0
    assert spoilt.quality.smallest < 0.0


def test_a_flat_element_is_counted_as_inverted() -> None:
    points = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    mesh = VolumeMesh(points, {"tetra": np.array([[0, 1, 2, 3], [0, 1, 2, 4]])})
    assert mesh.quality.inverted == 1


def test_inverted_elements_are_repaired_by_straight_edges_and_images_follow() -> None:
    mesh = block("tetra10")
    points = mesh.points.copy()
    near, far = mesh.periodic["x"].T
    middle = np.flatnonzero((mesh.points[near] % 1.0 > 0.1).any(axis=1))[0]
    points[near[middle]] += (0.0, 0.7, 0.3)
    points[far[middle]] += (0.0, 0.7, 0.3)
    spoilt = replace(mesh, points=points)
    repaired = untangle(spoilt)
    assert spoilt.quality.inverted > 0
    assert repaired.quality.inverted == 0
    assert repaired.mismatch < 1e-14
    assert repaired.straightened >= 2
    np.testing.assert_allclose(repaired.points, mesh.points, atol=1e-14)
    assert untangle(mesh).straightened == 0


def test_regular_elements_have_quality_one() -> None:
    regular = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]], float)[[0, 2, 1, 3]]
    found = VolumeMesh(regular, {"tetra": np.arange(4)[None]}).quality
    assert found.smallest == pytest.approx(1.0)
    assert found.smallest_scaled_jacobian == pytest.approx(1.0)
    cube = VolumeMesh(SHAPES["hexahedron27"].nodes, {"hexahedron27": np.arange(27)[None]}).quality
    assert cube.smallest == pytest.approx(1.0)
    assert cube.smallest_scaled_jacobian == pytest.approx(1.0)
    assert cube.size == pytest.approx(1.0)


def test_only_nodes_of_the_sides_have_images_however_near_the_others_are() -> None:
    mesh = block("tetra10")
    (facets,) = mesh.facets.values()
    ends = tuple((mesh.points[facets][:, :, 0] == level).all(axis=1) for level in (0.0, EXTENT[0]))
    inside = np.flatnonzero((mesh.points > 0.0).all(axis=1) & (mesh.points < EXTENT).all(axis=1))[0]
    points = mesh.points.copy()
    points[inside, 0] = 1e-7
    found = pair_sides(replace(mesh, points=points, periodic={}), {0: ends}, np.zeros(3), EXTENT, 1e-5)
    np.testing.assert_array_equal(np.sort(found.periodic["x"], axis=0), np.sort(mesh.periodic["x"], axis=0))
    assert found.points[inside, 0] == 1e-7


def test_a_middle_that_is_off_its_side_goes_to_the_chord_with_its_image() -> None:
    """An edge whose corners another face joins, too, may have its middle on that face."""
    mesh = block("tetra10")
    (facets,) = mesh.facets.values()
    ends = tuple((mesh.points[facets][:, :, 0] == level).all(axis=1) for level in (0.0, EXTENT[0]))
    points = mesh.points.copy()
    points[facets[ends[0]][0, 3]] += (0.02, 0.01, 0.0)
    found = pair_sides(replace(mesh, points=points, periodic={}), {0: ends}, np.zeros(3), EXTENT, 1e-5)
    assert found.straightened == 1
    assert untangle(found).straightened == 1
    assert found.mismatch == 0.0
    np.testing.assert_allclose(found.points, mesh.points, atol=1e-14)
    np.testing.assert_array_equal(np.sort(found.periodic["x"], axis=0), np.sort(mesh.periodic["x"], axis=0))


def test_a_corner_of_the_box_repeats_the_opposite_one_by_three_periods() -> None:
    mesh = block("hexahedron")
    repeated, shift = mesh.periodic_ties()
    far = np.flatnonzero((mesh.points == EXTENT).all(axis=1))[0]
    assert mesh.points[repeated[far]].tolist() == [0.0, 0.0, 0.0]
    assert shift[far].tolist() == [1, 1, 1]
    np.testing.assert_allclose(mesh.points, mesh.points[repeated] + shift * EXTENT, atol=1e-14)


@pytest.mark.parametrize("kind", ["tetra", "tetra10", "hexahedron", "hexahedron20", "hexahedron27"])
@pytest.mark.parametrize("suffix", [".msh", ".vtu"])
def test_meshio_reads_what_was_written(kind: str, suffix: str, tmp_path: Path) -> None:
    mesh, path = block(kind, bend=0.05), tmp_path / f"block{suffix}"
    mesh.write(path)
    found = meshio.read(path)
    np.testing.assert_array_equal(found.points, mesh.points)
    rows = [c.data for c in found.cells if c.type == kind]
    assert len(np.concatenate(rows)) == mesh.n_cells
    again = VolumeMesh(found.points, {kind: np.concatenate(rows)})
    assert again.volume == pytest.approx(mesh.volume, rel=1e-13)
    if suffix == ".msh":
        assert set(found.field_data) == {"body", "first", "cap X-", "rest"}
    else:
        assert found.cell_data["group: first"][0].sum() == 2


@pytest.mark.parametrize("kind", ["tetra", "hexahedron"])
def test_version_2_is_read_by_skfem_with_its_boundaries(kind: str, tmp_path: Path) -> None:
    mesh, path = block(kind), tmp_path / "block.msh"
    mesh.write(path, version="2.2")
    found = skfem.Mesh.load(str(path))
    assert len(found.boundaries["cap X-"]) == len(mesh.facet_groups["cap X-"])


@pytest.mark.parametrize("kind", ["tetra", "tetra10", "hexahedron", "hexahedron27"])
@pytest.mark.parametrize("route", ["value", "file"])
def test_skfem_integrates_over_the_groups(kind: str, route: str, tmp_path: Path) -> None:
    mesh = block(kind)
    if route == "file":
        mesh.write(tmp_path / "block.vtu")
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            found = skfem.Mesh.load(str(tmp_path / "block.vtu"))
    else:
        found = mesh.to_skfem()
    element = skfem.ElementTetP1() if SHAPES[kind].is_simplex else skfem.ElementHex1()
    basis = skfem.FacetBasis(found, element, facets="cap X-")
    assert basis.dx.sum() == pytest.approx(8.0)
    assert basis.normals[0].max() == pytest.approx(-1.0)
    assert len(found.subdomains["first"]) == 2


@pytest.mark.parametrize("version", ["2.2", "4.1"])
def test_gmsh_reads_periodic_meshes(version: str, tmp_path: Path) -> None:
    gmsh = pytest.importorskip("gmsh")
    mesh, path = block("hexahedron27"), tmp_path / "block.msh"
    mesh.write(path, version=version)
    gmsh.initialize(interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.open(str(path))
        _, tags, _ = gmsh.model.mesh.getElements(3)
        assert len(tags[0]) == mesh.n_cells
        assert gmsh.model.mesh.getElementQualities(tags[0], "volume").sum() == pytest.approx(mesh.volume)
    finally:
        gmsh.finalize()


def test_inp_files_name_sets_surfaces_and_ties(tmp_path: Path) -> None:
    mesh, path = block("tetra10"), tmp_path / "block.inp"
    mesh.write(path)
    text = path.read_text()
    repeated, _ = mesh.periodic_ties()
    assert text.count("*SURFACE, NAME=S_CAP_X_MINUS") == 1
    assert text.split("*EQUATION\n")[1].count(", 1, 1.") == (repeated != np.arange(len(repeated))).sum()
    assert all(len(line.split(",")) <= 17 for line in text.splitlines())
    replace(mesh, points=mesh.points - 1e-17 / 3).write(path)
    nodes = path.read_text().split("*NODE, NSET=NALL\n")[1].split("*ELEMENT")[0]
    assert max(len(number) for line in nodes.splitlines() for number in line.split(", ")) <= 20
    assert format_name("cap X+") == "CAP_X_PLUS"


def test_inp_files_of_27_nodes_are_those_of_20_nodes_with_a_note(tmp_path: Path) -> None:
    """CalculiX and Abaqus have no C3D27; the nodes of C3D20 come first in both."""
    full, plain = (block(f"hexahedron{count}", 0.05) for count in (27, 20))
    for mesh, name in ((full, "full.inp"), (plain, "plain.inp")):
        mesh.write(tmp_path / name)
    head, note, *rest = (tmp_path / "full.inp").read_text().split("\n", 3)[1:]
    assert head == "PART"
    assert note.startswith(f"** C3D20: the {len(full.points) - len(plain.points)} nodes inside")
    assert rest[0] == (tmp_path / "plain.inp").read_text().split("\n", 2)[2]
    assert "TYPE=C3D20," in rest[0]


def test_formats_refuse_what_they_cannot_hold(tmp_path: Path) -> None:
    with pytest.raises(InvalidRequest, match=r"2\.2"):
        block("tetra").write(tmp_path / "block.vtu", version="2.2")
    with pytest.raises(InvalidRequest, match="one kind"):
        block("hexahedron20").to_skfem()


def test_facets_that_no_element_has_are_refused() -> None:
    mesh = block("tetra")
    with pytest.raises(InvalidRequest, match="faces of no element"):
        owners_of_facets(mesh.cells, {"triangle": mesh.facets["triangle"][:, ::-1]})
    with pytest.raises(InvalidRequest, match="7 quad are faces of no element"):
        owners_of_facets(mesh.cells, {"quad": np.zeros((7, 4), np.int64)})


@pytest.mark.parametrize(
    ("nodes", "words"),
    [
        ([[0, 1, 2]], r"tetra has 4 nodes: its array of shape \(1, 3\) must have as many columns"),
        ([0, 1, 2, 3], r"tetra has 4 nodes: its array of shape \(4,\)"),
        ([[1, 2, 3, 5]], "tetra names the nodes 1 to 5: 5 points are numbered from 0"),
        ([[-1, 2, 3, 4]], "tetra names the nodes -1 to 4"),
    ],
)
def test_elements_that_do_not_fit_their_nodes_are_refused(nodes: list[list[int]], words: str) -> None:
    with pytest.raises(InvalidRequest, match=words):
        VolumeMesh(np.zeros((5, 3)), {"tetra": np.array(nodes)})
