"""Parts filled with a lattice: infill, skin, fluid domains, fields of bodies, and what is refused."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import build123d as bd
import numpy as np
import pytest

import tpmscad
from tpmscad import fields
from tpmscad.brep.patch_nodes import signed_distances_to_nodes
from tpmscad.files.checked_write import write_checked_solids
from tpmscad.kernel.export.shape_file import name_solids
from tpmscad.kernel.measure.shape_report import check_shape
from tpmscad.kernel.measure.solid_topology import measure_topology
from tpmscad.kernel.occt.construction import make_solid
from tpmscad.kernel.occt.exploration import solids_of
from tpmscad.kernel.step.face_labels import NamedSolid
from tpmscad.results.domain_results import FluidDomains

pytestmark = [pytest.mark.kernel, pytest.mark.slow]

P: dict[str, Any] = {"surface": "P", "cell": 10, "thickness": 1, "tol": 0.1}


def step(height: float = 12.0) -> bd.Part:
    """A body with a hole, a concave edge and a fillet."""
    part = bd.Box(16, 12, height) - bd.Pos(6, 0, height / 2) * bd.Box(8, 20, height / 2)
    part -= bd.Pos(-4, 0, 0) * bd.Cylinder(2, 30)
    return bd.fillet(part.edges().filter_by(bd.Axis.Z).group_by(bd.Axis.X)[0], 2)


def prism() -> bd.Part:
    """A body with a free-form side."""
    return bd.extrude(bd.Ellipse(8, 6), 10)


def in_step(at: np.ndarray) -> np.ndarray:
    x, y, z = at.T
    block = (np.abs(x) < 8) & (np.abs(y) < 6) & (np.abs(z) < 6) & ~((x > 2) & (z > 3))
    corner = (x < -6) & (np.abs(y) > 4) & (np.hypot(x + 6, np.abs(y) - 4) > 2)
    return block & ~corner & (np.hypot(x + 4, y) > 2)


def in_prism(at: np.ndarray) -> np.ndarray:
    x, y, z = at.T
    return (x**2 / 64 + y**2 / 36 < 1) & (z > 0) & (z < 10)


BODIES = {"step": (step, in_step), "prism": (prism, in_prism)}


def sample_volume(body: bd.Shape, inside: Callable[[np.ndarray], np.ndarray], points: int = 200_000) -> float:
    """Volume of lattice and body by points, each told in or out by the formulas of the body and of the P surface."""
    box = body.bounding_box()
    low, high = np.array(tuple(box.min)), np.array(tuple(box.max))
    at = np.random.default_rng(3).uniform(low, high, (points, 3))
    value, slope = fields.tpms("P", 10.0).value_and_gradient(at)
    near = np.abs(value) < 0.5 * np.linalg.norm(slope, axis=1)  # first order: good to a hundredth of the wall
    return float((inside(at) & near).mean() * np.prod(high - low))


@pytest.mark.parametrize("name", BODIES)
def test_an_infill_is_the_common_part_of_lattice_and_body(name: str, tmp_path: Path) -> None:
    make, inside = BODIES[name]
    body = make()
    model = tpmscad.infill(body, **P)
    found = model.certificate
    assert found.met, found
    assert found.valid
    assert found.closed
    assert model.trimmed_by == "patches"
    seen = check_shape(model.wrapped)  # the certificate is from the arrays, where the patches were trimmed
    assert (seen.valid, seen.closed, seen.faces) == (True, True, found.n_faces)
    assert (found.volume, found.area) == pytest.approx((seen.volume, seen.area), rel=1e-8)
    assert found.betti == measure_topology(solids_of(model.wrapped)).betti
    assert found.volume == pytest.approx(sample_volume(body, inside), rel=0.03)
    model.export_step(tmp_path / "part.step")  # which reads it back


def test_both_ways_of_trimming_agree(monkeypatch: pytest.MonkeyPatch) -> None:
    body = bd.Pos(1, 2, 3) * bd.Cylinder(5, 8)
    quick = tpmscad.infill(body, **P)

    def refuse(*_: Any) -> None:
        raise tpmscad.InvalidRequest("free-form, say")

    monkeypatch.setattr("tpmscad.solids.cut.brep_from_shape", refuse)
    slow = tpmscad.infill(body, **P)
    assert (quick.trimmed_by, slow.trimmed_by) == ("patches", "kernel")
    assert quick.certificate.volume == pytest.approx(slow.certificate.volume, rel=1e-6)
    assert quick.certificate.area == pytest.approx(slow.certificate.area, rel=1e-6)
    assert quick.certificate.betti == slow.certificate.betti
    assert any("free-form, say" in note for note in slow.certificate.notes)


def test_a_hole_that_touches_a_mirror_plane_of_the_lattice_is_trimmed_on_the_patches_all_the_same() -> None:
    wall: dict[str, Any] = {"surface": "iwp", "cell": 10, "thickness": 0.5, "tol": 0.01}
    block, bore = bd.Pos(6, 6, 5) * bd.Box(11, 11, 6), bd.Pos(6.3, 7, 5) * bd.Cylinder(2, 8)
    model = tpmscad.infill(block - bore, **wall)
    assert model.certificate.met
    assert model.trimmed_by == "patches"
    assert any("the lattice was moved by" in note for note in model.certificate.notes)
    drilled = tpmscad.infill(block, **wall).solid - bore
    assert model.certificate.volume == pytest.approx(drilled.volume, rel=1e-6)


def test_the_lattice_is_anchored_at_the_origin_and_turned_about_it() -> None:
    turned = tpmscad.infill(bd.Box(14, 13, 12), **P, rotation=(90, 0, 0), phase=(0.11, 0.23, 0.31))
    moved = tpmscad.infill(bd.Box(14, 12, 13), **P, phase=(0.11, 0.23, 0.31))
    assert turned.certificate.volume == pytest.approx(moved.certificate.volume, rel=1e-9)
    x, y, z = tuple(moved.solid.center())
    assert tuple(turned.solid.center()) == pytest.approx((x, -z, y), abs=1e-6)
    askew = tpmscad.infill(bd.Sphere(7), **P, rotation=(10, 20, 30))
    straight = tpmscad.infill(bd.Sphere(7), **P)
    assert askew.certificate.volume == pytest.approx(straight.certificate.volume, rel=1e-6)


def test_a_cell_may_have_unequal_edges() -> None:
    request = P | {"cell": (10, 10, 12), "thickness": None, "kind": "skeletal", "tol": 0.2}
    model = tpmscad.infill(bd.Pos(5, 5, 6) * bd.Box(10, 10, 12), **request)
    assert model.certificate.met
    assert model.certificate.volume == pytest.approx(
        10 * 10 * 12 / 2, rel=1e-6
    )  # the P surface divides a cell in halves


def test_a_field_fills_a_body_too() -> None:
    field = fields.rod(fields.tpms("P", 10.0), -0.4)
    model = tpmscad.infill(bd.Cylinder(6, 9), field, tol=0.1)
    assert model.certificate.valid
    assert model.certificate.notes[0] == "trimmed on the patches' parameters"
    at = np.random.default_rng(5).uniform([-6, -6, -4.5], [6, 6, 4.5], (200000, 3))
    share = ((np.hypot(at[:, 0], at[:, 1]) < 6) & (field(at) < 0)).mean()
    assert model.certificate.volume == pytest.approx(share * 12 * 12 * 9, rel=0.02)
    with pytest.raises(tpmscad.InvalidRequest, match="leave thickness, rotation out"):
        tpmscad.infill(bd.Cylinder(6, 9), field, tol=0.1, thickness=1, rotation=(1, 2, 3))


class TestSkin:
    def test_it_is_one_solid_whose_voids_are_the_lattice_s_and_is_modelled_on(self, tmp_path: Path) -> None:
        body = bd.Box(14, 12, 11) - bd.Cylinder(2, 30)
        model = tpmscad.infill(body, **P, skin=1.5)
        found = model.certificate
        assert found.met
        assert isinstance(model.solid, bd.Solid)
        core = bd.offset(body, -1.5, kind=bd.Kind.INTERSECTION)
        inner = tpmscad.infill(core, **P).certificate.volume
        assert found.volume == pytest.approx(body.volume - (core.volume - inner), rel=1e-6)
        assert len(model.solid.shells()) == 1 + found.betti[2]
        assert any("closes off" in note for note in found.notes)
        model.export_step(tmp_path / "filled.step")
        assert tpmscad.check_step(tmp_path / "filled.step").ok

        bored = model.solid - bd.Pos(0, 4, 0) * bd.Cylinder(1, 30)
        assert bored.is_valid
        assert len(bored.solids()) == 1
        assert bored.volume < model.solid.volume
        edge = bored.edges().filter_by(bd.Axis.Z).sort_by(bd.Axis.X)[-1]
        rounded = bored.solids()[0].fillet(1.0, [edge])
        assert rounded.is_valid
        assert rounded.volume == pytest.approx(bored.volume - (1 - np.pi / 4) * 11, rel=1e-6)
        joined = rounded + bd.Pos(0, 0, -6) * bd.Cylinder(12, 1.5)
        assert joined.is_valid
        assert len(joined.solids()) == 1

    @pytest.mark.parametrize("skin", [6.0, 0.0, float("nan")])
    def test_it_is_thinner_than_the_part(self, skin: float) -> None:
        with pytest.raises(tpmscad.InvalidRequest, match="skin"):
            tpmscad.infill(bd.Box(16, 14, 12), **P, skin=skin)


@pytest.fixture(scope="module")
def domains() -> FluidDomains:
    return tpmscad.fluid_domains(bd.Cylinder(8, 12), "P", cell=10, thickness=1, tol=0.1, phase=(0.1, 0.2, 0.3))


class TestFluidDomains:
    def test_the_volumes_add_up_to_the_body_s(self, domains: FluidDomains) -> None:
        parts = domains.wall, domains.plus, domains.minus
        assert all(part.solid.is_valid for part in parts)
        assert [part.volume for part in parts] == pytest.approx([part.solid.volume for part in parts], rel=1e-3)
        assert sum(part.volume for part in parts) == pytest.approx(np.pi * 64 * 12, rel=1e-6)
        assert domains.certificate.met

    def test_a_channel_s_hydraulic_diameter_counts_the_faces_it_shares_with_the_wall(
        self, domains: FluidDomains
    ) -> None:
        wall = {hash(face.wrapped) for face in domains.wall.solid.faces()}
        for name, diameter in domains.hydraulic_diameters.items():
            channel = domains.domains[name].solid
            wetted = sum(face.area for face in channel.faces() if hash(face.wrapped) in wall)
            assert diameter == pytest.approx(4 * channel.volume / wetted, rel=1e-3)
            assert f"hydraulic diameter {diameter:.4g} mm" in domains.summary()
        found = domains.to_dict()["domains"]
        assert sum(found[name]["volume"] for name in found) == pytest.approx(np.pi * 64 * 12, rel=1e-6)
        assert sum(sum(found[name]["faces"].values()) for name in found) == pytest.approx(2 * np.pi * 8 * 20, rel=1e-6)

    def test_each_channel_lies_on_its_side(self, domains: FluidDomains) -> None:
        phi = fields.translate(fields.tpms("P", 10.0), (1, 2, 3))
        for part, sign in ((domains.plus, 1), (domains.minus, -1)):
            walls = (bd.GeomType.BSPLINE, bd.GeomType.BEZIER)
            on_surface = [f.center() for f in part.solid.faces() if f.geom_type in walls]
            assert on_surface
            assert all(sign * phi(np.array(tuple(c))) > 0 for c in on_surface)

    def test_what_touches_a_face_is_told(self, domains: FluidDomains) -> None:
        areas = sorted(sum(touch.areas.values()) for touch in domains.touches)
        assert areas == pytest.approx([np.pi * 64, np.pi * 64, 2 * np.pi * 8 * 12], rel=1e-6)


def test_a_file_that_does_not_read_back_as_written_is_not_left(tmp_path: Path) -> None:
    box, path = bd.Box(2, 3, 4), tmp_path / "box.step"
    open_box = make_solid([bd.Shell(box.faces()[1:]).wrapped])
    how: dict[str, Any] = {"schema": "ap242", "name": "box"}
    write_checked_solids(name_solids(box, "box"), path, **how, volume=24.0)
    path.unlink()
    for solids, volume in ((name_solids(box, "box"), 24.001), ([NamedSolid("box", open_box, ("",) * 5)], 24.0)):
        with pytest.raises(tpmscad.KernelError):
            write_checked_solids(solids, path, **how, volume=volume)
        assert not list(tmp_path.iterdir())


class TestBodyField:
    def test_it_is_the_signed_distance(self) -> None:
        at = np.random.default_rng(2).uniform(-6, 6, (200, 3))
        for shape, exact in (
            (bd.Box(4, 6, 8), fields.box((-2, -3, -4), (2, 3, 4))),
            (bd.Sphere(4), fields.sphere((0, 0, 0), 4)),
        ):
            found = tpmscad.body_field(shape)
            assert found(at) == pytest.approx(exact(at), abs=1e-7)
            assert found.gradient(at) == pytest.approx(exact.gradient(at), abs=1e-4)
            assert found.on_grid([0, 1], [0, 1, 2], [0.5]).shape == (2, 3, 1)

    def test_a_point_as_far_from_the_boundary_as_from_one_on_it_is_inside(self) -> None:
        """The first one is 2e-15 inside of a face, which the kernel takes for on it."""
        found = tpmscad.body_field(bd.Box(10, 10, 10))(np.array([[1.0, 1.0, -5 + 2e-15], [1.0, 1.0, -4.0]]))
        assert found == pytest.approx([0.0, -1.0], abs=1e-12)

    @pytest.mark.parametrize(
        "shape",
        [
            bd.fillet((bd.Box(6, 5, 4) - bd.Pos(1, 0, 0) * bd.Cylinder(1, 9)).edges().group_by(bd.Axis.Z)[-1], 0.4),
            bd.extrude(bd.Ellipse(3, 2), 4) - bd.Pos(0, 0, 4) * bd.Sphere(1.2),
        ],
        ids=["fillets", "free form"],
    )
    def test_feet_in_arrays_are_the_kernels(self, shape: Any) -> None:
        found = tpmscad.body_field(shape)
        assert found.boundary is not None
        at = np.random.default_rng(3).uniform(-5, 5, (300, 3))
        assert found(at) == pytest.approx(replace(found, boundary=None)(at), abs=1e-8)
        distance, feet = found.boundary.feet(at)
        assert np.linalg.norm(feet - at, axis=1) == pytest.approx(distance, abs=1e-12)

    def test_a_table_of_it_is_exact_at_the_samples_and_near_them_between(self) -> None:
        exact = fields.sphere((0, 0, 0), 4)
        table = tpmscad.body_field(bd.Sphere(4), spacing=1.0)
        assert np.array(table.domain) == pytest.approx(np.array([[-6.0] * 3, [6.0] * 3]), abs=1e-6)
        samples = np.stack(np.meshgrid(*[np.linspace(-6, 6, 13)] * 3), axis=-1)
        assert table(samples) == pytest.approx(exact(samples), abs=1e-6)
        between = np.random.default_rng(5).normal(size=(200, 3))
        between *= np.linspace(2, 5, 200)[:, None] / np.linalg.norm(between, axis=1, keepdims=True)
        assert table(between) == pytest.approx(exact(between), abs=0.02)

    def test_a_table_that_is_too_large_is_refused(self) -> None:
        with pytest.raises(tpmscad.InvalidRequest, match=r"spacing of 0.01 needs 5.*e\+08 samples, .* at least 0.0"):
            tpmscad.body_field(bd.Sphere(4), spacing=0.01)


def test_the_sample_that_has_the_last_word_knows_the_lattice() -> None:
    model = tpmscad.lattice("P", cell=10, thickness=1, tol=0.1)
    at = np.random.default_rng(1).uniform(1, 9, (400, 3))
    phi = fields.tpms("P", 10.0)
    value, slope = phi.value_and_gradient(at)
    far = np.abs(np.abs(value) - 0.5 * np.linalg.norm(slope, axis=1)) > 0.3
    wall = np.abs(value) < 0.5 * np.linalg.norm(slope, axis=1)
    assert ((signed_distances_to_nodes(model.patches, at) < 0) == wall)[far].all()
